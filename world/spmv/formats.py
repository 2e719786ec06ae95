"""The sparse formats by name."""

import difflib

from world.errors import LuxloopError
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
        nearest = difflib.get_close_matches(name, FORMATS, 1)
        hint = f"did you mean {nearest[0]!r}?" if nearest else f"take one of {', '.join(FORMATS)}"
        raise LuxloopError(f"there is no sparse format {name!r}; {hint}")
    return FORMATS[name].from_csr(csr.settled())
