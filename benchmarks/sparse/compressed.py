"""Formats without padding: COO, CSR, CSR of the lit window, CSR without empty rows, LGC (T 2.4, 2.5, 5.3)."""

import torch
from torch import Tensor

from luxloop.world.spmv import Csr, row_of_entries, streamable
from sparse.protocol import SparseFormat, Storage, lit_rows, lit_window


class Coo(SparseFormat):
    """Row, column and value of every entry (T fig. 2.10)."""

    name = "coo"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.storage = self.count(csr)
        self.rows, self.columns, self.values = row_of_entries(csr).int(), csr.indices, csr.values

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        nnz = len(csr.values)
        return Storage(nnz, nnz, nnz)

    def _write(self, x: Tensor, out: Tensor) -> None:
        products = torch.index_select(x, 0, self.columns, out=self._buffer("products", len(self.values))).mul_(self.values)
        out.zero_().index_add_(0, self.rows, products)


class CsrRows(SparseFormat):
    """An offset for every row, dark ones too (T fig. 2.11)."""

    name = "csr"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.storage = self.count(csr)
        self.csr = csr

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        nnz = len(csr.values)
        return Storage(csr.n_rows + 1, nnz, nnz)

    def _write(self, x: Tensor, out: Tensor) -> None:
        torch.mv(self.csr.torch_csr, x, out=out)


class Window(SparseFormat):
    """CSR of the rows from the first lit to the last lit one, and where they start (T 5.3): no dark sky, no dark foreground."""

    name = "window"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.storage = self.count(csr)
        self.start, self.stop = lit_window(csr)
        self.written_rows = self.stop - self.start
        band = csr.band(self.start, self.stop)
        self.csr = Csr(streamable(band.indptr), band.indices, band.values, csr.n_cols)

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        start, stop = lit_window(csr)
        nnz = len(csr.values)
        return Storage(stop - start + 2, nnz, nnz)

    def _clear(self, out: Tensor) -> None:
        out[..., : self.start].zero_()
        out[..., self.stop :].zero_()

    def _write(self, x: Tensor, out: Tensor) -> None:
        torch.mv(self.csr.torch_csr, x, out=out[self.start : self.stop])


class Submatrix(SparseFormat):
    """CSR of the lit rows only, and the row that each belongs to (T fig. 5.5)."""

    name = "submatrix"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.storage = self.count(csr)
        self.rows = lit_rows(csr)
        self.written_rows = len(self.rows)
        offsets = torch.cat([csr.indptr[self.rows], csr.indptr[-1:]])
        self.csr = Csr(streamable(offsets), csr.indices, csr.values, csr.n_cols)

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        nnz = len(csr.values)
        return Storage(2 * len(lit_rows(csr)) + 1, nnz, nnz)

    def _clear(self, out: Tensor) -> None:
        out.zero_()

    def _write(self, x: Tensor, out: Tensor) -> None:
        lit = torch.mv(self.csr.torch_csr, x, out=self._buffer("lit", len(self.rows)))
        out.index_copy_(0, self.rows, lit)


class Lgc(SparseFormat):
    """Texel, offset and number of pixels of every lit texel (T fig. 2.8), with one index a texel instead of two (T 6.2, eq. 6.2.1)."""

    name = "lgc"

    def __init__(self, csr: Csr) -> None:
        super().__init__(csr)
        self.storage = self.count(csr)
        self.rows = lit_rows(csr)
        self.written_rows = len(self.rows)
        self.offsets = csr.indptr[self.rows]
        self.lengths = csr.indptr[self.rows + 1] - self.offsets
        self.columns, self.values = csr.indices, csr.values

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        nnz = len(csr.values)
        return Storage(3 * len(lit_rows(csr)), nnz, nnz)

    def _clear(self, out: Tensor) -> None:
        out.zero_()

    def _write(self, x: Tensor, out: Tensor) -> None:
        products = torch.index_select(x, 0, self.columns, out=self._buffer("products", len(self.values))).mul_(self.values)
        # Entries lie texel by texel, so that lengths say what the offsets would; unsafe only skips a check that waits for the device.
        out.index_copy_(0, self.rows, torch.segment_reduce(products, "sum", lengths=self.lengths, unsafe=True))
