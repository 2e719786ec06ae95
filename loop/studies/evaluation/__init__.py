"""Pixel controllers judged by rectangles (T 8.4)."""
