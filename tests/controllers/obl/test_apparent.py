"""What lamps see of an object, against errors of its distance and people beside it."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from luxloop.controllers.functions.object_based import Apparent
from luxloop.controllers.situation import TrackedObject
from luxloop.world.frames import pose_from_degrees

LAMPS = torch.tensor([[2.0, 0.6, 0.65], [2.0, -0.6, 0.65]], dtype=torch.float64)


def seen(x: float, y: float, height: float = 1.7, width: float = 0.6) -> Apparent:
    return Apparent.of(TrackedObject("person", "pedestrian", pose_from_degrees((2 + x, y, 0.0)), (0.4, width, height)), LAMPS)


@given(x=st.floats(5, 80), y=st.floats(-10, 10), error=st.floats(0.4, 2.5))
def test_an_error_of_the_distance_changes_nothing(x: float, y: float, error: float) -> None:
    """A box that fills the same part of the image is larger the farther away it is taken to be."""
    near, far = seen(x, y), seen(error * x, error * y, error * 1.7, error * 0.6)
    for name in ("bearing_rad", "width_rad", "height_rad"):
        assert getattr(far, name) == pytest.approx(getattr(near, name), rel=1e-9)
    assert near.same(far) and far.same(near)


@pytest.mark.parametrize(
    ("other", "same"), [((20, 1.5), True), ((20, 1.7), False), ((28, 1.4), True), ((34, 1.7), False), ((13, 0.65), False)]
)
def test_who_stands_beside_or_far_behind_is_somebody_else(other: tuple[float, float], same: bool) -> None:
    assert seen(20, 1.0).same(seen(*other)) == same
