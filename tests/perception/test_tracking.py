"""Which detections a track takes for its own, and vehicles of which but the lamps are seen."""

from typing import get_args

import pytest
import torch

from luxloop.perception.boxes import ABOVE_M
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.detection.detector import Detections
from luxloop.perception.tracking import Tracker, TrackerParams
from luxloop.world.traffic.tracked import Category

VIEW = camera_view(CameraParams(width_px=640, height_px=360, pitch_deg=1.5, oversampling=1))


def pedestrian(y_m: float) -> Detections:
    """Found 20 m ahead, 0.6 m wide and 1.7 m high: about a metre in size."""
    corners = torch.tensor([[20.0, y_m + 0.3, 1.7], [20.0, y_m - 0.3, 0.0]], dtype=torch.float64).T
    return Detections(VIEW.project(corners)[0].T.reshape(1, 4), torch.ones(1, 1).double())


@pytest.mark.parametrize(("aside_m", "numbers"), [(0.15, [1]), (0.6, [1, 2])])
def test_a_detection_beyond_four_standard_deviations_is_of_somebody_else(aside_m, numbers):
    """After ten frames at one place a foot is known to 0.04 m and measured to 0.05 m; 0.6 m aside cost less than a frame without it."""
    tracker = Tracker(("pedestrian",), VIEW, TrackerParams())
    tracks = tracker.start()
    for k in range(11):
        tracks = tracker.step(tracks, pedestrian(0.0 if k < 10 else aside_m), k / 30)
    assert tracks.number.tolist() == numbers


RATE_HZ, FOUND, ALL = 30.0, 5, 40  # frames with the car's box, and in all


@pytest.mark.parametrize(
    ("start_score", "lamps", "score"),
    [*((start, 2, 0.0) for start in (0.3, 0.45, 0.5, 0.7, 0.9)), (0.5, 1, 0.0), (0.5, 0, 0.0), (0.5, 0, 0.6)],
)
def test_a_dark_car_is_kept_while_both_lamps_shine(start_score, lamps, score):
    """score: of what the detector goes on to find, as a share of what starts a track."""
    classes = get_args(Category)
    tracker = Tracker(classes, VIEW, TrackerParams(start_score=start_score))
    corners = torch.tensor([[20.0, 0.9, 1.5], [20.0, -0.9, 0.0]], dtype=torch.float64).T
    box = VIEW.project(corners)[0].T.reshape(1, 4)
    frame = torch.full((VIEW.height, VIEW.width), 0.01)
    metre = float(box[0, 2] - box[0, 0]) / 1.8
    row = round(float(box[0, 3]) - ABOVE_M * metre)
    for middle in (round(float(box[0, 0]) + 0.2 * metre), round(float(box[0, 2]) - 0.2 * metre))[:lamps]:
        frame[row - 1 : row + 2, middle - 1 : middle + 2] = 1.0

    def seen(value: float) -> Detections:
        scores = torch.zeros(1, len(classes))
        scores[0, classes.index("car")] = value
        return Detections(box.float(), scores)

    tracks = tracker.start()
    for k in range(ALL):
        tracks = tracker.follow(tracks, seen(1.0 if k < FOUND else score * start_score), frame, k / RATE_HZ)
    kept = tracks.present
    assert kept.number.tolist() == ([1] if lamps == 2 or score >= 0.5 else [])
    if lamps == 2:
        # px; lamps are whole ones, and so is what they say of the foot
        torch.testing.assert_close(tracker.boxes(kept), box, rtol=0, atol=2.0)
        assert float(kept.score.max()) == float(kept.confidence.max()) == 1.0
