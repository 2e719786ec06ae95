"""Lamps, light and scenes as files that other programs read."""
