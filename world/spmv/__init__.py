"""Sparse matrix-vector products `i = A u` (T 2.5, 5.3).

`Csr` with `multiply` is what lamps are stored in and every run multiplies with. The other formats, `fastest`, `CapturedProduct` and the
incremental updates are a study (docs/results/spmv.md) for programs that stream light textures; a run spends too small a share of its time
on such products.
"""

from world.spmv.auto import fastest
from world.spmv.csr import Csr, multiply, numbers, row_of_entries, segment_bounds, span_of
from world.spmv.formats import FORMATS, build
from world.spmv.graph import CapturedProduct
from world.spmv.incremental import Bands, ChangedPixels
from world.spmv.protocol import SparseFormat, Storage

__all__ = [
    "FORMATS",
    "Bands",
    "CapturedProduct",
    "ChangedPixels",
    "Csr",
    "SparseFormat",
    "Storage",
    "build",
    "fastest",
    "multiply",
    "numbers",
    "row_of_entries",
    "segment_bounds",
    "span_of",
]
