"""Rectangles of light at any place and in any attitude."""

import torch
from torch.testing import assert_close

from luxloop.controllers.functions.base_beams import BaseBeamParams
from luxloop.controllers.functions.planner import LightingParams, Planner
from luxloop.controllers.functions.symbol import PrimitiveParams, SymbolFunctionParams
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.controllers.situation import Situation
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised
from luxloop.world.symbols import Still

HERE = torch.eye(4, dtype=torch.float64)
LAMP = pose_from_degrees((0.0, 0.0, 0.75))


def now(T: torch.Tensor = HERE, time_s: float = 0.0) -> Situation:
    return Situation(time_s, T, LAMP[None, :3, 3], symbols={"a": Still(torch.eye(4))})


def test_on_the_road_it_is_a_symbol() -> None:
    given = {"image": "a", "x_m": 20.0, "y_m": 1.0, "yaw_deg": 30.0, "width_m": 2.0, "length_m": 6.0}
    (one,), (other,) = (kind(**given).primitives(now()) for kind in (PrimitiveParams, SymbolFunctionParams))
    for name in ("origin", "d1", "d2", "normal", "value", "priority"):
        assert_close(getattr(one, name), getattr(other, name))
    assert one.symbols[0].equal(other.symbols[0])


def test_upright_it_faces_the_car_with_its_first_row_on_top() -> None:
    (p,) = PrimitiveParams(x_m=25, y_m=1, z_m=1.5, pitch_deg=-90, width_m=2, length_m=3).primitives(now())
    assert_close(p.origin[0], torch.tensor([25.0, 2.0, 3.0]).double())
    assert_close(torch.stack([p.d1[0], p.d2[0]]), torch.tensor([[0.0, -2.0, 0.0], [0.0, 0.0, -3.0]]).double())
    assert_close(p.normal[0], torch.tensor([-1.0, 0.0, 0.0]).double())


def test_upright_it_lights_the_directions_in_which_it_is_seen() -> None:
    """A wall of light 20 m ahead, 4 m wide and 1 m high, is seen from the lamp at tangents of +-0.1 across and -0.01 +-0.025 up."""
    planner = Planner.prepare(
        {"wall": {"kind": "primitive", "x_m": 20, "z_m": 0.55, "pitch_deg": -90, "width_m": 4, "length_m": 1}},
        LightingParams(base=BaseBeamParams(beam="off")),
    )
    light = idealised(60, 200)
    drawn = planner.plan(now()).for_module("left")
    assert drawn is not None
    u = Ssc.prepare(light, default=torch.zeros(light.n_pixels)).utilisation(drawn, LAMP).u
    lit = light.light_texture(u) / light.light_texture(torch.ones_like(u))
    up, across = (
        (torch.linspace(a, b, 2 * n + 1)[1::2] - middle).abs()  # of the texels
        for a, b, n, middle in ((light.top, light.bottom, light.rows, -0.01), (light.left, light.right, light.cols, 0.0))
    )
    pixel = 0.002  # tangent of a pixel and a little more, by which an edge is blurred
    assert lit[up < 0.025 - pixel][:, across < 0.1 - pixel].min() > 0.99
    assert lit[up > 0.025 + pixel].max() == lit[:, across > 0.1 + pixel].max() == 0
