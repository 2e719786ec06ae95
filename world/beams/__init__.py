"""Beams of a headlamp: wanted patterns, and the utilisations that come closest to them."""

from luxloop.world.beams.fitting import fit
from luxloop.world.beams.patterns import PATTERNS, Pattern, pattern

__all__ = ["PATTERNS", "Pattern", "fit", "pattern"]
