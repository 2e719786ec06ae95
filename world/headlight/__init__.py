"""The sparse headlight matrix from a module's pixels to directions, its sources, and lamps of several modules."""

from luxloop.world.headlight.matrix import Headlight

__all__ = ["Headlight"]
