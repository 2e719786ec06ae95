"""Overlap reduction: light is conserved, least squares are never worse, and a dense reference agrees."""

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from luxloop.world.headlight.overlap import PULL, Method, errors, reduce, standard_use_cases
from luxloop.world.spmv import Csr
from tests.refusal import sentence

METHODS: tuple[Method, ...] = ("threshold", "proportional", "least_squares")
each_method = pytest.mark.parametrize("method", METHODS)


def random_matrix(rows: int, pixels: int, density: float, seed: int) -> Csr:
    """Entries of few different sizes, so that ties occur."""
    generator = np.random.default_rng(seed)
    dense = generator.integers(1, 9, (rows, pixels)) * (generator.random((rows, pixels)) < density)
    return Csr.from_scipy(sp.csr_array(dense * 10.0), torch.float64)


matrices = st.builds(random_matrix, st.integers(1, 12), st.integers(1, 10), st.floats(0, 1), st.integers(0, 1000))


def gaussian_lamp(pixels: int = 9, texels: int = 60) -> Csr:
    """A line of pixels that overlap widely."""
    at = np.linspace(0, pixels, texels)[:, None]
    return Csr.from_scipy(sp.csr_array(1000 * np.exp(-((at - np.arange(pixels) - 0.5) ** 2) / 2)), torch.float64)


def dense_reference(row: np.ndarray, keep: int, method: Method, cases: np.ndarray) -> np.ndarray:
    """One row, as T eq. 5.2.1 and 5.2.2 are written."""
    kept = sorted(sorted(range(len(row)), key=lambda j: (-row[j], j))[:keep])
    kept = [j for j in kept if row[j] > 0]
    out = np.zeros_like(row)
    if not kept:
        return out
    out[kept] = row[kept]
    lost = row.sum() - row[kept].sum()
    if method == "threshold":
        return out
    out[kept] += row[kept] / row[kept].sum() * lost
    if method == "least_squares" and lost > 0:
        seen = cases[:, kept]
        pull = np.sqrt(PULL * np.trace(seen.T @ seen) / len(kept)) * np.eye(len(kept))
        out[kept], _ = nnls(np.vstack([seen, pull]), np.concatenate([cases @ row, pull @ out[kept]]))
    return out


@each_method
@settings(max_examples=40)
@given(matrix=matrices, keep=st.integers(1, 6))
def test_agrees_with_a_dense_reference(method, matrix, keep):
    cases = np.array(standard_use_cases(1, matrix.n_cols))
    reduced = reduce(matrix, keep, method, cases).to_scipy().toarray()
    expected = np.array([dense_reference(row, keep, method, cases) for row in matrix.to_scipy().toarray()])
    # Where values turn negative, coordinate descent stops after a number of sweeps: 1e-6 of the largest value, 80 cd.
    tolerance = 8e-5 if method == "least_squares" else 1e-9
    np.testing.assert_allclose(reduced, expected, rtol=1e-9, atol=tolerance)


@given(matrix=matrices, seed=st.integers(0, 99), keep=st.integers(1, 4))
def test_least_squares_are_never_worse_where_they_were_fitted(matrix, seed, keep):
    cases = standard_use_cases(1, matrix.n_cols, randoms=3, seed=seed)
    proportional, fitted = (errors(matrix, reduce(matrix, keep, method, cases), cases).rmse for method in METHODS[1:])
    assert fitted <= proportional + 1e-12  # rounding of an error of zero
    full = [np.ones(matrix.n_cols)]
    assert errors(matrix, reduce(matrix, keep), full).rmse <= errors(matrix, reduce(matrix, keep, "threshold"), full).rmse + 1e-12


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"keep": 0}, "keep at least one"),
        ({"bound_cd": -1.0}, "must not be negative"),
        ({"keep": 1, "method": "least_squares"}, "there are none"),
        ({"keep": 1, "method": "least_squares", "use_cases": [np.ones(3)]}, "of 9 pixels each, not (1, 3)"),
    ],
)
def test_nonsense_is_refused(arguments, words):
    with sentence(words):
        reduce(gaussian_lamp(), **arguments)
