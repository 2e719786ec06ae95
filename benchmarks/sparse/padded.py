"""Formats that pad rows to a common length: ELL and SELL (T 2.5)."""

import torch
from torch import Tensor

from luxloop.world.spmv import Csr, row_of_entries, zeros
from sparse.protocol import SparseFormat, Storage, row_lengths


class Ell(SparseFormat):
    """All rows as long as the longest (T 2.5). Stored entry by entry, so that neighbouring rows lie side by side."""

    name = "ell"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        rows = row_of_entries(csr)
        entry = torch.arange(len(rows), device=rows.device) - csr.indptr[rows]
        width = _longest(csr)
        self.columns = zeros((width, csr.n_rows), torch.int32, self.device)
        self.values = zeros((width, csr.n_rows), self.dtype, self.device)
        self.columns[entry, rows] = csr.indices
        self.values[entry, rows] = csr.values

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        cells = csr.n_rows * _longest(csr)
        return Storage(0, cells, cells)

    def _write(self, x: Tensor, out: Tensor) -> None:
        gathered = self._buffer("gathered", self.n_rows)
        for entry, (columns, values) in enumerate(zip(self.columns, self.values, strict=True)):
            torch.index_select(x, 0, columns, out=gathered)
            if entry:
                out.addcmul_(values, gathered)
            else:
                torch.mul(values, gathered, out=out)


def _longest(csr: Csr) -> int:
    return int(row_lengths(csr).max()) if csr.n_rows else 0


class Sell(SparseFormat):
    """Slices of `height` rows, each an ELL of its own (T fig. 2.13). Slices of a width are stored together, longest last."""

    name = "sell"
    height = 32  # a warp of a GPU

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        height = self.height
        widths = _slice_widths(csr, height)
        self.order = torch.argsort(widths, stable=True)
        place = torch.empty_like(self.order)
        place[self.order] = torch.arange(len(widths), device=self.device)
        sorted_widths = widths[self.order].long()
        offsets = torch.nn.functional.pad((sorted_widths * height).cumsum(0), (1, 0))
        rows = row_of_entries(csr)
        entry = torch.arange(len(rows), device=rows.device) - csr.indptr[rows]
        cell = offsets[place[rows // height]] + entry * height + rows % height
        cells = int(offsets[-1])
        self.columns = zeros((cells,), torch.int32, self.device).index_copy_(0, cell, csr.indices)
        self.values = zeros((cells,), self.dtype, self.device).index_copy_(0, cell, csr.values)
        self.runs = equal_runs(sorted_widths)

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        widths = _slice_widths(csr, cls.height)
        cells = cls.height * int(widths.sum())
        return Storage(len(widths) + 1, cells, cells)

    def _write(self, x: Tensor, out: Tensor) -> None:
        products = torch.index_select(x, 0, self.columns, out=self._buffer("products", len(self.columns))).mul_(self.values)
        sums = self._buffer("sums", len(self.order), self.height)
        first = cell = 0
        for count, width in self.runs:
            cells = count * width * self.height
            torch.sum(products[cell : cell + cells].view(count, width, self.height), 1, out=sums[first : first + count])
            first, cell = first + count, cell + cells
        slices = self._buffer("slices", len(self.order), self.height)
        out.copy_(slices.index_copy_(0, self.order, sums).view(-1)[: self.n_rows])


def _slice_widths(csr: Csr, height: int) -> Tensor:
    lengths = row_lengths(csr)
    return torch.nn.functional.pad(lengths, (0, -csr.n_rows % height)).view(-1, height).amax(1)


def equal_runs(widths: Tensor) -> list[tuple[int, int]]:
    """Length and width of each run of equal widths."""
    values, counts = torch.unique_consecutive(widths, return_counts=True)
    return list(zip(counts.tolist(), values.tolist(), strict=True))
