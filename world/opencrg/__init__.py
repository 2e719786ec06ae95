"""ASAM OpenCRG road scans (curved regular grids): read, evaluate, modify. Vectorised NumPy, float64, SI units."""

from luxloop.world.opencrg.crg import Crg, fill_gaps
from luxloop.world.opencrg.reader import read_crg
from luxloop.world.opencrg.surface import CrgSurface, modify

__all__ = ["Crg", "CrgSurface", "fill_gaps", "modify", "read_crg"]
