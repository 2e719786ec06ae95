"""Calibration of a rig's camera, screen and lamp poses from frames of the rig's own light."""
