"""Calibration of a rig from what its camera sees of its own light."""
