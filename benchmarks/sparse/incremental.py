"""Renew only the texels whose pixels changed (T 5.4): a band that is known, or those found by comparing utilisations (T A.4)."""

import numpy as np
import torch
from torch import Tensor

from luxloop.world.spmv import Csr, multiply, row_of_entries, segment_bounds


class Bands:
    """Products of contiguous rows, for changes whose place is known: a symbol's rectangle, a cut-off line, a module's row of pixels."""

    def __init__(self, csr: Csr) -> None:
        self.csr = csr
        self.first, self.last = (each.numpy() for each in segment_bounds(csr.indices, row_of_entries(csr), csr.n_cols))

    def rows_of(self, pixels: slice) -> tuple[int, int]:
        """First row that any of these pixels reaches and the one after the last; (0, 0) where they reach none."""
        start, stop = int(self.first[pixels].min(initial=self.csr.n_rows)), int(self.last[pixels].max(initial=-1)) + 1
        return (start, stop) if start < stop else (0, 0)

    def refresh(self, x: Tensor, out: Tensor, rows: tuple[int, int]) -> Tensor:
        """Renew rows start to stop of `out [n_rows] = A x`, x `[n_cols]`. The others must be those of x already.

        Each renewed row is its whole product, so that nothing adds up from step to step.
        """
        torch.mv(self.csr.band(*rows).torch_csr, x, out=out[slice(*rows)])
        return out


class ChangedPixels:
    """The thesis' flags: compare utilisations, flag every texel of a changed pixel, multiply the flagged rows (T A.4)."""

    def __init__(self, csr: Csr, x: Tensor) -> None:
        self.matrix, self.transpose = csr.to_scipy(), csr.to_scipy().T.tocsr()
        self.previous, self.out = x.clone(), multiply(csr, x)

    def refresh(self, x: Tensor) -> Tensor:
        """`A x` as `[n_rows]`, the same tensor at each call."""
        pixels = (x != self.previous).numpy().nonzero()[0]
        self.previous.copy_(x)
        flags = np.zeros(len(self.out), bool)
        flags[self.transpose[pixels].indices] = True
        rows = flags.nonzero()[0]
        self.out.numpy()[rows] = self.matrix[rows] @ x.numpy()
        return self.out
