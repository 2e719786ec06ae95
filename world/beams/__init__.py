"""Beams of a headlamp: what they should look like, and the utilisations that come closest."""

from world.beams.fitting import fit
from world.beams.patterns import PATTERNS, Pattern, pattern

__all__ = ["PATTERNS", "Pattern", "fit", "pattern"]
