"""Lighting functions that follow what the camera measures of places and materials."""
