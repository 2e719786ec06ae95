"""Measure pixels separately: combs of distant pixels that are lit together, and the picture around each of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from luxloop.loop.rig.calibration.bench import Array, Indices
from luxloop.loop.rig.calibration.charts import Chart

SPACING: Final = 5  # pixels between those of a comb, in either direction: the light of a pixel reaches REACH
REACH: Final = 1.5  # pixels from its centre, to all sides
SUBSAMPLES: Final = 3  # points over a camera pixel's width and height, at which a shape is read


def combs(rows: int, cols: int, spacing: int = SPACING) -> Iterator[tuple[str, Array]]:
    """Names and utilisations `[n_p]` of combs, which together light each pixel once. spacing: in pixels."""
    for i in range(spacing):
        for j in range(spacing):
            u = np.zeros((rows, cols))
            u[i::spacing, j::spacing] = 1
            yield f"comb_{i}_{j}", u.ravel()


@dataclass(frozen=True, eq=False)
class Windows:
    """The picture around n lit pixels, m camera pixels around each.

    seen: `[n, m]`. inside: `[n, m]` bool, camera pixels that are in the image and nearer to this pixel than to others of its comb. dr, dc:
    `[n, m, s]`, places of points of each camera pixel, in lamp pixels from this one's centre. area: `[n]`, lamp pixels a camera pixel.
    """

    seen: Array
    inside: np.ndarray
    dr: Array
    dc: Array
    area: Array


def windows(images: Array, row: Indices, col: Indices, places: tuple[Array, Array], lamp_of: Chart, spacing: int = SPACING) -> Windows:
    """The windows of pixels at row and col `[n]`, whole numbers.

    images: `[spacing^2, height, width]`, of the combs. places: (u, v) `[n]` px, about where they are seen.
    """
    height, width = images.shape[1:]
    u, v = places
    jacobian = lamp_of.jacobian(u, v)  # [2, 2, n]
    du, dv = (each.ravel() for each in np.meshgrid(*(np.arange(-half, half + 1) for half in _halves(jacobian, spacing / 2))))
    x, y = np.floor(u).astype(int)[:, None] + du, np.floor(v).astype(int)[:, None] + dv  # [n, m]
    image = (row % spacing * spacing + col % spacing)[:, None]
    seen = images[image, y.clip(0, height - 1), x.clip(0, width - 1)]
    centre_r, centre_c = lamp_of(x + 0.5, y + 0.5)
    area = np.abs(jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0])
    part = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    du_s, dv_s = (each.ravel() for each in np.meshgrid(part, part))
    dr, dc = (
        (centre - at[:, None] - 0.5)[..., None] + along[0][:, None, None] * du_s + along[1][:, None, None] * dv_s
        for centre, at, along in ((centre_r, row, jacobian[0]), (centre_c, col, jacobian[1]))
    )
    near = (np.abs(dr.mean(-1)) <= spacing / 2) & (np.abs(dc.mean(-1)) <= spacing / 2)
    return Windows(seen, near & (x >= 0) & (x < width) & (y >= 0) & (y < height), dr, dc, area)


def _halves(jacobian: Array, reach: float) -> tuple[int, int]:
    """Camera pixels to either side of a lamp pixel's centre, in u and in v, that are nearer to it than `reach` along rows or columns."""
    by_lamp = np.linalg.inv(np.moveaxis(jacobian, -1, 0))  # [n, 2, 2], camera pixels a lamp pixel
    u, v = (reach * np.abs(by_lamp).sum(-1)).max(0)
    return int(np.ceil(u + 0.5)), int(np.ceil(v + 0.5))
