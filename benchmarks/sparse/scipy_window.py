"""The lit window by SciPy's compiled loop: with one or two entries a row it beats the vendor's library behind torch on many CPUs."""

from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.spmv import Csr
from sparse.protocol import SparseFormat, Storage, lit_window

ROWS_AT_ONCE = 2**16  # SciPy makes a fresh result at each product: so large that it stays in the cache


class ScipyWindow(SparseFormat):
    """As `window`, on the CPU only, in parts."""

    name = "scipy"

    def __init__(self, csr: Csr) -> None:
        if csr.values.device.type != "cpu":
            raise LuxloopError(f"format 'scipy' is for the CPU, this matrix is on {csr.values.device}: take 'window'")
        super().__init__(csr)
        self.storage = self.count(csr)
        self.start, self.stop = lit_window(csr)
        self.written_rows = self.stop - self.start
        bounds = [(first, min(first + ROWS_AT_ONCE, self.stop)) for first in range(self.start, self.stop, ROWS_AT_ONCE)]
        self.parts = [(first, last, csr.band(first, last).to_scipy()) for first, last in bounds]

    @classmethod
    def count(cls, csr: Csr) -> Storage:
        start, stop = lit_window(csr)
        nnz = len(csr.values)
        return Storage(stop - start + -(-(stop - start) // ROWS_AT_ONCE) + 1, nnz, nnz)

    def _clear(self, out: Tensor) -> None:
        out[..., : self.start].zero_()
        out[..., self.stop :].zero_()

    def _write(self, x: Tensor, out: Tensor) -> None:
        vector, result = x.numpy(), out.numpy()
        for first, last, matrix in self.parts:
            result[first:last] = matrix @ vector
