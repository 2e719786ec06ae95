"""Pixel controllers evaluated by rectangles (T 8.4)."""
