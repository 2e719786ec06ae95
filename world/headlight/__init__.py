"""The sparse headlight matrix: pixels of a module to directions of light, where it comes from, and lamps of modules."""

from world.headlight.matrix import Headlight

__all__ = ["Headlight"]
