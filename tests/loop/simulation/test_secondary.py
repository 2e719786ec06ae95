"""Lamps share what they draw together, make up for each other, and draw for an observer, in whole scenarios."""

from typing import Any

import pytest
import torch

from luxloop import Simulation
from luxloop.loop.simulation.light_figures import WIDTH_PX, picture_view
from luxloop.loop.simulation.result import StepResult
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import box, simulated, toml

CARPET = toml("{ kind = 'lane', quantity = 'E_v', value = 1.0, lane_width_m = 3.0, near_m = 14.0, far_m = 30.0 }")
WANTED_LX = 1.0  # a single lamp of 50 kcd can give it up to 33 m ahead
PATCH = (18.0, 26.0, 1.0)  # from, to and half the width in m, well inside of the carpet
BARRIER = box("barrier", (0.1, 0.5, 0.9), (12.0, 0.6, 0.0), albedo=0.2)


BASE = f"""
name = "carpet"
renderer = "raycast"
headlight.model = "{SMALL_LAMP}"
camera = {{ width_px = 320, height_px = 180, hfov_deg = 20, pitch_deg = 4.0, z_m = 2.5 }}
surface.grain = 0.0
"""


def run(*overrides: str, function: dict[str, Any] = CARPET, **changes: Any) -> tuple[Simulation, StepResult]:
    simulation = simulated(BASE, *overrides, functions={"drawn": function}, **changes)
    return simulation, simulation.at(0)


def on_road(simulation: Simulation, result: StepResult, aside_m: float = 0.0) -> float:
    """Mean illuminance in lx of a patch in the middle of the carpet."""
    surfaces = simulation.world.lit(0.0).surfaces
    x, y, _ = surfaces.position
    near, far, half = PATCH
    there = (surfaces.object_id == 0) & (x > near) & (x < far) & ((y - aside_m).abs() < half / 2)
    assert there.sum() > 100
    return float(result.illuminance[there].mean())


def test_lamps_share_a_setpoint_so_that_light_is_not_doubled():
    """idealised pixels are 0.06 deg wide, 2 m of road at 26 m, so the mean over the patch keeps to the setpoint within some percent."""
    shared, doubled = (on_road(*run(f"lighting.share={share}")) for share in ("true", "false"))
    assert shared == pytest.approx(WANTED_LX, rel=0.06)
    assert doubled == pytest.approx(2 * shared, rel=0.02)


def test_a_lamp_makes_up_for_one_that_is_blocked():
    given = ("false", "true")
    dim, made_up = (on_road(*run(f"lighting.shadow_rays={rays}", objects=[BARRIER]), aside_m=0.4) for rays in given)
    assert dim < 0.8 * WANTED_LX < made_up


def test_street_light_is_taken_off():
    lamp = "light.street_lamps=[{ position_m=[22.0, 0.0, 8.0], intensity_cd=19.2 }]"
    with_offset, without = (on_road(*run(f"lighting.street_lamps={off}", lamp)) for off in ("true", "false"))
    assert without - with_offset == pytest.approx(19.2 / 64, rel=0.15)  # E = I / h^2 right below; less towards the patch's ends


def test_an_observer_sees_the_picture_upright():
    """The light is where the observer's picture is bright: nothing of it lies on the road before the picture's lower edge."""
    picture = toml("{ centre_m = [15.0, 0.0, 0.5], width_m = 1.0, height_m = 0.4, eye_m = [-1.6, 0.0, 1.4] }")
    symbol = {"kind": "symbol", "image": "warning_triangle", "observer": picture}
    simulation, result = run(function=symbol)
    x, y, _ = simulation.world.lit(0.0).surfaces.position[:, result.illuminance > 0.5]
    assert len(x) > 50
    # The picture's lower edge at z = 0.3 m is seen on the road at x = -1.6 + 16.6 * 1.4 / 1.1, its upper one at 0.7 m at 31.6 m.
    assert float(x.min()) > 19.5 - 0.6 and float(x.max()) < 31.6 + 1.5
    assert float(y.abs().max()) < 0.5 * 33.2 / 16.6 + 0.2


def test_the_wanted_picture_fills_the_observers_camera():
    eye, origin, d1, d2 = torch.tensor([[-1.0, 0.3, 1.3], [10.0, 0.8, 1.0], [0.3, -1.6, 0.0], [0.0, 0.0, -0.6]], dtype=torch.float64)
    view = picture_view(eye, origin, d1, d2)
    uv, depth = view.project(torch.stack([origin, origin + d1, origin + d1 + d2, origin + d2], -1))
    width, height = float(WIDTH_PX), float(view.height)
    torch.testing.assert_close(uv, torch.tensor([[0, width, width, 0], [0, 0, height, height]]).double(), rtol=0, atol=1e-6)
    assert (depth > 0).all() and height == round(WIDTH_PX * 0.6 / float(d1.norm()))
