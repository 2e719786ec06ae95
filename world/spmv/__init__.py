"""Sparse matrix-vector products `i = A u` (T 2.5, 5.3), in the format that suits the lamp."""

from world.spmv.csr import Csr, multiply, row_of_entries, segment_bounds
from world.spmv.formats import FORMATS, build
from world.spmv.protocol import SparseFormat, Storage

__all__ = ["FORMATS", "Csr", "SparseFormat", "Storage", "build", "multiply", "row_of_entries", "segment_bounds"]
