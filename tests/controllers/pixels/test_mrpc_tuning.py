"""Tuning of MapReduce control: the part of a lamp that matters, the equations entry by entry, and what the search finds."""

import itertools

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from numpy.typing import NDArray
from torch.testing import assert_close

from luxloop.controllers.pixels.mrpc_tuning import RANGES, Part, TextureControl, Trial, part, tune
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import rectangle
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.perception.metrics import mae
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr
from tests.refusal import refusal

Array = NDArray[np.float64]
ROWS, COLS, PIXELS = 6, 9, 10


@pytest.fixture
def light() -> Headlight:
    """Pixels of random shapes on a few texels each, a third of all entries."""
    rng = np.random.default_rng(0)
    dense = rng.uniform(0.2, 4, (ROWS * COLS, PIXELS)) * (rng.random((ROWS * COLS, PIXELS)) < 0.3)
    dense[:, 3] = 0
    dense[5, 3] = 2.0  # a pixel of a single texel
    matrix = Csr.from_scipy(sp.csr_matrix(dense))
    return Headlight(
        name="small", rows=ROWS, cols=COLS, left=0.3, right=-0.2, top=0.1, bottom=-0.2, matrix=matrix, pixel_rows=2, pixel_cols=5
    )


@pytest.fixture
def wanted() -> torch.Tensor:
    texture = torch.zeros(ROWS, COLS)
    texture[0:3, 3:7] = 3.0
    texture[1, 4] = 1.5
    return texture


def plainly(I_m: Array, s: Array, trial: Trial) -> Array:
    """T eq. 7.4.1, 7.4.3 and 7.4.5 texel by texel; s: `[rows, cols]`."""
    n_t, n_p = I_m.shape
    cols = s.shape[1]
    s = s.ravel()
    u = np.zeros(n_p)
    for j in range(n_p):
        kept = [i for i in range(n_t) if I_m[i, j] > 0 and I_m[i, j] >= trial.a_x * I_m[:, j].max()]
        if trial.shape == "rectangle":
            rows, columns = {i // cols for i in kept}, {i % cols for i in kept}
            box = itertools.product(range(min(rows), max(rows) + 1), range(min(columns), max(columns) + 1))
            kept = [r * cols + c for r, c in box if I_m[r * cols + c, j] > 0]
        numerator = denominator = 0.0
        for i in kept:
            share = 1.0
            if trial.a_m is not None:
                share = I_m[i, j] ** trial.a_m / sum(I_m[i, k] ** trial.a_m for k in range(n_p) if I_m[i, k] > 0)
            numerator += I_m[i, j] ** trial.a_r * min(share * s[i] / I_m[i, j], 1)
            denominator += I_m[i, j] ** trial.a_r
        u[j] = numerator / denominator
    return u


def whole(headlight: Headlight, some: Part, u: torch.Tensor) -> Array:
    utilisation = np.zeros(headlight.n_pixels)
    utilisation[some.pixels] = u
    return utilisation


TRIALS = [
    Trial(a_m, a_x, a_r, shape)
    for a_m, a_x, a_r in itertools.product((None, 0.0, 1.0, 1.7), (0.0, 0.43, 1.0), (0.0, 1.0, 2.6))
    for shape in ("arbitrary", "rectangle")
]


@pytest.mark.parametrize("trial", TRIALS, ids=str)
def test_utilisations_follow_the_equations(trial, light, wanted):
    I_m = light.matrix.to_scipy().toarray().astype(float)
    some = part(light, wanted)
    found = whole(light, some, TextureControl(some).utilisation(trial))
    np.testing.assert_allclose(found, plainly(I_m, wanted.double().numpy(), trial), atol=1e-5)  # powers up to 4.3 in float32


def test_a_part_gives_the_light_of_the_whole(light, wanted):
    wanted[1:, :] = 0
    wanted[:, 5:] = 0
    some = part(light, wanted)
    assert 0 < some.headlight.n_pixels < PIXELS
    u = torch.rand(some.headlight.n_pixels, generator=torch.Generator().manual_seed(0))
    texture = torch.zeros(ROWS, COLS)
    texture[some.window] = some.headlight.light_texture(u)
    assert_close(texture, light.light_texture(torch.from_numpy(whole(light, some, u)).float()))
    assert_close(some.wanted, wanted[some.window])
    assert some.wanted.sum() == wanted.sum()
    for axis, of_part, of_whole in zip((1, 0), *(grid.tangents() for grid in (some.headlight, light)), strict=True):
        assert_close(of_part, of_whole[some.window[axis]])


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"a_m": 0.4, "a_r": 0.0},
        {"a_m": 1.6, "a_r": 2.3, "a_x": 0.37},
        {"a_m": 1.3, "granularity": 0.8, "a_ac": 0.06},
        {"sharpening": 1.3, "a_r": 0.5},
        {"corrections": 2, "a_x": 0.3, "a_ac": 0.06, "sharpening": 0.7},
    ],
    ids=str,
)
def test_the_lamps_own_control_does_the_same(values, light):
    """A primitive of constant luminous intensity across the lamp's axis lights the texels whose centres it covers."""
    left, bottom, width, height = 0.22, -0.06, 0.12, 0.06
    corner, d1, d2 = (10.0, 10 * left, 10 * (bottom + height)), (0.0, -10 * width, 0.0), (0.0, 0.0, -10 * height)
    primitive = rectangle(corner, d1, d2, 2.5, "I_v", normal=(-1.0, 0.0, 0.0))
    y, z = light.tangents(torch.float32, torch.device("cpu"))
    inside = ((y < left) & (y > left - width)) & ((z > bottom) & (z < bottom + height))[:, None]
    some = part(light, 2.5 * inside.float())
    assert some.headlight.n_pixels < PIXELS
    found = whole(light, some, TextureControl(some).utilisation(Trial(**values)))
    driven = Ssc.prepare(light, MrpcParams(**values)).utilisation(primitive, torch.eye(4)).u
    assert found.any()
    np.testing.assert_allclose(found, driven, atol=1e-5)  # float32 both


def test_light_beside_the_lamp_is_refused(light, wanted):
    with refusal(r"no pixel of 'small' reaches"):
        part(light, torch.zeros_like(wanted))


def test_tuning_finds_the_least_error_of_a_grid_or_better(light, wanted):
    some = part(light, wanted)
    control = TextureControl(some)

    def cost(trial: Trial) -> float:
        return float(mae(some.headlight.light_texture(control.utilisation(trial)), some.wanted))

    axes = [np.linspace(*RANGES[name], 9) for name in ("a_m", "a_x", "a_r")]
    least = min(cost(Trial(*map(float, values))) for values in itertools.product(*axes))
    best = tune(cost)
    assert cost(best) <= least * (1 + 1e-3)
    assert best == tune(cost)
    assert all(low <= getattr(best, name) <= high for name, (low, high) in RANGES.items())
    start = Trial(None, 0.5, 1.0, "rectangle")
    some_tuned = tune(cost, start, ("a_x",))
    assert (some_tuned.a_m, some_tuned.a_r, some_tuned.shape) == (None, 1.0, "rectangle")
    assert cost(some_tuned) <= cost(start)
