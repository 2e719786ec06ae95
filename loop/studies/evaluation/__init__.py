"""Evaluation of pixel controllers with rectangles (T 8.4)."""
