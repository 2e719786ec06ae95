"""Painted utilisations: over the functions or in their place, in every module alone; what does not fit is named."""

import base64
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from luxloop import Utilisation
from luxloop.controllers.functions.base_beams import PaintedParams, PaintLayer
from luxloop.loop.simulation.result import StepResult
from tests.loop.conftest import simulated, toml, van
from tests.refusal import sentence

ROWS, COLUMNS = 3, 28  # pixels of hd84
RNG = np.random.default_rng(3)
VALUE = RNG.integers(0, 256, (ROWS, COLUMNS)).astype(np.uint8)
HALF = np.where(np.arange(COLUMNS) < COLUMNS // 2, 255, 0).astype(np.uint8) * np.ones((ROWS, 1), np.uint8)
GUARDED = {"objects": [van((30.0, 3.0, 180.0))], "functions": {"guard": {"kind": "glare_free"}}}


PAINTED = """
name = "painted"
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 160, height_px = 90 }
lighting.base.beam = "full"
"""


def shown(*painted: PaintedParams | dict[str, Any], **changes: Any) -> StepResult:
    tables = [each if isinstance(each, dict) else each.model_dump() for each in painted]
    lighting = {"painted": tables, "base": {"beam": "full"}} | changes.pop("lighting", {})
    return simulated(PAINTED, lighting=lighting, **changes).at(0)


def given(share: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(share).flatten().float() / 255


def test_pictures_come_back_bit_for_bit():
    cover = RNG.integers(0, 256, (ROWS, COLUMNS)).astype(np.uint8)
    value, painted = PaintedParams.of("left matrix", VALUE, cover, True).pictures
    assert (value == VALUE).all() and (painted == cover).all()


@pytest.mark.parametrize("over", [True, False])
def test_what_is_painted_holds_below_masks_and_the_rest_is_what_functions_give(over):
    plain, guarded = shown().lights, shown(**GUARDED).lights
    left, right = shown(PaintedParams.of("left matrix", VALUE, HALF, over), **GUARDED).lights
    assert not guarded[0].equal(plain[0]) and right.equal(guarded[1])
    painted = given(HALF) > 0
    limit = guarded[0] if over else torch.ones(ROWS * COLUMNS)  # below the mask, the base beam is full
    assert (guarded[0] == 0)[painted].any()
    torch.testing.assert_close(left[painted], given(VALUE).minimum(limit)[painted], rtol=0, atol=1e-7)  # single precision
    assert left[~painted].equal(guarded[0][~painted] if over else torch.zeros(int((~painted).sum())))


@pytest.mark.parametrize("over", [True, False])
@pytest.mark.parametrize("band", [None, slice(0, 0), slice(3, 9), slice(70, 84)])
def test_outside_the_band_all_is_dark(over, band):
    value, cover = np.zeros((ROWS, COLUMNS), np.uint8), np.zeros((ROWS, COLUMNS), np.uint8)
    value[1, 5:9], cover[1, 2:12] = 200, 255
    below = torch.zeros(2, ROWS * COLUMNS)
    below[:, band or slice(None)] = 0.5
    light = PaintLayer.of(PaintedParams.of("left matrix", value, cover, over)).on(Utilisation(below, band))
    assert light.u.shape == below.shape and light.u[0, COLUMNS + 5] == pytest.approx(200 / 255)
    if light.band is not None:
        outside = torch.ones(ROWS * COLUMNS, dtype=torch.bool)
        outside[light.band] = False
        assert not light.u[:, outside].any()
    assert (light.band is None) == (over and band is None)


def test_the_power_limit_holds():
    all_ = np.full((ROWS, COLUMNS), 255, np.uint8)
    painted = [PaintedParams.of(f"{side} matrix", all_, all_, False) for side in ("left", "right")]
    result = shown(*painted, lighting=toml("{ power_limit = 0.25, base.beam = 'off' }"))
    assert all(power.share == pytest.approx(0.25) for power in result.powers.values())


def png(image: np.ndarray, suffix: str = ".png") -> str:
    return base64.b64encode(cv2.imencode(suffix, image)[1].tobytes()).decode()


GOOD = PaintedParams.of("left matrix", VALUE, HALF, True).model_dump()
WRONG = {
    "png: is no base64": [GOOD | {"png": "%%%"}],
    "transparency": [GOOD | {"png": png(VALUE)}],
    "png: has 4 x 28": [GOOD | {"png": png(np.zeros((4, 28, 4), np.uint8))}],
    "painted[0].module": [GOOD | {"module": "left hires"}],
    "painted[1].module": [GOOD, GOOD],
}


@pytest.mark.parametrize(("words", "painted"), WRONG.items(), ids=WRONG)
def test_what_does_not_fit_is_named_in_a_sentence(words, painted):
    with sentence("lighting.painted[", words):
        shown(*painted)
