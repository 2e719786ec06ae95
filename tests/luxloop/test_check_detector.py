"""The contract of detectors: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

from typing import Any

import pytest
import torch
from torch import Tensor

from luxloop import Detections, check_detector
from luxloop.perception.detection.build import network_detector
from luxloop.perception.detection.detector import NetworkParams
from tests.luxloop.variants import assert_refused, variant
from tests.refusal import refusal


class Brightest:
    classes: Any = ("other",)

    def __init__(self, device, size_px=40.0):
        self.half, self.memory = size_px / 2, [0.0]

    def detect(self, frames):
        return [self.found(frame) for frame in frames]

    def found(self, frame):
        row, column = divmod(int(frame.argmax()), frame.shape[1])
        box = torch.tensor([[column - self.half, row - self.half, column + self.half, row + self.half]]).to(frame)
        return Detections(self.boxes(box), self.scores(frame.max().view(1, 1)))

    def boxes(self, box):
        return box

    def scores(self, score):
        return score


class Nothing(Brightest):
    def found(self, frame):
        return Detections(frame.new_zeros(0, 4), frame.new_zeros(0, 1))


class Remembering(Brightest):
    def scores(self, score):
        self.memory[0] = 0.5 * (self.memory[0] + float(score))
        return torch.full_like(score, self.memory[0])


class Network:
    def __init__(self, device):
        self.network = network_detector(NetworkParams(), device)
        self.classes = self.network.classes

    def detect(self, frames):
        return self.network.detect(frames)


class Blind:
    classes = ("other",)

    def __init__(self, device): ...


def middle_and_size(self: Brightest, box: Tensor) -> Tensor:
    return torch.cat([(box[:, :2] + box[:, 2:]) / 2, box[:, 2:] - box[:, :2]], 1)


def only_in_light(self: Brightest, frame: Tensor) -> Detections | None:
    return Brightest.found(self, frame) if frame.max() > 0.3 else None


BROKEN = {
    "has no method detect": Blind,
    "classes = ('dog',)": variant(Brightest, classes=("dog",)),
    "seem to be shares of the frame": variant(Brightest, boxes=lambda self, box: box / 640),
    "middle is outside of the frame of 640 x 360 px": variant(Brightest, boxes=lambda self, box: 10 * box + 1000),
    "sides down to -": variant(Brightest, boxes=middle_and_size),
    "scores from -": variant(Brightest, scores=lambda self, score: score.logit(1e-6)),
    "scores [1]": variant(Brightest, scores=lambda self, score: score[:, 0]),
    "some of which are not finite": variant(Brightest, scores=lambda self, score: score * torch.nan),
    "gives 1 for 3 frames": variant(Brightest, detect=lambda self, frames: [self.found(frames[0])]),
    "something else in a frame where others are beside it": variant(
        Brightest, detect=lambda self, frames: [self.found(frames.mean(0))] * len(frames)
    ),
    "another detections[0].scores": Remembering,
    "gives a map": variant(Brightest, detect=lambda self, frames: map(self.found, frames)),
    "changes frames, which was passed to it": variant(Brightest, detect=lambda self, frames: [self.found(each) for each in frames.sqrt_()]),
    "'NoneType' object has no attribute 'boxes'": variant(Brightest, found=only_in_light),
}


@pytest.mark.parametrize(("kind", "broken"), BROKEN.items())
def test_each_way_to_break_the_contract_is_told_in_a_sentence(kind, broken, device):
    assert_refused(lambda each: check_detector(each, device=device.type), broken, "detector.kind", kind)


def test_what_keeps_the_contract_passes(device):
    for detector in (Nothing, Network):
        check_detector(detector, device=device.type)
    check_detector(Brightest, {"size_px": 30}, device.type)
    with refusal(r"detector\.options\.size: .*did you mean 'size_px'\?"):
        check_detector(Brightest, {"size": 30}, device.type)
    with pytest.warns(UserWarning, match=r"nothing found in 3 frames, .*; frames are shares 0\.\.1 of the largest number"):
        check_detector(variant(Nothing, classes=("car",)), device=device.type)
