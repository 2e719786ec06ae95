"""Beams that are optimised for a detector."""
