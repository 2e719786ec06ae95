"""Beams of a headlamp: wanted patterns, and the utilisations that come closest to them."""

from world.beams.fitting import fit
from world.beams.patterns import PATTERNS, Pattern, pattern

__all__ = ["PATTERNS", "Pattern", "fit", "pattern"]
