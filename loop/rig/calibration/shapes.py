"""Shape, intensity and position of each pixel's light, from combs of distant pixels that are lit together.

Around pixel j a camera pixel measures `a_j sum_k S_k w_k + b_j`. S is the light distribution on the lamp's texels, common to all pixels of
a block, w_k the overlap of texel k's tent with the camera pixel, a_j the pixel's intensity and b_j light scattered by the lens. S is
estimated over a block by least squares with a weak penalty on its roughness, since the camera resolves texels only over many pixels with
different subpixel positions (the effective point spread function of Anderson and King, 2000). Least squares in each pixel's window give its
shift; the sum of the light in the window gives a_j, independently of the shape.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter

from luxloop.loop.rig.arrays import Array, Indices, Mask
from luxloop.loop.rig.calibration.structured_light import Chart

SPACING = 5  # pixels from one lit pixel of a comb to the next, in rows and columns; more than 2 * REACH
REACH = 1.5  # extent of a pixel's light from its centre, in pixels along rows and columns
SUBSAMPLES = 3  # samples of a shape along each side of a camera pixel


def combs(rows: int, cols: int) -> Iterator[tuple[str, Array]]:
    """Names and utilisations `[n_p]` of the combs; each pixel is lit in one of them."""
    for i, j in np.ndindex(SPACING, SPACING):
        u = np.zeros((rows, cols))
        u[i::SPACING, j::SPACING] = 1
        yield f"comb_{i}_{j}", u.ravel()


@dataclass(frozen=True, eq=False)
class Windows:
    """Parts of the pictures around n lit pixels, m camera pixels each.

    seen: light `[n, m]`. inside: `[n, m]` bool, camera pixels within the picture and nearer to this pixel than to others of its comb. dr,
    dc: `[n, m, s]`, positions of sample points of each camera pixel relative to the pixel's centre, in lamp pixels. area: `[n]`, lamp
    pixels per camera pixel.
    """

    seen: Array
    inside: Mask
    dr: Array
    dc: Array
    area: Array

    @property
    def reach(self) -> Array:
        """Distance `[n, m]` of camera pixels from the pixel's centre in lamp pixels, the larger of rows and columns."""
        return np.maximum(np.abs(self.dr.mean(-1)), np.abs(self.dc.mean(-1)))


def windows(images: Array, chart: Chart, lamp_of: Chart, row: Indices, col: Indices) -> Windows:
    """Windows of the pixels at row and col `[n]`, integers.

    images: `[SPACING^2, height, width]`, of the combs. chart, lamp_of: as of `Places`.
    """
    height, width = images.shape[1:]
    u, v = chart(row + 0.5, col + 0.5)
    jacobian = lamp_of.jacobian(u, v)  # [2, 2, n]
    du, dv = (each.ravel() for each in np.meshgrid(*(np.arange(-half, half + 1) for half in _halves(jacobian, SPACING / 2))))
    x, y = np.floor(u).astype(int)[:, None] + du, np.floor(v).astype(int)[:, None] + dv  # [n, m]
    image = (row % SPACING * SPACING + col % SPACING)[:, None]
    seen = images[image, y.clip(0, height - 1), x.clip(0, width - 1)]
    centre_r, centre_c = lamp_of(x + 0.5, y + 0.5)
    area = np.abs(jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0])
    part = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    du_s, dv_s = (each.ravel() for each in np.meshgrid(part, part))
    dr, dc = (
        (centre - at[:, None] - 0.5)[..., None] + along[0][:, None, None] * du_s + along[1][:, None, None] * dv_s
        for centre, at, along in ((centre_r, row, jacobian[0]), (centre_c, col, jacobian[1]))
    )
    at = Windows(seen, (x >= 0) & (x < width) & (y >= 0) & (y < height), dr, dc, area)
    return replace(at, inside=at.inside & (at.reach <= SPACING / 2))


def _halves(jacobian: Array, reach: float) -> tuple[int, int]:
    """Half width and height in camera pixels of a window that extends `reach` lamp pixels along rows and columns."""
    by_lamp = np.linalg.inv(np.moveaxis(jacobian, -1, 0))  # [n, 2, 2], camera pixels a lamp pixel
    u, v = (reach * np.abs(by_lamp).sum(-1)).max(0)
    return int(np.ceil(u + 0.5)), int(np.ceil(v + 0.5))


BLOCK = 16  # pixels along a side of a block, which has one shape
ROUGHNESS = 1e-3  # weight of the second differences, relative to the mean of the normal matrix' diagonal
WINGS = 3e-3  # penalty on light beyond a pixel from the centre, which is hardly distinct from scattered light
BEYOND = 1.7  # pixels from the centre from which on light is background
SHAPED = 3  # one of this many pixels of a block is fitted for its shape
FEWEST = 24  # least number of pixels measured in a block
SHIFT = 0.05  # prior standard deviation of a pixel's shift, in pixels


