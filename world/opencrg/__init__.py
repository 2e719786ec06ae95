"""ASAM OpenCRG road scans (curved regular grids): read, evaluate, modify. Vectorised NumPy, float64, SI units."""

from world.opencrg.crg import Crg, CrgError, filled
from world.opencrg.modifiers import modified
from world.opencrg.reader import read_crg
from world.opencrg.surface import CrgSurface

__all__ = ["Crg", "CrgError", "CrgSurface", "filled", "modified", "read_crg"]
