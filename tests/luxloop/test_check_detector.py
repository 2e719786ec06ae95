"""The contract of detectors: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

from collections.abc import Sequence
from typing import Any

import pytest
import torch
from torch import Tensor

from luxloop import Detections, LuxloopError, check_detector
from luxloop.perception.detection.build import network_detector
from luxloop.perception.detection.detector import NetworkParams


class Brightest:
    classes: Any = ("other",)

    def __init__(self, device: torch.device, size_px: float = 40.0) -> None:
        self.half, self.memory = size_px / 2, [0.0]

    def detect(self, frames: Tensor) -> Any:
        return [self.found(frame) for frame in frames]

    def found(self, frame: Tensor) -> Any:
        row, column = divmod(int(frame.argmax()), frame.shape[1])
        box = [column - self.half, row - self.half, column + self.half, row + self.half]
        return Detections(torch.tensor([box]).to(frame), frame.max().view(1, 1))


class Nothing(Brightest):
    def found(self, frame: Tensor) -> Detections:
        return Detections(frame.new_zeros(0, 4), frame.new_zeros(0, 1))


class OfBytes(Nothing):
    classes = ("car",)


class AsShares(Brightest):
    def found(self, frame: Tensor) -> Detections:
        found = super().found(frame)
        return Detections(found.boxes / frame.shape[1], found.scores)


class OfALargerPicture(Brightest):
    def found(self, frame: Tensor) -> Detections:
        found = super().found(frame)
        return Detections(10 * found.boxes + 1000, found.scores)


class MiddleAndSize(Brightest):
    def found(self, frame: Tensor) -> Detections:
        left, top, right, bottom = super().found(frame).boxes[0]
        return Detections(torch.stack([left + right, top + bottom, right - left, bottom - top])[None] / 2, frame.max().view(1, 1))


class Logits(Brightest):
    def found(self, frame: Tensor) -> Detections:
        found = super().found(frame)
        return Detections(found.boxes, found.scores.logit(1e-6))


class OneScore(Brightest):
    def found(self, frame: Tensor) -> Detections:
        found = super().found(frame)
        return Detections(found.boxes, found.scores[:, 0])


class Relative(Brightest):
    def found(self, frame: Tensor) -> Detections:
        found, contrast = super().found(frame), (frame > 0.3).to(frame)
        return Detections(found.boxes, (contrast.sum() / contrast.sum()).view(1, 1))


class FirstOnly(Brightest):
    def detect(self, frames: Tensor) -> Any:
        return [self.found(frames[0])]


class MeanOfAll(Brightest):
    def detect(self, frames: Tensor) -> Any:
        return [self.found(frames.mean(0))] * len(frames)


class Remembering(Brightest):
    def found(self, frame: Tensor) -> Detections:
        self.memory[0] = 0.5 * (self.memory[0] + float(frame.max()))
        return Detections(super().found(frame).boxes, frame.new_tensor([[self.memory[0]]]))


class Lazy(Brightest):
    def detect(self, frames: Tensor) -> Any:
        return (self.found(frame) for frame in frames)


class InPlace(Brightest):
    def detect(self, frames: Tensor) -> Any:
        return super().detect(frames.sqrt_())


class NoneInTheDark(Brightest):
    def found(self, frame: Tensor) -> Detections | None:
        return super().found(frame) if frame.max() > 0.3 else None


class OfDogs(Brightest):
    classes = ("dog",)


class Blind:
    classes = ("other",)

    def __init__(self, device: torch.device) -> None: ...


BROKEN: dict[Any, list[str]] = {
    Blind: ["has no method detect"],
    OfDogs: ["classes = ('dog',)", "pedestrian"],
    AsShares: ["seem to be shares of the frame", "here 640 and 360 px"],
    OfALargerPicture: ["middle is outside of the frame of 640 x 360 px", "not of a picture of another size"],
    MiddleAndSize: ["sides down to -", "left, top, right, bottom"],
    Logits: ["scores from -", "sigmoid"],
    OneScore: ["scores [1]", "scores [n, classes]"],
    Relative: ["some of which are not finite"],
    FirstOnly: ["gives 1 for 3 frames"],
    MeanOfAll: ["something else in a frame where others are beside it", "by itself"],
    Remembering: ["another detections[0].scores", "same frames", "keep nothing in self"],
    Lazy: ["gives a generator", "a list with one luxloop.Detections a frame"],
    InPlace: ["changes frames, which was passed to it"],
    NoneInTheDark: ["'NoneType' object has no attribute 'boxes'"],
}


@pytest.mark.parametrize("broken", BROKEN, ids=lambda each: each.__name__)
def test_each_way_to_break_the_contract_is_told_in_a_sentence(broken: Any, device: torch.device) -> None:
    with pytest.raises(LuxloopError) as caught:
        check_detector(broken, device=device.type)
    (sentence,) = caught.value.args
    assert f"detector.kind: {__name__}:{broken.__name__}: " in sentence
    assert all(words in sentence for words in BROKEN[broken]), sentence


class Network:
    def __init__(self, device: torch.device) -> None:
        self.network = network_detector(NetworkParams(), device)
        self.classes = self.network.classes

    def detect(self, frames: Tensor) -> Sequence[Detections]:
        return self.network.detect(frames)


@pytest.mark.parametrize("kept", [Brightest, Nothing, Network])
def test_what_keeps_the_contract_passes(kept: Any, device: torch.device) -> None:
    check_detector(kept, device=device.type)


def test_a_detector_of_cars_that_finds_none_is_told_what_frames_are(device: torch.device) -> None:
    with pytest.warns(UserWarning, match=r"nothing found in 3 frames, .*; frames are shares 0\.\.1 of the largest number"):
        check_detector(OfBytes, device=device.type)


def test_options_are_those_of_the_scenario(device: torch.device) -> None:
    check_detector(Brightest, {"size_px": 30}, device.type)
    with pytest.raises(LuxloopError, match=r"detector\.options\.size: .*did you mean 'size_px'\?"):
        check_detector(Brightest, {"size": 30}, device.type)
