"""What is composed of functions, and that lighting tables are read as scenario files write them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from pydantic import ValidationError

from luxloop.controllers.functions.planner import LightingParams, Planner
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised
from tests.controllers.situations import car, now
from tests.refusal import refusal

CAR = car(40.0, 2.5)
FUNCTIONS = {
    "guard": {"kind": "glare_free"},
    "borders": {"kind": "lane", "style": "lines", "priority": 5},
    "arrow": {"kind": "symbol", "image": "arrow", "modules": ("hires",), "priority": 10},
}


@pytest.fixture
def find(tmp_path: Path):  # type: ignore[no-untyped-def]
    cv2.imwrite(str(tmp_path / "arrow.png"), np.full((8, 8), 255, np.uint8))
    return lambda name: tmp_path / f"{name}.png"


def test_all_functions_come_together(find):  # type: ignore[no-untyped-def]
    planner = Planner.prepare(FUNCTIONS, LightingParams(base={"beam": "high"}), find)
    plan = planner.plan(now(CAR))
    assert plan.base.name == "high" and plan.primitives is not None
    assert len(plan.primitives) == 6 + 2 + 1 and plan.primitives.origin.dtype == torch.float32
    assert plan.primitives.priority.tolist() == sorted(plan.primitives.priority.tolist())
    hires, lores = plan.for_module("left hires"), plan.for_module("left lores")
    assert hires is not None and lores is not None and (len(hires), len(lores)) == (9, 8)
    nothing = Planner.prepare({"guard": {"kind": "glare_free"}}, LightingParams()).plan(now())
    assert nothing.primitives is None and nothing.for_module("left") is None


def test_a_symbol_is_never_drawn_on_a_masked_car(find):  # type: ignore[no-untyped-def]
    """However high its priority is, and though it is forced."""
    symbol = {"kind": "symbol", "image": "arrow", "x_m": 40.0, "y_m": 2.5, "width_m": 6, "length_m": 20, "priority": 100, "forced": True}
    situation = now(CAR)
    masked, drawn = (
        Planner.prepare(functions, LightingParams(), find).plan(situation).primitives
        for functions in ({"guard": {"kind": "glare_free"}}, {"guard": {"kind": "glare_free"}, "arrow": symbol})
    )
    assert masked is not None and drawn is not None
    light = idealised(60, 200)
    ssc, T = Ssc.prepare(light, default=torch.ones(light.n_pixels)), pose_from_degrees((0.0, 0.6, 0.75))
    dark = ssc.utilisation(masked, T).u == 0
    assert dark.sum() > 20
    assert not ssc.utilisation(drawn, T).u[dark].any()


def test_bad_tables_are_refused(tmp_path):
    with pytest.raises(ValidationError, match="glare_free"):
        Planner.prepare({"guard": {"kind": "glarefree"}}, LightingParams())
    with pytest.raises(ValidationError, match="margin"):
        Planner.prepare({"guard": {"kind": "glare_free", "margin": 1}}, LightingParams())
    with refusal("does not exist"):
        Planner.prepare({"arrow": {"kind": "symbol", "image": "nothing"}}, LightingParams(), lambda name: tmp_path / name)
