"""The sparse formats by name."""

from world.errors import LuxloopError, did_you_mean
from world.spmv.compressed import Coo, CsrRows, Lgc, Submatrix, Window
from world.spmv.csr import Csr
from world.spmv.padded import Ell, Sell
from world.spmv.protocol import SparseFormat
from world.spmv.scipy_window import ScipyWindow
from world.spmv.tiles import Tiles, Tiles64

FORMATS: dict[str, type[SparseFormat]] = {
    each.name: each for each in (Coo, CsrRows, Window, ScipyWindow, Submatrix, Ell, Sell, Lgc, Tiles, Tiles64)
}


def build(csr: Csr, name: str) -> SparseFormat:
    """A matrix in a format by name, in memory of its own on the CPU. Raises LuxloopError for a name that is none of FORMATS."""
    if name not in FORMATS:
        raise LuxloopError(f"there is no sparse format {name!r}; {did_you_mean(name, FORMATS)}")
    return FORMATS[name].from_csr(csr.settled())
