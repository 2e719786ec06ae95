"""What of a symbol is cut at the borders of the lamps' field, in closed form: one lamp over a flat road, its field bounded by tangents."""

import math
from dataclasses import replace

import pytest
import torch

from luxloop.controllers.pixels.ssc import Ssc
from luxloop.controllers.symbol.sensing.field import SIDES, cut
from luxloop.controllers.symbol.sensing.projection import CELLS, ProjectionCommand, Warp
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector, SymbolParams
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised

HEIGHT_M = 0.75
WHITE = torch.ones(64, 32)
SSC = Ssc.prepare(idealised(pixel_cols=160))
FIELD = SSC.headlight
NEAREST_M = HEIGHT_M / -FIELD.bottom  # of what the lamp lights on a flat road, straight ahead
ROUNDED = 0.01  # 64 x 32 places are looked at


def projector(*pitches_deg: float, symbol: torch.Tensor = WHITE) -> Projector:
    modules = [DrawingModule(f"at {deg}", SSC, pose_from_degrees((0.0, 0.0, HEIGHT_M), pitch_deg=deg)) for deg in pitches_deg or (0.0,)]
    return Projector(tuple(modules), symbol, SymbolParams(image="white"), torch.tensor([-1.6, 0.0, 1.35]))


def drawn(x_m: float = 17.0, y_m: float = 0.0) -> ProjectionCommand:
    return ProjectionCommand(torch.tensor([x_m, y_m, 0.0, 0.0]))


def shares(*args: object) -> dict[str, float]:
    return dict(zip(SIDES, cut(*args).tolist(), strict=True))  # type: ignore[arg-type]


def test_a_symbol_within_the_field_is_not_cut():
    assert shares(projector(), drawn()) == dict.fromkeys(SIDES, 0.0)


@pytest.mark.parametrize("beyond_m", [0.5, 1.0, 3.0])
def test_what_is_too_near_is_cut_at_the_lower_border(beyond_m):
    found = shares(projector(), drawn(NEAREST_M - beyond_m + 2.0))  # 4 m long
    assert found["bottom"] == pytest.approx(beyond_m / 4, abs=ROUNDED)
    assert found["left"] == found["right"] == found["top"] == 0


@pytest.mark.parametrize("side", ["left", "right"])
def test_what_is_aside_is_cut_at_that_border(side):
    y_m = 17 * getattr(FIELD, side)  # half of it is beyond, by the mean of its length
    assert shares(projector(), drawn(y_m=y_m)) == pytest.approx({**dict.fromkeys(SIDES, 0.0), side: 0.5}, abs=ROUNDED)


def test_what_is_higher_than_the_field_is_cut_at_the_upper_border():
    above = replace(drawn(), z=torch.tensor(HEIGHT_M + 30 * FIELD.top))
    assert shares(projector(), above)["top"] == 1.0


def test_only_white_counts():
    near = torch.cat([torch.zeros(48, 32), torch.ones(16, 32)])  # a quarter of 4 m, the last 1 m
    found = shares(projector(symbol=near), drawn(NEAREST_M + 1.5))
    assert found["bottom"] == pytest.approx(0.5, abs=4 * ROUNDED)


@pytest.mark.parametrize("cells", [CELLS, (128, 256)])
def test_light_is_looked_for_where_the_warp_has_it(cells):
    """On a rectangle twice as long the symbol as it is covers the middle half."""
    v, u = (torch.linspace(-1 + 1 / n, 1 - 1 / n, n) for n in cells)
    source = torch.stack([u.expand(*cells), 2 * v[:, None].expand(*cells)])[None]
    warp = Warp(source, torch.ones_like(source[:, 0]), (8.0, 2.0))
    plain = drawn(NEAREST_M + 1.0)
    assert cut(projector(), replace(plain, warp=warp)) == pytest.approx(cut(projector(), plain), abs=2 * ROUNDED)


def test_what_another_module_lights_is_not_cut():
    down_deg = math.degrees(math.atan(FIELD.top) - math.atan(FIELD.bottom)) / 2
    near = drawn(NEAREST_M)
    assert shares(projector(), near)["bottom"] == pytest.approx(0.5, abs=ROUNDED)
    assert float(cut(projector(0.0, down_deg), near).sum()) == 0.0


def test_patterns_are_no_symbol():
    assert cut(projector(), replace(drawn(), raw=(torch.zeros(4),))).isnan().all()
