"""The sparse headlight matrix from a module's pixels to directions, its sources, and lamps of several modules."""

from world.headlight.matrix import Headlight

__all__ = ["Headlight"]
