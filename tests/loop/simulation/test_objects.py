"""Objects that a plant tells of: when they come and go, and as text."""

import math
from dataclasses import replace

import pytest
import torch

from luxloop import Arrivals, TrackedObject, pose_from_degrees
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.remote_messages import LINGER_S, object_values, read_objects, track_objects
from luxloop.perception.camera import CameraParams

WALKER, CAR = (
    TrackedObject(name, category, pose_from_degrees((k / 3, 0.1, 0.0), yaw_deg=7.0 * k), (0.5, 0.5, 1.8))
    for k, (name, category) in enumerate((("walker", "pedestrian"), ("car", "car")), 1)  # type: ignore[arg-type]
)


def test_an_object_lingers_when_it_has_gone_and_comes_again_as_a_new_one():
    first = track_objects((), [WALKER, CAR], 1.0)
    assert [(each.name, each.since_s, each.until_s) for each in first] == [("walker", 1.0, math.inf), ("car", 1.0, math.inf)]
    gone = track_objects(first, [replace(WALKER, size_m=(1.0, 1.0, 1.0))], 2.0)
    assert [(each.name, each.since_s, each.until_s) for each in gone] == [("walker", 1.0, math.inf), ("car", 1.0, 2.0)]
    assert gone[0].size_m == (1.0, 1.0, 1.0)
    still = track_objects(gone, [WALKER], 3.0)
    assert still[1].until_s == 2.0 and len(track_objects(still, [WALKER], 2.0 + LINGER_S)) == 1
    (car, _) = track_objects(still, [CAR], 4.0)
    assert (car.since_s, car.until_s) == (4.0, math.inf)


def test_objects_come_back_from_text_bit_for_bit():
    objects = (replace(WALKER, since_s=1 / 3, until_s=2.0, confidence=0.1, score=math.nan), CAR)
    again = read_objects(object_values(objects))
    assert again is not None
    for a, b in zip(objects, again, strict=True):
        assert a.T_world_object.equal(b.T_world_object)
        values = [(each.name, each.category, each.size_m, each.since_s, each.until_s, each.confidence) for each in (a, b)]
        assert values[0] == values[1] and b.score == pytest.approx(a.score, nan_ok=True)
    assert read_objects(object_values(())) == () and read_objects(object_values(None)) is None


def test_times_of_objects_count_from_the_start():
    class Epoch:
        def start(self) -> tuple[None, Arrivals]:
            return None, Arrivals(1e9, objects=track_objects((), [WALKER], 1e9))

        def show(self, state: None, exposure: object) -> tuple[None, Arrivals]:
            raise NotImplementedError

    _, arrivals = FromZero(Epoch(), "epoch", CameraParams(), torch.zeros(1)).start()
    assert arrivals.objects is not None and (arrivals.objects[0].since_s, arrivals.objects[0].until_s) == (0.0, math.inf)
