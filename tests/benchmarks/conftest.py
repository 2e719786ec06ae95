"""Tests here make simulations, of which parts serve again."""

from tests.parts import parts_serve_again, simulations_end_with_the_file

__all__ = ["parts_serve_again", "simulations_end_with_the_file"]
