"""Tiles of texels that share their pixels: one list of columns for many rows, for lamps whose pixels overlap a lot."""

from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.world.spmv import Csr, row_of_entries, streamable, zeros
from sparse.padded import equal_runs
from sparse.protocol import SparseFormat, Storage, lit_rows, lit_window


class Tiles(SparseFormat):
    """Lit rows in tiles of `height`, each a small dense matrix of all columns that any of its rows has.

    CSR reads an index with every value, half of all its bytes. Texels of the same neighbourhood are lit by the same pixels, so that a tile
    needs their indices once. A tile's product is dense, tiles of a width are multiplied at once, and the result is put in place by one
    index a texel of the lit window.
    """

    name = "tiles"
    height = 32

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        plan, height = _plan(csr, self.height), self.height
        self.start, self.stop = plan.window
        self.written_rows = self.stop - self.start
        order = torch.argsort(plan.widths, stable=True)
        rank = torch.empty_like(order).index_copy_(0, order, torch.arange(len(order), device=self.device))
        widths = plan.widths[order]
        self.runs = equal_runs(widths)
        self.n_sums = len(widths) * height

        # Cells move from the order of tiles to the order of widths.
        moved = (widths.cumsum(0) - widths)[rank] - (plan.widths.cumsum(0) - plan.widths)
        cell = torch.arange(len(plan.tile), device=self.device) + moved[plan.tile]
        self.columns = zeros((len(cell),), torch.int32, self.device).index_copy_(0, cell, plan.column.int())
        self.values = zeros((len(cell), height), self.dtype, self.device)
        self.values[cell[plan.cell_of_entry], plan.place[row_of_entries(csr)] % height] = csr.values
        rank = torch.nn.functional.pad(rank, (0, 1), value=len(order))  # dark rows, at place -1, read behind the last sum
        place = plan.place[self.start : self.stop]
        self.places = streamable(torch.where(place < 0, self.n_sums, rank[place // height] * height + place % height).int())

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        return _plan(csr, cls.height).storage(cls.height)

    def _write(self, x: Tensor, out: Tensor) -> None:
        gathered = torch.index_select(x, 0, self.columns, out=self._buffer("gathered", len(self.columns)))
        sums = self._buffer("sums", self.n_sums + 1)  # the last one stays zero, for dark rows
        tile = cell = 0
        for count, width in self.runs:
            cells = slice(cell, cell + count * width)
            torch.bmm(
                gathered[cells].view(count, 1, width),
                self.values[cells].view(count, width, self.height),
                out=sums[tile * self.height : (tile + count) * self.height].view(count, 1, self.height),
            )
            tile, cell = tile + count, cell + count * width
        torch.index_select(sums, 0, self.places, out=out[self.start : self.stop])


class Tiles64(Tiles):
    """Larger tiles, for many texels a pixel."""

    name = "tiles64"
    height = 64


@dataclass(frozen=True)
class _Plan:
    """Which tile has which columns. A cell is one column of one tile, cells are in the order of tiles."""

    window: tuple[int, int]
    place: Tensor  # [n_rows] int64: position of a row among tiled rows, -1 where dark
    widths: Tensor  # [n_tiles] int64
    tile: Tensor  # [n_cells] int64
    column: Tensor  # [n_cells] int64
    cell_of_entry: Tensor  # [nnz] int64

    def storage(self, height: int) -> Storage:
        start, stop = self.window
        return Storage(stop - start + 1 + len(self.widths) + 1, len(self.tile), len(self.tile) * height)


def _plan(csr: Csr, height: int) -> _Plan:
    """Tile rows in the order of their first and last column, which keeps those of a neighbourhood together."""
    lit = lit_rows(csr)
    outer = csr.indices[csr.indptr[lit]].long() * csr.n_cols + csr.indices[csr.indptr[lit + 1].long() - 1]
    order = lit[torch.argsort(outer, stable=True)]
    place = torch.full((csr.n_rows,), -1, device=lit.device)
    place[order] = torch.arange(len(order), device=lit.device)
    keys = (place[row_of_entries(csr)] // height) * csr.n_cols + csr.indices
    keys, cell_of_entry = torch.unique(keys, return_inverse=True)
    tile = keys // csr.n_cols
    widths = torch.bincount(tile, minlength=-(-len(lit) // height))
    return _Plan(lit_window(csr), place, widths, tile, keys % csr.n_cols, cell_of_entry)
