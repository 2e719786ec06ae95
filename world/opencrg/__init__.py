"""ASAM OpenCRG road scans (curved regular grids): read, evaluate, modify. Vectorised NumPy, float64, SI units."""

from luxloop.world.opencrg.crg import Crg, CrgError, fill_gaps
from luxloop.world.opencrg.reader import read_crg
from luxloop.world.opencrg.surface import CrgSurface, modify

__all__ = ["Crg", "CrgError", "CrgSurface", "fill_gaps", "modify", "read_crg"]
