"""The sparse formats by name."""

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.spmv import Csr
from sparse.compressed import Coo, CsrRows, Lgc, Submatrix, Window
from sparse.padded import Ell, Sell
from sparse.protocol import SparseFormat, lit_rows
from sparse.scipy_window import ScipyWindow
from sparse.tiles import Tiles, Tiles64

LARGEST = 3  # times the bytes of CSR: what a format may store to be considered
LONG_ROWS = 6  # entries a lit row from which tiles can pay
TILED = 0.9  # times the bytes of CSR: largest size at which tiles pay, which save bytes only and take long to build
PART_ROWS = 2**15  # on either side of the middle: tiles are counted on this part, since planning all of them takes long
FORMATS: dict[str, type[SparseFormat]] = {
    each.name: each for each in (Coo, CsrRows, Window, ScipyWindow, Submatrix, Ell, Sell, Lgc, Tiles, Tiles64)
}


def build(csr: Csr, name: str) -> SparseFormat:
    """A matrix in a format by name, in memory of its own on the CPU. Raises LuxloopError for a name that is none of FORMATS."""
    if name not in FORMATS:
        raise LuxloopError(f"there is no sparse format {name!r}; {did_you_mean(name, FORMATS)}")
    return FORMATS[name].from_csr(csr.streamable())


def candidates(csr: Csr) -> list[str]:
    """Formats that can pay: those that do not store several times what CSR stores."""
    names = ["scipy"] if csr.values.device.type == "cpu" else []
    names += [name for name in ("csr", "window", "submatrix", "sell", "ell") if _size(csr, name) <= LARGEST]
    lit = lit_rows(csr)
    if len(csr.values) >= LONG_ROWS * len(lit) > 0:
        middle = int(lit[len(lit) // 2])
        part = csr.band(max(middle - PART_ROWS, 0), min(middle + PART_ROWS, csr.n_rows))
        names += [name for name in ("tiles", "tiles64") if _size(part, name) <= TILED]
    return names


def _size(csr: Csr, name: str) -> float:
    """Bytes in a format as a share of those in CSR."""
    dtype = csr.values.dtype
    return FORMATS[name].count(csr).bytes(dtype) / FORMATS["csr"].count(csr).bytes(dtype)
