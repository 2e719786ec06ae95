"""Formats without padding: COO, CSR, CSR of the lit window, also by SciPy, CSR without empty rows, LGC (T 2.4, 2.5, 5.3)."""

import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.spmv import Csr, row_of_entries, streamable
from sparse.protocol import SparseFormat, Storage, lit_rows, lit_window

ROWS_AT_ONCE = 2**16  # SciPy makes a fresh result at each product: so large that it stays in the cache


class _Compressed(SparseFormat):
    """Formats that store each entry's column and value."""

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        return Storage(cls.row_indices(csr), len(csr.values), len(csr.values))

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        """Indices of rows."""
        raise NotImplementedError


class Coo(_Compressed):
    """Row, column and value of every entry (T fig. 2.10)."""

    name = "coo"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.rows, self.columns, self.values = row_of_entries(csr).int(), csr.indices, csr.values

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        return len(csr.values)

    def _write(self, x: Tensor, out: Tensor) -> None:
        products = torch.index_select(x, 0, self.columns, out=self._buffer("products", len(self.values))).mul_(self.values)
        out.zero_().index_add_(0, self.rows, products)


class CsrRows(_Compressed):
    """An offset for every row, dark ones too (T fig. 2.11)."""

    name = "csr"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.csr = csr

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        return csr.n_rows + 1

    def _write(self, x: Tensor, out: Tensor) -> None:
        torch.mv(self.csr.torch_csr, x, out=out)


class Window(_Compressed):
    """CSR of the rows from the first lit to the last lit one, and where they start (T 5.3): no dark sky, no dark foreground."""

    name = "window"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.start, self.stop = lit_window(csr)
        self.written_rows = self.stop - self.start
        band = csr.band(self.start, self.stop)
        self.csr = Csr(streamable(band.indptr), band.indices, band.values, csr.n_cols)

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        start, stop = lit_window(csr)
        return stop - start + 2

    def _write(self, x: Tensor, out: Tensor) -> None:
        torch.mv(self.csr.torch_csr, x, out=out[self.start : self.stop])


class ScipyWindow(_Compressed):
    """The same in parts by SciPy's loop, on the CPU only: with one or two entries a row it beats the library behind torch on many CPUs."""

    name = "scipy"

    def __init__(self, csr: Csr) -> None:
        if csr.values.device.type != "cpu":
            raise LuxloopError(f"format 'scipy' is for the CPU, this matrix is on {csr.values.device}: take 'window'")
        super().__init__(csr)
        start, stop = lit_window(csr)
        self.written_rows = stop - start
        bounds = [(first, min(first + ROWS_AT_ONCE, stop)) for first in range(start, stop, ROWS_AT_ONCE)]
        self.parts = [(first, last, csr.band(first, last).to_scipy()) for first, last in bounds]

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        start, stop = lit_window(csr)
        return stop - start + -(-(stop - start) // ROWS_AT_ONCE) + 1

    def _write(self, x: Tensor, out: Tensor) -> None:
        vector, result = x.numpy(), out.numpy()
        for first, last, matrix in self.parts:
            result[first:last] = matrix @ vector


class Submatrix(_Compressed):
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
        lit = torch.mv(self.csr.torch_csr, x, out=self._buffer("lit", len(self.rows)))
        out.index_copy_(0, self.rows, lit)


class Lgc(_Compressed):
    """Texel, offset and number of pixels of every lit texel (T fig. 2.8), with one index a texel instead of two (T 6.2, eq. 6.2.1)."""

    name = "lgc"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.rows = lit_rows(csr)
        self.written_rows = len(self.rows)
        self.offsets = csr.indptr[self.rows]
        self.lengths = csr.indptr[self.rows + 1] - self.offsets
        self.columns, self.values = csr.indices, csr.values

    @classmethod
    def row_indices(cls, csr: Csr) -> int:
        return 3 * len(lit_rows(csr))

    def _write(self, x: Tensor, out: Tensor) -> None:
        products = torch.index_select(x, 0, self.columns, out=self._buffer("products", len(self.values))).mul_(self.values)
        # Entries lie texel by texel, so that lengths say what the offsets would; unsafe only skips a check that waits for the device.
        out.index_copy_(0, self.rows, torch.segment_reduce(products, "sum", lengths=self.lengths, unsafe=True))
