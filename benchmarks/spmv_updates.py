"""Incremental updates beside full products, at one lamp and as in T fig. 6.1."""

from typing import Any

import torch
from sparse.formats import build
from sparse.incremental import Bands, ChangedPixels
from spmv_lamps import Lamp, disjoint
from spmv_timing import Step, interleaved

from luxloop.world.spmv import Csr

FIGURE_TEXELS = (128, 256, 512, 1024)  # rows of a texture of aspect 4:1
FIGURE_PIXELS = (32, 64, 128, 256, 512, 1024, 2048)  # columns
CHANGED = 0.1  # of the pixels, in fig. 6.1
DIRTY = 0.05


def measure_updates(lamp: Lamp, rounds: int) -> dict[str, Any]:
    """A full product beside a dirty band of pixel rows, a dirty square of the same area, flags for the band and for scattered pixels."""
    csr = Csr.from_scipy(lamp.matrix)
    form, bands = build(csr, "window"), Bands(csr)
    u = torch.rand(csr.n_cols, generator=torch.Generator().manual_seed(1))
    out = form.multiply(u)
    pixel = torch.arange(csr.n_cols).view(lamp.rows, lamp.cols)
    band = _middle(lamp.rows, DIRTY)
    square = _middle(lamp.rows, DIRTY**0.5)
    of_band, of_square = (slice(rows.start * lamp.cols, rows.stop * lamp.cols) for rows in (band, square))
    rows_of_band, rows_of_square = bands.rows_of(of_band), bands.rows_of(of_square)
    steps: dict[str, Step] = {
        "full": lambda: form.refresh(u, out),
        "band": lambda: bands.refresh(u, out, rows_of_band),
        "band, rows looked up": lambda: bands.refresh(u, out, bands.rows_of(of_band)),
        "square": lambda: bands.refresh(u, out, rows_of_square),
        "flags, band": flags(csr, u, pixel[band].ravel()),
        "flags, scattered": flags(csr, u, torch.randperm(csr.n_cols)[: int(DIRTY * csr.n_cols)]),
    }
    return {"name": lamp.name, "texels": lamp.grid.rows, "share": DIRTY, "ms": interleaved(steps, rounds)}


def _middle(n: int, share: float) -> slice:
    count = max(round(share * n), 1)
    return slice((n - count) // 2, (n - count) // 2 + count)


def flags(csr: Csr, u: torch.Tensor, pixels: torch.Tensor) -> Step:
    """Updates by flags that change these pixels there and back."""
    other = u.clone()
    other[pixels] = 1 - other[pixels]
    changed, both = ChangedPixels(csr, u), [u, other]

    def step() -> None:
        both.reverse()
        changed.refresh(both[0])

    return step


def measure_figure(cols: tuple[int, ...], texel_rows: tuple[int, ...], rounds: int) -> list[dict[str, Any]]:
    """Relative time of updates to full products, as in T fig. 6.1."""
    points = []
    for texels in texel_rows:
        for n in cols:
            if n > 4 * texels:
                continue  # a pixel without a texel
            lamp = disjoint(n, texels)
            csr = Csr.from_scipy(lamp.matrix)
            form, bands = build(csr, "csr"), Bands(csr)
            u = torch.rand(csr.n_cols, generator=torch.Generator().manual_seed(1))
            out = form.multiply(u)
            rows = _middle(lamp.rows, CHANGED)
            dirty = bands.rows_of(slice(rows.start * n, rows.stop * n))
            scattered = torch.randperm(csr.n_cols, generator=torch.Generator().manual_seed(2))[: int(CHANGED * csr.n_cols)]
            steps: dict[str, Step] = {
                "full": lambda form=form, u=u, out=out: form.refresh(u, out),
                "band": lambda bands=bands, u=u, out=out, dirty=dirty: bands.refresh(u, out, dirty),
                "flags": flags(csr, u, scattered),
            }
            ms = {name: times["median"] for name, times in interleaved(steps, rounds).items()}
            points.append({"texels": csr.n_rows, "pixels": csr.n_cols, "ms": ms, "band_share": (rows.stop - rows.start) / lamp.rows})
    return points
