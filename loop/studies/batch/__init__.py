"""Batches of copies of one closed loop."""