@dataclass(frozen=True, eq=False)
class PixelMeasurements:
    """Measured pixels of a module, all `[rows, cols]`.

    intensity: relative to the shapes, in the unit of the images. background: light beside the pixel. shift_row, shift_col: of the light
    from the position by the charts, in lamp pixels. noise: standard deviation of intensity, from the residuals. residual: rms residual of
    the window relative to the pixel's peak. shapes: `[block rows, block cols, 2 * REACH * t_r, 2 * REACH * t_c]`; each sums to the number
    of texels per pixel.
    """

    intensity: Array
    background: Array
    shift_row: Array
    shift_col: Array
    noise: Array
    residual: Array
    shapes: Array

    def centres(self) -> tuple[Array, Array]:
        """Centres of each pixel's light in lamp coordinates of the charts: rows and columns, both `[rows, cols]`."""
        rows, cols = self.intensity.shape
        row, col = np.indices((rows, cols)) + 0.5
        total = self.shapes.sum((2, 3))
        for block, r, c in blocks(rows, cols):
            for axis, place in enumerate((row, col)):
                n = self.shapes.shape[2 + axis]
                at = (np.arange(n) + 0.5) * (2 * REACH / n) - REACH
                place[r, c] += float(self.shapes[block].sum(1 - axis) @ at / total[block])
        return row + self.shift_row, col + self.shift_col


def borders(n: int) -> list[int]:
    """First pixels of the blocks along n pixels, and n. The outermost pixel is a block of its own, since its light may end at the field's
    border.
    """
    inner = np.linspace(1, n - 1, 1 + max(1, round((n - 2) / BLOCK))).astype(int).tolist() if n > 2 else [1][: n - 1]
    return list(dict.fromkeys([0, *inner, n]))


def blocks(rows: int, cols: int) -> Iterator[tuple[tuple[int, int], Indices, Indices]]:
    """Index (i, j) of each block of rows x cols pixels, and rows and columns `[n]` of its pixels."""
    for (i, down), (j, across) in itertools.product(*(enumerate(itertools.pairwise(borders(n))) for n in (rows, cols))):
        r, c = np.mgrid[slice(*down), slice(*across)]
        yield (i, j), r.ravel(), c.ravel()


def measure(
    window_of: Callable[[Indices, Indices], Windows], rows: int, cols: int, texels: tuple[int, int], every: int = 1
) -> PixelMeasurements:
    """Fit the shapes of blocks to some of their pixels, then intensity and shift of pixels.

    window_of: windows of pixels at rows and columns `[n]`. texels: rows and columns of texels per pixel. every: one of this many pixels of
    a block is measured, the others are NaN.
    """
    shape = round(2 * REACH * texels[0]), round(2 * REACH * texels[1])
    count, k = [len(borders(n)) - 1 for n in (rows, cols)], shape[0] * shape[1]
    normal, right = np.zeros((*count, k, k)), np.zeros((*count, k))
    for block, r, c in blocks(rows, cols):
        some = _some(len(r), max(every, SHAPED))
        each = window_of(r[some], c[some])
        normal[block], right[block] = _normal(each, _weights(each, texels, shape))
    shapes = _solve(normal, right, shape)
    found = np.full((6, rows, cols), np.nan)
    for block, r, c in blocks(rows, cols):
        some = _some(len(r), every)
        r, c = r[some], c[some]
        each = window_of(r, c)
        found[:, r, c] = _fit_pixels(each, _weights(each, texels, shape), shapes[block], texels)
    intensity, background, shift_row, shift_col, noise, residual = found
    return PixelMeasurements(intensity, background, shift_row, shift_col, noise, residual, shapes)


