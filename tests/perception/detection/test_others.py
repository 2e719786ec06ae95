"""OpenCV's people detector, and detectors of the user's own."""

from pathlib import Path

import pytest
import torch

from perception.detection.build import detector
from perception.detection.params import HogParams, OwnDetector
from perception.detection.suppression import overlaps
from tests.perception.detection.lit import Lit
from world.errors import LuxloopError

CPU = torch.device("cpu")


def test_hog_finds_a_pedestrian_by_light_and_nobody_in_the_dark(lit: Lit, device: torch.device) -> None:
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


def test_hog_in_an_empty_frame_finds_nothing() -> None:
    (found,) = detector(HogParams(), CPU).detect(torch.zeros(1, 180, 320))
    assert found.boxes.shape == (0, 4) and found.scores.shape == (0, 1)


OWN = """
import torch
from perception.detection.protocol import Detections

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


def test_a_detector_of_ones_own_is_made_with_its_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_detector_of_a_test.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    own = detector(OwnDetector(kind="own_detector_of_a_test:Brightest", options={"size_px": 10}), CPU)
    frames = torch.zeros(1, 60, 80)
    frames[0, 30, 40] = 0.5
    (found,) = own.detect(frames)
    assert found.boxes.tolist() == [[35, 25, 45, 35]] and found.scores.tolist() == [[0.5]]
    with pytest.raises(LuxloopError, match=r"detector.kind: own_detector_of_a_test:Brightest: .*detector.options"):
        detector(OwnDetector(kind="own_detector_of_a_test:Brightest", options={"sise": 10}), CPU)
