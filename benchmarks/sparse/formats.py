"""Formats of sparse matrices (T 2.4, 2.5, 5.3, 6.2): what each stores, its product, and which of them can pay for a lamp."""

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from luxloop.world.spmv import Csr, row_of_entries, streamable, zeros

INDEX_BYTES = 4
ROWS_AT_ONCE = 2**16  # SciPy makes a fresh result at each product: so large that it stays in the cache
LARGEST = 3  # times the bytes of CSR: what a format may store to be considered


class Storage(NamedTuple):
    """What a format stores, padding included, counted as the thesis does: indices of rows (offsets too), of columns, and values."""

    row_indices: int
    column_indices: int
    values: int

    def bytes(self, dtype: torch.dtype = torch.float32) -> int:
        return INDEX_BYTES * (self.row_indices + self.column_indices) + dtype.itemsize * self.values


class SparseFormat(ABC):
    """A headlight matrix `[n_rows, n_cols]`, stored on its device to be multiplied again and again.

    A format keeps work buffers between calls: it belongs to one thread. It has no gradient; `world.spmv.multiply` has.
    """

    name: ClassVar[str]
    values: Tensor  # stored ones

    def __init__(self, csr: Csr) -> None:
        self.n_rows, self.n_cols = csr.n_rows, csr.n_cols
        self.written_rows = csr.n_rows  # by `refresh`
        self.values, self.columns = csr.values, csr.indices
        self.storage = self.count(csr)
        self._buffers = {}

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        """What the format would store of a matrix, without storing it; by default the column and value of each entry, without padding."""
        return Storage(cls.row_indices(csr), len(csr.values), len(csr.values))

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        """Indices of rows that the format would store, offsets among them."""
        return csr.n_rows + 1

    @abstractmethod
    def _write(self, x: Tensor, out: Tensor) -> None:
        """`out = A x`; rows without entries may be left as they are."""

    def multiply(self, x: Tensor, out: Tensor | None = None) -> Tensor:
        """`A x` for x `[n_cols]` as `[n_rows]`, into `out` where given; every row is written."""
        return self.refresh(x, zeros((self.n_rows,), x.dtype, x.device) if out is None else out.zero_())

    def refresh(self, x: Tensor, out: Tensor) -> Tensor:
        """As `multiply`, for an `out` that came from it: rows that no pixel reaches stay zero and need not be written again."""
        if self.storage.values:
            self._write(x, out)
        return out

    def _buffer(self, name: str, *shape: int) -> Tensor:
        """Work memory that lasts from call to call: a fresh one costs the CPU more than the product that fills it."""
        if name not in self._buffers:
            self._buffers[name] = zeros(shape, self.values.dtype, self.values.device)
        return self._buffers[name]

    def _products(self, x: Tensor) -> Tensor:
        """Each stored value times its utilisation."""
        return torch.index_select(x, 0, self.columns, out=self._buffer("products", len(self.columns))).mul_(self.values)


class Coo(SparseFormat):
    """Row, column and value of every entry (T fig. 2.10)."""

    name = "coo"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.rows = row_of_entries(csr).int()

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        return len(csr.values)

    def _write(self, x: Tensor, out: Tensor) -> None:
        out.zero_().index_add_(0, self.rows, self._products(x))


class CsrRows(SparseFormat):
    """An offset for every row, dark ones too (T fig. 2.11)."""

    name = "csr"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.csr = csr

    def _write(self, x: Tensor, out: Tensor) -> None:
        torch.mv(self.csr.torch_csr, x, out=out)


class Window(SparseFormat):
    """CSR of the rows from the first lit to the last lit one, and where they start (T 5.3): no dark sky, no dark foreground."""

    name = "window"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        start, stop = lit_window(csr)
        band = csr.band(start, stop)
        self.rows, self.written_rows = slice(start, stop), stop - start
        self.csr = Csr(streamable(band.indptr), band.indices, band.values, csr.n_cols)

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        start, stop = lit_window(csr)
        return stop - start + 2

    def _write(self, x: Tensor, out: Tensor) -> None:
        torch.mv(self.csr.torch_csr, x, out=out[self.rows])


