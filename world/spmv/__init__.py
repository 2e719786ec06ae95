"""Sparse matrix-vector products `i = A u` (T 2.5, 5.3)."""

from world.spmv.csr import Csr, multiply, row_of_entries, segment_bounds

__all__ = ["Csr", "multiply", "row_of_entries", "segment_bounds"]
