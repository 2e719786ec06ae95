"""Tuning of MapReduce control for one wanted light texture: the best a_m, a_x and a_r (T 8.4, 8.5).

A trial is little more than one pass over the entries of pixels that reach a lit setpoint. It takes a tenth of the time of
`luxloop.controllers.pixels.mrpc`, which transposes the matrix for each set of parameters; tests compare both.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.optimize import differential_evolution, minimize
from torch import Tensor

from luxloop.controllers.pixels.mrpc import FAINT
from luxloop.controllers.pixels.pixel_major import pixel_spread
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr

Floats = NDArray[np.float32]
THESIS = ("a_m", "a_x", "a_r")  # the parameters tuned in T 8.4
OPTIONS = ("a_x", "a_ac", "sharpening")  # further parameters that help most, by our evaluation
RANGES: Mapping[str, tuple[float, float]] = {
    **dict(zip(THESIS, ((0.0, 2.0), (0.0, 1.0), (0.0, 3.0)), strict=True)),
    "a_ac": (0.0, 1.0),
    "granularity": (0.0, 4.0),
    "sharpening": (0.0, 4.0),
}
POPULATION, GENERATIONS, REFINEMENTS = 10, 40, 80  # individuals a parameter, generations, evaluations of the final local search


@dataclass(frozen=True)
class Part:
    """The pixels of a headlight that reach a wanted light texture, and their part of the texture.

    headlight: these pixels as one row, with their part of the texture. wanted: `[rows, cols]` cd on this part. pixels: `[n]` int64, indices
    in the whole headlight. window: row and column slices of the part in the whole texture. spread: standard deviation in texels of a
    typical pixel's light in rows and columns, for sharpening.
    """

    headlight: Headlight
    wanted: Tensor
    pixels: Tensor
    window: tuple[slice, slice]
    spread: tuple[float, float]


def part(headlight: Headlight, wanted: Tensor) -> Part:
    """The part of a headlight for a wanted light texture `[rows, cols]` in cd. Raises LuxloopError if no pixel reaches it."""
    lit = (wanted.flatten() > 0).cpu().numpy()
    pixels = np.unique(headlight.matrix.to_scipy()[lit].indices)
    if not len(pixels):
        raise LuxloopError(f"no pixel of {headlight.name!r} reaches the wanted light: place it inside the lamp's field")
    columns = headlight.matrix.transpose.to_scipy()[pixels]
    touched = lit.copy()
    touched[columns.indices] = True
    rows, cols = (np.flatnonzero(touched.reshape(headlight.rows, headlight.cols).any(axis)) for axis in (1, 0))
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)
    texels = np.arange(headlight.n_texels).reshape(headlight.rows, headlight.cols)[window]
    width, height = (headlight.right - headlight.left) / headlight.cols, (headlight.bottom - headlight.top) / headlight.rows
    cropped = replace(
        headlight,
        rows=texels.shape[0],
        cols=texels.shape[1],
        left=headlight.left + window[1].start * width,
        right=headlight.left + window[1].stop * width,
        top=headlight.top + window[0].start * height,
        bottom=headlight.top + window[0].stop * height,
        matrix=Csr.from_scipy(columns.tocsc()[:, texels.ravel()].T.tocsr(), headlight.matrix.values.dtype),
        pixel_rows=1,
        pixel_cols=len(pixels),
        chroma=None,
    )
    spread = pixel_spread(headlight.matrix.transpose, headlight)
    return Part(cropped, wanted.cpu()[window], torch.from_numpy(pixels.astype(np.int64)), window, spread)


@dataclass(frozen=True)
class Trial:
    """Parameters of one MapReduce control.

    a_m: None gives every pixel the whole setpoint (no mapping). a_x: exclusion by a pixel's intensity. shape: rectangle uses all lit
    texels in the bounding rectangle of the texels that are not excluded, like controls with simplified pixels (T 3.5.1, 8.5). The other
    fields: see `luxloop.controllers.pixels.pixel_major.MrpcParams`.
    """

    a_m: float | None = 1.0
    a_x: float = 0.0
    a_r: float = 1.0
    shape: Literal["arbitrary", "rectangle"] = "arbitrary"
    a_ac: float = 0.0
    granularity: float = 0.0
    sharpening: float = 0.0
    corrections: int = 0


class TextureControl:
    """MapReduce control of a part of a headlight for many trials (T 7.5.2, eq. 7.4.1, 7.4.3, 7.4.5).

    Exclusion is by capability; all weights are 1.
    """

    def __init__(self, part: Part) -> None:
        self.part = part
        light = part.headlight
        entries = light.matrix.transpose
        self._texel = entries.indices.numpy()
        self._first = entries.indptr.numpy()[:-1]
        self._each = np.diff(entries.indptr.numpy())
        self._I = entries.values.float().numpy()
        self._log = np.log(self._I)
        peak = np.maximum.reduceat(self._I, self._first)
        self._relative = self._I / np.repeat(peak, self._each)
        self._log_size = np.repeat(np.log(np.add.reduceat(self._I, self._first) / peak), self._each)  # a pixel's size in texels
        self._row, self._col = np.divmod(self._texel, light.cols)
        wanted = part.wanted.numpy().astype(np.float32)
        self._wanted = wanted.ravel()
        self._lit = np.flatnonzero(self._wanted[self._texel] > 0)
        sigma = [max(each, 0.3) for each in part.spread]
        self._darkness = (1 - gaussian_filter(wanted / wanted.max(), sigma, mode="constant", truncate=3)).ravel()
        self._matrix = light.matrix.to_scipy()
        self._share_lit = np.add.reduceat(self._wanted[self._texel] > 0, self._first, dtype=np.float32) / self._each

    def utilisation(self, trial: Trial) -> Tensor:
        """Utilisation `[n]` of the part's pixels, float32."""
        counts = np.exp(np.float32(trial.a_r) * self._log) * self._mask(trial)  # w_ij I_m,ij^a_r, [nnz] (T eq. 7.4.3, 7.4.5)
        counts /= np.repeat(np.add.reduceat(counts, self._first), self._each)  # denominator of T eq. 7.4.5
        lit, off = self._lit, self._share_lit < trial.a_ac
        share = 1 / self._I[lit]
        if trial.a_m is not None:
            raised = np.exp(np.float32(trial.a_m) * self._log[lit] - np.float32(trial.granularity) * self._log_size[lit])
            total = np.bincount(self._texel[lit], raised, self.part.headlight.n_texels)
            share *= (raised / total[self._texel[lit]]).astype(np.float32)  # T eq. 7.4.1 over I_m,ij, [lit]

        def reduced(setpoints: Floats) -> Floats:
            terms = np.zeros_like(self._I)
            terms[lit] = counts[lit] * np.minimum(share * setpoints[self._texel[lit]], 1)
            return np.where(off, np.float32(0), np.add.reduceat(terms, self._first).clip(0, 1))  # T eq. 7.4.5, [n]; a_ac of T 7.5.2

        setpoints = self._wanted * (1 + np.float32(trial.sharpening) * self._darkness)
        u = reduced(setpoints)
        for _ in range(trial.corrections):
            setpoints = np.maximum(setpoints + self._wanted - self._matrix @ u, FAINT * self._wanted)
            u = reduced(setpoints)
        return torch.from_numpy(u)

    def _mask(self, trial: Trial) -> NDArray[np.bool_]:
        kept = self._relative >= np.float32(trial.a_x)
        if trial.shape == "arbitrary":
            return kept
        inside = np.ones_like(kept)
        for at, size in ((self._row, self.part.headlight.rows), (self._col, self.part.headlight.cols)):
            low = np.minimum.reduceat(np.where(kept, at, size), self._first)
            high = np.maximum.reduceat(np.where(kept, at, -1), self._first)
            inside &= (at >= np.repeat(low, self._each)) & (at <= np.repeat(high, self._each))
        return inside


def tune(cost: Callable[[Trial], float], start: Trial | None = None, tuned: tuple[str, ...] = THESIS) -> Trial:
    """The trial of least cost with the tuned parameters within RANGES and the others as in `start`; never worse than `start`.

    The cost jumps where a texel gets excluded, so differential evolution searches first and a simplex refines its best. Equal costs give
    equal results.
    """
    start = start or Trial()
    bounds = [RANGES[name] for name in tuned]

    def trial(x: NDArray[np.float64]) -> Trial:
        return replace(start, **dict(zip(tuned, np.clip(x, *np.transpose(bounds)).tolist(), strict=True)))

    def value(x: NDArray[np.float64]) -> float:
        reached = cost(trial(x))
        return reached if math.isfinite(reached) else math.inf

    x0 = [getattr(start, name) for name in tuned]
    found = differential_evolution(
        value, bounds, x0=x0, popsize=POPULATION, maxiter=GENERATIONS, tol=1e-3, init="sobol", polish=False, rng=0
    )
    refined = minimize(value, found.x, method="Nelder-Mead", bounds=bounds, options={"maxfev": REFINEMENTS})
    return trial(min(found, refined, key=lambda result: result.fun).x)
