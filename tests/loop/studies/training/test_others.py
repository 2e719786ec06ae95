"""OpenCV's people detector, and detectors of the user's own."""

from typing import Any

import pytest
import torch

from luxloop import Detections
from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import HogParams, OwnDetector, overlaps
from tests.refusal import refusal

CPU = torch.device("cpu")


def test_hog_finds_a_pedestrian_by_light_and_nobody_in_the_dark(lit, device):
    hog = detector(HogParams(), device)
    assert hog.classes == ("pedestrian",)
    people = lit.boxes(0)
    people = people[(people[:, 3] - people[:, 1]) > 60]
    assert len(people)
    bright, dark = hog.detect(torch.cat([lit.frame(20.0), lit.frame(0.001)]).to(device))
    assert bright.boxes.device.type == device.type
    assert overlaps(people, bright.boxes.cpu()).amax() > 0.4
    best = bright.scores.amax(1)
    assert (best >= 0.1).all() and torch.equal(best, best.sort(descending=True).values)
    assert not (dark.scores > 0.5).any()


def test_hog_takes_frames_smaller_than_its_window_and_empty_ones():
    """OpenCV's window is 64 x 128 px; of a frame smaller than that it reads beyond the end, and the process dies."""
    for size in ((180, 320), (90, 160), (30, 40), (2, 2), (256, 128)):
        (found,) = detector(HogParams(magnify=0.5), CPU).detect(torch.rand(1, *size, generator=torch.Generator().manual_seed(0)))
        assert bool(found.boxes.isfinite().all())
    (found,) = detector(HogParams(), CPU).detect(torch.zeros(1, 180, 320))
    assert found.boxes.shape == (0, 4) and found.scores.shape == (0, 1)


OWN = """
import torch
from luxloop.perception.detection.detector import Detections

class Brightest:
    classes = ("other",)

    def __init__(self, device, size_px=20):
        self.size_px = size_px

    def detect(self, frames):
        return [self._found(frame) for frame in frames]

    def _found(self, frame):
        row, column = divmod(int(frame.argmax()), frame.shape[1])
        half = self.size_px / 2
        return Detections(torch.tensor([[column - half, row - half, column + half, row + half]]), frame.max().view(1, 1))
"""


def test_a_detector_of_ones_own_is_made_with_its_options(tmp_path, monkeypatch):
    (tmp_path / "own_detector_of_a_test.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    brightest = detector(OwnDetector(kind="own_detector_of_a_test:Brightest", options={"size_px": 10}), CPU)
    frames = torch.zeros(1, 60, 80)
    frames[0, 30, 40] = 0.5
    (found,) = brightest.detect(frames)
    assert found.boxes.tolist() == [[35, 25, 45, 35]] and found.scores.tolist() == [[0.5]]
    with refusal(r"detector\.options\.sise_px: .*did you mean 'size_px'"):
        detector(OwnDetector(kind="own_detector_of_a_test:Brightest", options={"sise_px": 10}), CPU)


class Given:
    """Finds the same whatever it sees."""

    def __init__(self, device: torch.device, boxes: Any = None, scores: Any = None, classes: Any = ("car", "truck")) -> None:
        self.found = Detections(boxes, scores)
        if classes is not None:
            self.classes = classes

    def detect(self, frames: torch.Tensor) -> list[Detections]:
        return [self.found] * len(frames)


def own(**options: Any) -> Any:
    return detector(OwnDetector(kind=f"{__name__}:Given", options=options), CPU)


@pytest.mark.parametrize("classes", [None, (), ["car"], ("dog",), "car"])
def test_classes_of_ones_own_detector_must_be_known(classes):
    with refusal(r"detector.kind: .*Given: has (no classes|classes = .*); it needs a tuple of some of car"):
        own(classes=classes)


BOXES, SCORES = torch.tensor([[10.0, 20.0, 30.0, 40.0]] * 3), torch.zeros(3, 2)


@pytest.mark.parametrize(
    ("boxes", "scores", "said"),
    [
        (BOXES, torch.zeros(3, 1), r"gives boxes \[3, 4\] and scores \[3, 1\]; with 2 classes"),
        (BOXES, torch.zeros(3), r"gives boxes \[3, 4\] and scores \[3\]"),
        (torch.zeros(3, 5), SCORES, r"gives boxes \[3, 5\]"),
        (torch.zeros(()), SCORES, r"gives boxes \[\]"),
        (BOXES / 0 * 0, SCORES, "some of which are not finite"),
        (BOXES.numpy(), SCORES.numpy(), r"fails.*\(AttributeError"),
        (None, None, r"fails.*\(AttributeError"),
        (BOXES, SCORES - 0.1, r"scores from -0.1 to -0.1; give 0\.\.1: of logits the sigmoid"),
        (BOXES, SCORES + 30, r"scores from 30 to 30; give 0\.\.1"),
        (BOXES[:, [2, 1, 0, 3]], SCORES, "boxes with sides down to -20 px; give left, top, right, bottom"),
        (BOXES[:, [0, 1, 2, 1]], SCORES, "boxes with sides down to 0 px"),
        (BOXES / 80, SCORES, "seem to be shares of the frame; multiply them by its width and height, here 80 and 60 px"),
        (BOXES + 60, SCORES, "middle is outside of the frame of 80 x 60 px"),
    ],
)
def test_what_ones_own_detector_gives_is_checked_in_a_run_as_well(boxes, scores, said):
    with refusal(rf"^detector.kind: .*Given: .*{said}"):
        own(boxes=boxes, scores=scores).detect(torch.zeros(2, 60, 80))


def test_boxes_that_reach_beyond_the_frame_are_none_the_worse():
    beyond = torch.tensor([[-10.0, -5.0, 30.0, 40.0]])
    for boxes in (beyond, BOXES):
        found = own(boxes=boxes, scores=SCORES[: len(boxes)]).detect(torch.zeros(2, 60, 80))
        assert [len(each) for each in found] == [len(boxes)] * 2
