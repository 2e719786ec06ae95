"""What every storage of a headlight matrix can do, and how its memory is counted (T 2.5, 5.3, 6.2)."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from luxloop.world.spmv import Csr, zeros

INDEX_BYTES = 4


@dataclass(frozen=True)
class Storage:
    """What a format stores, padding included, counted as the thesis does: indices of rows (offsets too), of columns, and values."""

    row_indices: int
    column_indices: int
    values: int

    def bytes(self, dtype: torch.dtype = torch.float32) -> int:
        return INDEX_BYTES * (self.row_indices + self.column_indices) + dtype.itemsize * self.values


class SparseFormat(ABC):
    """A headlight matrix `[n_rows, n_cols]`, stored on its device to be multiplied again and again.

    A format keeps work buffers between calls: it belongs to one thread. It has no gradient; `world.spmv.multiply` has.
    """

    name: ClassVar[str]
    written_rows: int  # by `refresh`

    def __init__(self, csr: Csr) -> None:
        self.n_rows, self.n_cols = csr.n_rows, csr.n_cols
        self.written_rows = csr.n_rows
        self.dtype, self.device = csr.values.dtype, csr.values.device
        self.storage = self.count(csr)
        self._buffers: dict[str, Tensor] = {}

    @classmethod
    @abstractmethod
    def count(cls, csr: Csr) -> Storage:
        """What the format would store of a matrix, without storing it."""

    @abstractmethod
    def _write(self, x: Tensor, out: Tensor) -> None:
        """`out = A x` for `[n_cols]` and `[n_rows]`, both contiguous; rows without entries may be left as they are."""

    def multiply(self, x: Tensor, out: Tensor | None = None) -> Tensor:
        """`A x` for x `[..., n_cols]` as `[..., n_rows]`, into `out` where given; every row is written.

        Raises: ValueError where a shape, dtype or device does not fit, or x wants a gradient.
        """
        return self.refresh(x, zeros((*x.shape[:-1], self.n_rows), x.dtype, x.device) if out is None else out.zero_())

    def refresh(self, x: Tensor, out: Tensor) -> Tensor:
        """As `multiply`, for an `out` that came from it: rows that no pixel reaches stay zero and need not be written again."""
        self.check(x, out)
        if not self.storage.values:
            return out.zero_()
        # Products of single vectors are faster than one with a matrix of few columns.
        for vector, result in zip(x.reshape(-1, self.n_cols).contiguous(), out.view(-1, self.n_rows), strict=True):
            self._write(vector, result)
        return out

    def check(self, x: Tensor, out: Tensor) -> None:
        """Raise ValueError where `out = A x` cannot be had: see `multiply`."""
        if x.shape[-1] != self.n_cols:
            raise ValueError(f"a matrix with {self.n_cols} columns cannot multiply a vector of {x.shape[-1]}")
        if out.shape != (*x.shape[:-1], self.n_rows) or not out.is_contiguous():
            raise ValueError(f"the product is a contiguous {(*x.shape[:-1], self.n_rows)}, it cannot go into {tuple(out.shape)}")
        if {(t.dtype, t.device) for t in (x, out)} != {(self.dtype, self.device)}:
            raise ValueError(
                f"matrix, vector and product must be alike: {self.dtype} on {self.device}, {x.dtype} on {x.device}, {out.dtype}"
            )
        if x.requires_grad and torch.is_grad_enabled():
            raise ValueError("sparse formats have no gradient: use world.spmv.multiply(csr, x)")

    def _buffer(self, name: str, *shape: int) -> Tensor:
        """Work memory that lasts from call to call: a fresh one costs the CPU more than the product that fills it."""
        if name not in self._buffers:
            self._buffers[name] = zeros(shape, self.dtype, self.device)
        return self._buffers[name]


def row_lengths(csr: Csr) -> Tensor:
    """Entries of each row, `[n_rows]` int32."""
    return csr.indptr.diff()


def lit_rows(csr: Csr) -> Tensor:
    """Rows that have entries, ascending, `[n_lit]` int64: the texels that any pixel reaches."""
    return row_lengths(csr).nonzero()[:, 0]


def lit_window(csr: Csr) -> tuple[int, int]:
    """First row that has entries, and the one after the last."""
    lit = lit_rows(csr)
    return (int(lit[0]), int(lit[-1]) + 1) if len(lit) else (0, 0)
