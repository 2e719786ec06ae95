"""Modules, their movements, and the light of a whole lamp in photometry's angles."""

import math

import pytest
import torch

from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module, direction
from luxloop.world.lamps.presets import idealised
from luxloop.world.texels import TexelGrid
from tests.refusal import refusal


@pytest.fixture(scope="module")
def headlight() -> Headlight:
    return idealised(5, 9, texels_per_pixel=(4, 4))


def test_angles_run_to_the_right_and_up():
    d = direction(torch.tensor([0.0, 90.0, 0.0]), torch.tensor([0.0, 0.0, 90.0]))
    expected = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, 1]]).double().T
    torch.testing.assert_close(d, expected, rtol=0, atol=1e-15)


def test_bending_to_the_left_moves_the_light_to_the_left_and_levelling_moves_it_down(headlight):
    module = Module("main", headlight, swivel_deg=(-5, 5), level_deg=(-2, 2))
    u = torch.zeros(headlight.n_pixels)
    u[2 * 9 + 4] = 1.0
    h, v = torch.meshgrid(torch.linspace(-15, 15, 121), torch.linspace(-6, 6, 97), indexing="xy")

    def centroid(swivel_deg: float, level_deg: float) -> tuple[float, float]:
        turned = Module("main", headlight, module.pose(swivel_deg, level_deg))
        light = Lamp("lamp", (turned,)).intensity((u,), direction(h, v).flatten(1)).view(h.shape)
        return float((light * h).sum() / light.sum()), float((light * v).sum() / light.sum())

    h0, v0 = centroid(0, 0)
    h1, v1 = centroid(3, 1)
    # Angles are sampled every quarter of a degree of a light that is 2 x 1 deg wide.
    assert (h1 - h0, v1 - v0) == pytest.approx((-3, -1), abs=0.02)


def test_a_movement_out_of_range_names_the_module(headlight):
    with refusal(r"'main'.*level.*0 to 2"):
        Module("main", headlight, level_deg=(0, 2)).pose(level_deg=3.0)


def test_modules_add_up_and_the_mirrored_one_lights_the_other_side(headlight):
    aside = Module("aside", headlight, pose_from_degrees((0, 0.1, 0), yaw_deg=8), swivel_deg=(-1, 4))
    other = aside.mirror()
    assert other.swivel_deg == (-4, 1)
    assert other.T_lamp_module[1, 3] == -0.1
    lamp = Lamp("both", (aside, other))
    h, v = torch.meshgrid(torch.linspace(-20, 20, 81), torch.linspace(-2, 1, 7), indexing="xy")
    light = lamp.intensity(lamp.beam("full"), direction(h, v).flatten(1)).view(h.shape)
    torch.testing.assert_close(light, light.flip(1), rtol=1e-6, atol=1e-3)
    alone = Lamp("one", (aside,)).intensity((torch.ones(headlight.n_pixels),), direction(h, v).flatten(1)).view(h.shape)
    assert float((alone * h).sum() / alone.sum()) == pytest.approx(-8, abs=0.1)
    torch.testing.assert_close(light, alone + alone.flip(1), rtol=1e-6, atol=1e-3)


def test_grids_from_degrees_refuse_what_is_no_plane():
    grid = TexelGrid.from_degrees(2, 4, 20, -10, -5, 5)
    assert (grid.left, grid.right, grid.top) == pytest.approx(tuple(math.tan(math.radians(a)) for a in (20, -10, 5)))
    with refusal("80 deg"):
        TexelGrid.from_degrees(2, 4, 85, -10, -5, 5)
    with refusal("left must exceed right"):
        TexelGrid.from_degrees(2, 4, -20, 20, -5, 5)


def test_the_field_is_that_of_all_modules_as_they_are_mounted(headlight):
    assert Lamp("one", (Module("main", headlight),)).field_deg == pytest.approx((10, -10, -3.5, 1.5), abs=1e-9)
    turned = Module("aside", headlight, pose_from_degrees((0, 0, 0), yaw_deg=20, pitch_deg=1))
    left, right, bottom, top = Lamp("two", (Module("main", headlight), turned)).field_deg
    # A pitched field's corners do not lie exactly at the angles of its borders.
    assert (left, right, bottom, top) == pytest.approx((30, -10, -4.5, 1.5), abs=0.1)


def test_a_turned_lamp_has_what_can_be_turned_where_its_pose_says(headlight):
    mount = pose_from_degrees((0.0, 0.1, 0.0), pitch_deg=0.5)
    fixed, free = Module("fixed", headlight, mount), Module("free", headlight, mount, swivel_deg=(-5, 5))
    one, other = Lamp("lamp", (fixed, free)).turn(4.0, 1.0).modules
    tilt = pose_from_degrees((0.0, 0.0, 0.0), pitch_deg=1.0)
    assert one.T_lamp_module.equal(tilt @ mount), "it cannot move, and tilts with the lamp"
    assert other.T_lamp_module.equal(tilt @ free.pose(4.0)), "it swivels"
    with refusal("'free': swivel of 4"):
        Lamp("lamp", (other,)).modules[0].pose(4.0)
    with refusal("'free': swivel of 6"):
        Lamp("lamp", (fixed, free)).turn(6.0, 0.0)