def _some(n: int, every: int) -> Indices:
    """Random subset of a block's n pixels: one of `every`, at least FEWEST."""
    count = n if every == 1 else min(n, max(n // every, FEWEST))
    return np.sort(np.random.default_rng(n).permutation(n)[:count])


def _weights(at: Windows, texels: tuple[int, int], shape: tuple[int, int]) -> Array:
    """Overlap of each texel's tent with each camera pixel, `[n, m, k]` float32."""
    n, m, s = at.dr.shape
    base = np.arange(n * m).repeat(s) * (shape[0] * shape[1])
    total = np.zeros(n * m * shape[0] * shape[1], np.float32)
    down, right = (((d + REACH) * t - 0.5).ravel() for d, t in zip((at.dr, at.dc), texels, strict=True))
    for row, col, weight, inside in neighbours(down, right, shape):
        total += np.bincount((base + row * shape[1] + col)[inside], weight[inside] / s, len(total))
    return total.reshape(n, m, -1)


def neighbours(row: Array, col: Array, shape: tuple[int, int]) -> Iterator[tuple[Indices, Indices, Array, Mask]]:
    """The four neighbours of positions `[n]` in a raster, in turn: row, column, bilinear weight, and whether the neighbour is inside."""
    r0, c0 = np.floor(row).astype(int), np.floor(col).astype(int)
    for i, j in itertools.product((0, 1), repeat=2):
        r, c = r0 + i, c0 + j
        yield r, c, np.abs(1 - i - (row - r0)) * np.abs(1 - j - (col - c0)), (r >= 0) & (r < shape[0]) & (c >= 0) & (c < shape[1])


def _normal(at: Windows, weights: Array) -> tuple[Array, Array]:
    """Normal equations `[k, k]`, `[k]` of a block's shape, with each pixel's light scaled to a sum of one."""
    flux, background = _flux(at)
    good = flux > 0.2 * np.median(flux)
    light = np.where(at.inside, (at.seen - background[:, None]) / np.where(good, flux, 1)[:, None], 0)[good]
    w = (weights * at.inside[..., None])[good].reshape(-1, weights.shape[-1])
    return w.T.astype(float) @ w, w.T.astype(float) @ light.ravel()


def _flux(at: Windows) -> tuple[Array, Array]:
    """Light of each pixel integrated over lamp pixels, and background beside it, both `[n]`.

    The sum over whole camera pixels depends neither on the subpixel position nor on the shape.
    """
    core, beside = at.inside & (at.reach <= BEYOND), at.inside & (at.reach > BEYOND)
    background = (at.seen * beside).sum(1) / np.maximum(beside.sum(1), 1)
    return ((at.seen - background[:, None]) * core).sum(1) * at.area, background


def _solve(normal: Array, right: Array, shape: tuple[int, int]) -> Array:
    """Shapes `[block rows, block cols, *shape]`, each from a block and its neighbours, with mean one over the pixel's own texels."""
    around = normal.shape[:2]
    normal, right = _neighbour_means(normal), _neighbour_means(right)
    lines = [_second(n) for n in shape]
    rough = np.kron(lines[0], np.eye(shape[1])) + np.kron(np.eye(shape[0]), lines[1])
    far = [np.maximum(np.abs((np.arange(n) + 0.5) * (2 * REACH / n) - REACH) - 1, 0) / (REACH - 1) for n in shape]
    wings = WINGS * np.maximum(far[0][:, None], far[1]).ravel()
    scale = np.trace(normal, axis1=-2, axis2=-1)[..., None, None] / normal.shape[-1]
    one = np.eye(len(rough))
    solved = np.linalg.solve(normal + scale * (ROUGHNESS * rough + np.diag(wings) + 1e-6 * one) + 1e-30 * one, right[..., None])[..., 0]
    solved = np.maximum(solved, 0)
    total = solved.sum(-1, keepdims=True) * (4 * REACH**2) / solved.shape[-1]
    return (solved / np.maximum(total, 1e-12)).reshape(*around, *shape)


def _neighbour_means(values: Array) -> Array:
    """Means over each block and its neighbours; blocks at the edges are averaged among themselves."""
    values = values.copy()
    rows, cols = values.shape[:2]
    parts = ([slice(0, 1), slice(1, n - 1), slice(n - 1, n)] if n > 2 else [slice(k, k + 1) for k in range(n)] for n in (rows, cols))
    for part in itertools.product(*parts):
        values[part] = uniform_filter(values[part], 3, mode="nearest", axes=(0, 1))
    return values


def _second(n: int) -> Array:
    """Matrix `[n, n]` of the sum of squared second differences, with zeros beyond the ends."""
    d = np.diff(np.pad(np.eye(n), ((1, 1), (0, 0))), 2, axis=0)
    return d.T @ d


def _fit_pixels(at: Windows, weights: Array, shape: Array, texels: tuple[int, int]) -> Array:
    """Intensity, background, shifts (rows, columns), noise and residual of a block's pixels, `[6, n]`."""
    slope_r, slope_c = (np.gradient(shape, 1 / t, axis=axis) for axis, t in enumerate(texels))
    parts = weights @ np.stack([shape, -slope_r, -slope_c], -1).reshape(-1, 3)  # a shift subtracts the slope
    design = np.concatenate([parts, np.ones_like(parts[..., :1])], -1) * at.inside[..., None]  # [n, m, 4]
    seen = at.seen * at.inside
    normal = design.transpose(0, 2, 1) @ design
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4) + 1e-30 * np.eye(4)
    inverse = np.linalg.inv(normal + ridge)
    solved = (inverse @ (design.transpose(0, 2, 1) @ seen[..., None]))[..., 0]
    left = (design @ solved[..., None])[..., 0] - seen
    variance = (left**2).sum(1) / np.maximum(at.inside.sum(1) - 4, 1)
    intensity, background = _flux(at)
    core, beside = ((at.inside & where).sum(1) for where in (at.reach <= BEYOND, at.reach > BEYOND))
    noise = at.area * np.sqrt(variance * core * (1 + core / np.maximum(beside, 1)))
    bright = np.maximum(intensity, 3 * noise + 1e-30)
    shift = solved[:, 1:3] / bright[:, None]
    shift_noise = np.sqrt(np.maximum(variance[:, None] * inverse[:, [1, 2], [1, 2]], 0)) / bright[:, None]
    shift *= 1 / (1 + (shift_noise / SHIFT) ** 2)
    peak = np.maximum(intensity * shape.max(), 1e-30)
    return np.stack([intensity, background, shift[:, 0].clip(-1, 1), shift[:, 1].clip(-1, 1), noise, np.sqrt(variance) / peak])
