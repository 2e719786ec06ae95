"""The lit window by SciPy's compiled loop: with one or two entries a row it beats the vendor's library behind torch on many CPUs."""

from scipy.sparse import _sparsetools
from torch import Tensor

from world.errors import LuxloopError
from world.spmv.compressed import Window
from world.spmv.csr import Csr

ROWS_AT_ONCE = 2**18  # the loop adds to what is there: rows are zeroed while they are in the cache


class ScipyWindow(Window):
    """As `window`, on the CPU only. Called without SciPy's allocation of a fresh result at each product."""

    name = "scipy"

    def __init__(self, csr: Csr) -> None:
        if csr.values.device.type != "cpu":
            raise LuxloopError(f"format 'scipy' is for the CPU, this matrix is on {csr.values.device}: take 'window'")
        super().__init__(csr)

    def _write(self, x: Tensor, out: Tensor) -> None:
        indptr, indices, values = self.csr.indptr.numpy(), self.csr.indices.numpy(), self.csr.values.numpy()
        vector, window = x.numpy(), out[self.start : self.stop].numpy()
        for start in range(0, len(window), ROWS_AT_ONCE):
            rows = window[start : start + ROWS_AT_ONCE]
            rows.fill(0)
            _sparsetools.csr_matvec(len(rows), self.n_cols, indptr[start : start + len(rows) + 1], indices, values, vector, rows)