class ScipyWindow(Window):
    """The same in parts by SciPy's loop, on the CPU only: with one or two entries a row it beats the library behind torch on many CPUs."""

    name = "scipy"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.parts = [
            self.csr.band(first, min(first + ROWS_AT_ONCE, self.csr.n_rows)).to_scipy() for first in range(0, self.csr.n_rows, ROWS_AT_ONCE)
        ]

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        rows = super().row_indices(csr) - 2
        return rows + -(-rows // ROWS_AT_ONCE) + 1

    def _write(self, x: Tensor, out: Tensor) -> None:
        vector, lit = x.numpy(), out[self.rows].split(ROWS_AT_ONCE)
        for rows, matrix in zip(lit, self.parts, strict=True):
            rows.numpy()[:] = matrix @ vector


class Submatrix(SparseFormat):
    """CSR of the lit rows only, and the row that each belongs to (T fig. 5.5)."""

    name = "submatrix"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.rows = lit_rows(csr)
        self.written_rows = len(self.rows)
        offsets = torch.cat([csr.indptr[self.rows], csr.indptr[-1:]])
        self.csr = Csr(streamable(offsets), csr.indices, csr.values, csr.n_cols)

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        return 2 * len(lit_rows(csr)) + 1

    def _write(self, x: Tensor, out: Tensor) -> None:
        out.index_copy_(0, self.rows, torch.mv(self.csr.torch_csr, x, out=self._buffer("lit", len(self.rows))))


class Lgc(Submatrix):
    """Texel, offset and number of pixels of every lit texel (T fig. 2.8), with one index a texel instead of two (T 6.2, eq. 6.2.1)."""

    name = "lgc"

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        return 3 * len(lit_rows(csr))

    def _write(self, x: Tensor, out: Tensor) -> None:
        # Entries lie texel by texel, so that lengths say what the offsets would; unsafe only skips a check that waits for the device.
        lengths = self.csr.indptr.diff()
        out.index_copy_(0, self.rows, torch.segment_reduce(self._products(x), "sum", lengths=lengths, unsafe=True))


class Ell(SparseFormat):
    """All rows as long as the longest (T 2.5). Stored entry by entry, so that neighbouring rows lie side by side."""

    name = "ell"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        rows, entry = row_of_entries(csr), _place_in_row(csr)
        width = self.storage.values // max(csr.n_rows, 1)
        self.columns = zeros((width, csr.n_rows), torch.int32, csr.values.device)
        self.values = zeros((width, csr.n_rows), csr.values.dtype, csr.values.device)
        self.columns[entry, rows], self.values[entry, rows] = csr.indices, csr.values

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        cells = csr.n_rows * int(row_lengths(csr).max()) if csr.n_rows else 0
        return Storage(0, cells, cells)

    def _write(self, x: Tensor, out: Tensor) -> None:
        gathered = self._buffer("gathered", self.n_rows)
        for entry, (columns, values) in enumerate(zip(self.columns, self.values, strict=True)):
            torch.index_select(x, 0, columns, out=gathered)
            if entry:
                out.addcmul_(values, gathered)
            else:
                torch.mul(values, gathered, out=out)


class Sell(SparseFormat):
    """Slices of `height` rows, each an ELL of its own (T fig. 2.13). Slices of a width are stored together, longest last."""

    name = "sell"
    height = 32  # a warp of a GPU

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        height, rows = self.height, row_of_entries(csr)
        widths, self.order = _slice_widths(csr, height).sort(stable=True)
        offsets = pad((widths.long() * height).cumsum(0), (1, 0))
        cell = offsets[self.order.argsort()[rows // height]] + _place_in_row(csr) * height + rows % height
        self.columns, self.values = (
            zeros((self.storage.values,), each.dtype, each.device).index_copy_(0, cell, each) for each in (csr.indices, csr.values)
        )
        self.runs = _equal_runs(widths)

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        widths = _slice_widths(csr, cls.height)
        cells = cls.height * int(widths.sum())
        return Storage(len(widths) + 1, cells, cells)

    def _write(self, x: Tensor, out: Tensor) -> None:
        products = self._products(x)
        sums, slices = (self._buffer(name, len(self.order), self.height) for name in ("sums", "slices"))
        for first, count, cell, width in self.runs:
            cells = products[cell * self.height : (cell + count * width) * self.height]
            torch.sum(cells.view(count, width, self.height), 1, out=sums[first : first + count])
        out.copy_(slices.index_copy_(0, self.order, sums).view(-1)[: self.n_rows])


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
        height, (self.start, self.stop) = self.height, lit_window(csr)
        self.written_rows = self.stop - self.start
        tiled, widths_by_tile, tile, column, cell_of_entry = _tiles(csr, height)
        widths, order = widths_by_tile.sort(stable=True)
        rank = order.argsort()
        self.runs, self.n_sums = _equal_runs(widths), len(widths) * height
        # Cells move from the order of tiles to the order of widths.
        moved = (widths.cumsum(0) - widths)[rank] - (widths_by_tile.cumsum(0) - widths_by_tile)
        cell = torch.arange(len(tile), device=tile.device) + moved[tile]
        self.columns = zeros((len(cell),), torch.int32, tile.device).index_copy_(0, cell, column.int())
        self.values = zeros((len(cell), height), csr.values.dtype, tile.device)
        self.values[cell[cell_of_entry], tiled[row_of_entries(csr)] % height] = csr.values
        place = tiled[self.start : self.stop]
        rank = pad(rank, (0, 1))  # of dark rows, at place -1, which read behind the last sum
        self.places = streamable(torch.where(place < 0, self.n_sums, rank[place // height] * height + place % height).int())

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        (start, stop), (_, widths, tile, *_) = lit_window(csr), _tiles(csr, cls.height)
        return Storage(stop - start + 1 + len(widths) + 1, len(tile), len(tile) * cls.height)

    def _write(self, x: Tensor, out: Tensor) -> None:
        gathered = torch.index_select(x, 0, self.columns, out=self._buffer("gathered", len(self.columns)))
        sums = self._buffer("sums", self.n_sums + 1)  # the last one stays zero, for dark rows
        for tile, count, cell, width in self.runs:
            cells = slice(cell, cell + count * width)
            torch.bmm(
                gathered[cells].view(count, 1, width),
                self.values[cells].view(count, width, self.height),
                out=sums[tile * self.height : (tile + count) * self.height].view(count, 1, self.height),
            )
        torch.index_select(sums, 0, self.places, out=out[self.start : self.stop])


class Tiles64(Tiles):
    """Larger tiles, for many texels a pixel."""

    name = "tiles64"
    height = 64


def _tiles(csr: Csr, height: int) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Tile rows in the order of their first and last column, which keeps those of a neighbourhood together. All int64.

    Returns the position of each row among tiled rows `[n_rows]`, -1 where dark; widths `[n_tiles]`; tile and column of each cell
    `[n_cells]`, a cell being one column of one tile, in the order of tiles; and the cell of each entry `[nnz]`.
    """
    lit = lit_rows(csr)
    outer = csr.indices[csr.indptr[lit]].long() * csr.n_cols + csr.indices[csr.indptr[lit + 1].long() - 1]
    place = torch.full((csr.n_rows,), -1, device=lit.device)
    place[lit[torch.argsort(outer, stable=True)]] = torch.arange(len(lit), device=lit.device)
    keys, cell_of_entry = torch.unique((place[row_of_entries(csr)] // height) * csr.n_cols + csr.indices, return_inverse=True)
    tile = keys // csr.n_cols
    return place, torch.bincount(tile, minlength=-(-len(lit) // height)), tile, keys % csr.n_cols, cell_of_entry


def _slice_widths(csr: Csr, height: int) -> Tensor:
    return pad(row_lengths(csr), (0, -csr.n_rows % height)).view(-1, height).amax(1)


def _equal_runs(widths: Tensor) -> list[tuple[int, int, int, int]]:
    """Of each run of equal widths the first, how many, the sum of the widths before it, and the width."""
    values, counts = torch.unique_consecutive(widths, return_counts=True)
    firsts, cells = counts.cumsum(0) - counts, (counts * values).cumsum(0) - counts * values
    return list(zip(*(each.tolist() for each in (firsts, counts, cells, values)), strict=True))


def _place_in_row(csr: Csr) -> Tensor:
    """Position of every entry in its row, `[nnz]`."""
    return torch.arange(len(csr.values), device=csr.values.device) - csr.indptr[row_of_entries(csr)]


def row_lengths(csr: Csr) -> Tensor:
    """Entries of each row, `[n_rows]` int32."""
    return csr.indptr.diff()


def lit_rows(csr: Csr) -> Tensor:
    """Rows that have entries, ascending, `[n_lit]` int64: the texels that any pixel reaches."""
    return row_lengths(csr).nonzero()[:, 0]


def lit_window(csr: Csr) -> tuple[int, int]:
    """First row that has entries, and the one after the last."""
    lit = lit_rows(csr)
    return (int(lit[0]), int(lit[-1]) + 1) if len(lit) else (0, 0)


FORMATS = {each.name: each for each in (Coo, CsrRows, Window, ScipyWindow, Submatrix, Ell, Sell, Lgc, Tiles, Tiles64)}


def build(csr: Csr, name: str) -> SparseFormat:
    """A matrix in a format of FORMATS, in memory of its own on the CPU."""
    return FORMATS[name](csr.streamable())


def candidates(csr: Csr) -> list[str]:
    """Formats that can pay: those that do not store several times what CSR stores."""
    size = {name: each.count(csr).bytes(csr.values.dtype) for name, each in FORMATS.items()}
    return [name for name in size if size[name] <= LARGEST * size["csr"]]
