"""Formats of sparse matrices and their products (T 2.5, 5.3, 5.4, 6.1), a study that no run uses."""
