"""Rigs as processes of their own."""

from tests.loop.rig.conftest import small_rig

__all__ = ["small_rig"]
