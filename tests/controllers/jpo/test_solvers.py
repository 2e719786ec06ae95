"""Joint pixel optimisation: the optimum is one, bounds and masks hold, and a start is never made worse."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, lsq_linear
from torch.testing import assert_close

from luxloop.controllers.pixels.jpo_solvers import MoorePenrose, PixelGoal, least_error, least_squares, pixel_goal
from luxloop.perception.metrics import mae, rmse
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.patterns import RECTANGLES
from luxloop.world.lamps.presets import lamp
from luxloop.world.spmv import Csr, multiply
from luxloop.world.texels import TexelGrid
from tests.refusal import refusal


def headlight_of(A: np.ndarray, rows: int = 1) -> Headlight:
    """A made-up lamp with this matrix."""
    matrix = Csr.from_scipy(sp.csr_matrix(A), torch.float64)
    grid = TexelGrid(rows=rows, cols=matrix.n_rows // rows, left=0.1, right=-0.1, top=0.05, bottom=-0.05)
    return Headlight(**asdict(grid), name="made up", matrix=matrix, pixel_rows=1, pixel_cols=matrix.n_cols)


def random_problem(seed: int, n_t: int = 40, n_p: int = 12) -> tuple[Headlight, PixelGoal]:
    """A lamp of a few overlapping pixels, weights from 0 on, and setpoints some of which are dark and some out of reach."""
    rng = np.random.default_rng(seed)
    A = rng.uniform(0.1, 2.0, (n_t, n_p)) * (rng.random((n_t, n_p)) < 0.3)
    target = rng.uniform(0, 2, n_t) * (rng.random(n_t) < 0.6)
    weight = rng.uniform(0, 2, n_t) * (rng.random(n_t) < 0.9)
    light = headlight_of(A)
    return light, pixel_goal(light, torch.from_numpy(target)[None], torch.from_numpy(weight)[None])


def linear_programme(A: sp.csr_matrix, target: np.ndarray, weight: np.ndarray) -> float:
    """The least weighted sum of absolute deviations, every texel with a slack of its own."""
    n_t, n_p = A.shape
    slack = sp.eye_array(n_t)
    best = linprog(
        np.r_[np.zeros(n_p), weight],
        A_ub=sp.vstack([sp.hstack([A, -slack]), sp.hstack([-A, -slack])]).tocsr(),
        b_ub=np.r_[target, -target],
        bounds=[(0, 1)] * n_p + [(0, None)] * n_t,
        method="highs",
    )
    return float(best.fun)


def test_the_check_values_of_one_pixel():
    light = headlight_of(np.array([[0.13], [0.35], [0.95], [1.3]]))
    texture = torch.tensor([[0.0, 0.0, 1.0, 1.0]], dtype=torch.float64)
    goal = pixel_goal(light, texture)
    found = least_error(light.matrix, goal, gap=1e-6)
    assert float(found.u[0]) == pytest.approx(1 / 1.3, abs=1e-4)
    assert float(least_squares(light.matrix, goal, tolerance=1e-9)) == pytest.approx(2.25 / 2.7319, abs=1e-6)
    assert float(MoorePenrose.prepare(light).utilisation(texture)) == pytest.approx(2.25 / 2.7319, abs=1e-9)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_least_error_of_any_lamp_is_that_of_a_linear_programme(seed):
    """All texels and pixels are in the programme: what the solver leaves out beforehand costs nothing."""
    light, goal = random_problem(seed)
    found = least_error(light.matrix, goal, gap=1e-4)
    least = linear_programme(light.matrix.to_scipy(), goal.target.numpy(), goal.weight.numpy())
    assert float(found.error) == pytest.approx(least, rel=1e-4, abs=1e-9)
    assert float(found.bound) <= least + 1e-9
    direct = (goal.weight * (multiply(light.matrix, found.u) - goal.target).abs()).sum()
    assert float(found.error) == pytest.approx(float(direct), rel=1e-9)
    assert ((found.u >= 0) & (found.u <= 1)).all()


def test_the_proof_holds_for_16_k_pixels():
    light = lamp("ssl-hd-lores").modules[0].headlight
    texture = RECTANGLES[700].texture(light)
    found = least_error(light.matrix, pixel_goal(light, texture))
    assert found.bound >= 0.995 * found.error and found.iterations < 1500
    assert found.entries < 0.05 * len(light.matrix.values), "the rest is decided beforehand"
    assert float(mae(light.light_texture(found.u), texture)) == pytest.approx(float(found.error / texture.sum()), rel=1e-4)


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), iterations=st.integers(1, 30))
def test_a_start_is_never_made_worse_and_bounds_hold(seed, iterations):
    light, goal = random_problem(seed)
    goal = replace(goal, start=torch.rand(light.n_pixels, generator=torch.Generator().manual_seed(seed)).double())
    before = (goal.weight * (multiply(light.matrix, goal.start) - goal.target).abs()).sum()
    found = least_error(light.matrix, goal, iterations=iterations, gap=None)
    assert found.error <= before + 1e-9
    assert found.iterations == iterations or not found.entries
    assert ((found.u >= 0) & (found.u <= 1)).all()


def test_a_batch_gives_what_its_entries_give(device):
    light, _ = random_problem(1)
    light = light.to(device)
    textures = torch.rand(3, 2, 1, light.cols, generator=torch.Generator().manual_seed(2)).double().to(device)
    textures *= textures > 0.4
    textures[0, 0, :, :20] = textures[1, 1, :, 20:] = textures[2, 0] = 0  # what one entry needs is nothing to another
    goal = pixel_goal(light, textures)
    found = least_error(light.matrix, goal, gap=1e-4)
    squares = least_squares(light.matrix, goal, iterations=2000, tolerance=1e-8)
    assert found.u.shape == (3, 2, light.n_pixels) and found.error.shape == (3, 2)
    for k in np.ndindex(3, 2):
        alone = least_error(light.matrix, pixel_goal(light, textures[k]), gap=1e-4)
        assert_close(found.error[k], alone.error, rtol=2e-4, atol=0)
        assert_close(squares[k], least_squares(light.matrix, pixel_goal(light, textures[k]), 2000, 1e-8), rtol=0, atol=1e-4)


@pytest.mark.parametrize(("seed", "every"), [*((seed, 1) for seed in range(5)), (4, 2)])
def test_free_pixels_reach_the_optimum_of_scipy_and_others_keep_their_light(seed, every):
    light, goal = random_problem(seed)
    free = torch.arange(light.n_pixels) % every == 0
    goal = replace(goal, free=free, start=torch.full((light.n_pixels,), 0.3, dtype=torch.float64))
    A, rest = light.matrix.to_scipy().toarray(), light.matrix.to_scipy().toarray()[:, ~free.numpy()].sum(1) * 0.3
    found = least_error(light.matrix, goal, gap=1e-6)
    squares = least_squares(light.matrix, goal, iterations=20_000, tolerance=1e-12)
    assert torch.equal(found.u[~free], goal.start[~free]) and torch.equal(squares[~free], goal.start[~free])
    least = linear_programme(sp.csr_matrix(A[:, free.numpy()]), goal.target.numpy() - rest, goal.weight.numpy())
    assert float(found.error) == pytest.approx(least, rel=2e-6)
    root = goal.weight.sqrt().numpy()
    expected = lsq_linear(root[:, None] * A[:, free.numpy()], root * (goal.target.numpy() - rest), (0, 1), tol=1e-14)
    residual = root * (A @ squares.numpy() - goal.target.numpy())
    assert 0.5 * residual @ residual == pytest.approx(expected.cost, rel=1e-8)


def test_a_masked_texel_stays_dark_whatever_it_costs():
    light, goal = random_problem(5)
    weight = goal.weight.clone()
    at = int(goal.target.argmin())
    assert goal.target[at] == 0
    weight[at] = torch.inf
    masked = pixel_goal(light, goal.target[None], weight[None])
    for u in (least_error(light.matrix, masked).u, least_squares(light.matrix, masked)):
        assert multiply(light.matrix, u)[at] == 0
        assert u.sum() > 0


def test_the_pseudo_inverse_is_least_squares_where_nothing_is_clamped():
    light, _ = random_problem(7)
    u = torch.rand(2, light.n_pixels, generator=torch.Generator().manual_seed(7)).double()
    assert_close(MoorePenrose.prepare(light).utilisation(light.light_texture(u)), u, rtol=0, atol=1e-9)
    assert MoorePenrose.prepare(light).utilisation(1000 * light.light_texture(u)).max() == 1


def test_textures_and_starts_that_do_not_fit_are_refused_in_a_sentence():
    light, _ = random_problem(8)
    with refusal(r"wanted light texture is of shape \[3, 40\]; 'made up' needs 1 rows by 40 columns"):
        pixel_goal(light, torch.zeros(3, 40))
    with refusal("weight of a wanted"):
        pixel_goal(light, torch.zeros(1, 40), torch.zeros(40, 1))
    with refusal("start has 3 pixels"):
        pixel_goal(light, torch.zeros(1, 40), start=torch.zeros(3))
    with refusal("16384 pixels; it is for lamps of at most 2000: use least squares"):
        MoorePenrose.prepare(lamp("ssl-hd-lores").modules[0].headlight)


def test_brighter_units_change_nothing():
    """The steps have no unit: a lamp and setpoints in millicandela give the same utilisations."""
    light, goal = random_problem(3)
    found = least_error(light.matrix, goal, iterations=25, gap=None)
    milli = light.matrix.with_values(light.matrix.values * 1000)
    again = least_error(milli, replace(goal, target=goal.target * 1000), iterations=25, gap=None)
    assert_close(again.u, found.u, rtol=0, atol=1e-9)


def test_clamping_the_pseudo_inverse_costs_quality():
    light = lamp("hd84").modules[0].headlight
    texture = RECTANGLES[700].texture(light)
    clamped = MoorePenrose.prepare(light).utilisation(texture)
    squares = least_squares(light.matrix, pixel_goal(light, texture), tolerance=1e-6)
    assert rmse(light.light_texture(squares), texture) < rmse(light.light_texture(clamped), texture)
