"""Renew only the texels whose pixels changed (T 5.4): a band that is known, or those found by comparing utilisations (T A.4)."""

import numpy as np
import torch
from torch import Tensor

from luxloop.world.spmv import Csr, segment_bounds, zeros


class Bands:
    """Products of contiguous rows, for changes whose place is known: a symbol's rectangle, a cut-off line, a module's row of pixels."""

    def __init__(self, csr: Csr) -> None:
        self.csr = csr
        self.indptr = csr.indptr.cpu()  # so that a step need not wait for the device
        columns = csr.indices.cpu()
        rows = torch.repeat_interleave(torch.arange(csr.n_rows), self.indptr.diff())
        first, last = segment_bounds(columns, rows, csr.n_cols)
        largest = torch.iinfo(torch.int32).max
        self.first, self.last = first.clamp(max=largest).int().numpy(), last.int().numpy()
        self._offsets = zeros((csr.n_rows + 1,), torch.int32, csr.indptr.device)

    def rows_of(self, pixels: slice | np.ndarray) -> tuple[int, int]:
        """First row that any of these pixels reaches and the one after the last; (0, 0) where they reach none."""
        first, last = self.first[pixels], self.last[pixels]
        start, stop = int(first.min(initial=self.csr.n_rows)), int(last.max(initial=-1)) + 1
        return (start, stop) if start < stop else (0, 0)

    def refresh(self, x: Tensor, out: Tensor, rows: tuple[int, int]) -> Tensor:
        """Renew rows start to stop of `out [n_rows] = A x`, x `[n_cols]`. The others must be those of x already.

        Each renewed row is its whole product, so that nothing adds up from step to step.
        """
        start, stop = rows
        first, last = int(self.indptr[start]), int(self.indptr[stop])
        csr = self.csr
        offsets = torch.sub(csr.indptr[start : stop + 1], first, out=self._offsets[: stop - start + 1])
        band = Csr(offsets, csr.indices[first:last], csr.values[first:last], csr.n_cols)
        torch.mv(band.torch_csr, x, out=out[start:stop])
        return out


class ChangedPixels:
    """The thesis' flags: compare utilisations, flag every texel of a changed pixel, multiply the flagged rows (T A.4).

    How many rows there are decides how much work there is, so that each step waits for the device.
    """

    def __init__(self, csr: Csr, x: Tensor) -> None:
        self.csr, self.transpose = csr, csr.transpose
        self.previous = x.clone()
        self.out = torch.mv(csr.torch_csr, x)
        self.flags = torch.zeros(csr.n_rows, dtype=torch.bool, device=x.device)

    def refresh(self, x: Tensor) -> Tensor:
        """`A x` as `[n_rows]`, the same tensor at each call."""
        pixels = (x != self.previous).nonzero()[:, 0]
        self.previous.copy_(x)
        entries, _ = _entries(self.transpose, pixels)
        rows = self.flags.zero_().index_fill_(0, self.transpose.indices[entries].long(), True).nonzero()[:, 0]
        entries, lengths = _entries(self.csr, rows)
        indptr = torch.nn.functional.pad(lengths.cumsum(0), (1, 0)).int()
        flagged = Csr(indptr, self.csr.indices[entries], self.csr.values[entries], self.csr.n_cols)
        self.out.index_copy_(0, rows, torch.mv(flagged.torch_csr, x))
        return self.out


def _entries(csr: Csr, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Positions of the entries of these rows, and how many each row has."""
    start = csr.indptr[rows].long()
    lengths = csr.indptr[rows + 1] - start
    shift = start - (lengths.cumsum(0) - lengths)
    shifts = torch.repeat_interleave(shift, lengths)
    return shifts + torch.arange(len(shifts), device=shifts.device), lengths
