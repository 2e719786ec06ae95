"""Sparse products `i = A u` (T 2.5, 5.3): the headlight matrix as compressed sparse rows with int32 indices, whole or as a band of rows.

Other formats are compared in benchmarks/sparse (docs/results/spmv.md); products take too small a share of a run to need them.

The solver finds utilisations that come closest to wanted light: weighted least squares within bounds, `min ||W (A u - i)||^2`, `0 <= u <=
upper`.
"""

import math
import mmap
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

# Of torch's CSR we use construction and products only, both held by tests.
warnings.filterwarnings("ignore", "Sparse CSR tensor support is in beta", UserWarning)


LARGE = 2**22  # bytes from which two pages of 2 MiB or more are filled


def zeros(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """As `torch.zeros`, but on the CPU in large pages, which make products up to a fifth faster."""
    bytes_ = math.prod(shape) * dtype.itemsize
    if device.type != "cpu" or bytes_ < LARGE or not hasattr(mmap, "MADV_HUGEPAGE"):
        return torch.zeros(shape, dtype=dtype, device=device)
    # Fresh from the system, as memory that malloc reuses keeps its pages.
    memory = mmap.mmap(-1, bytes_, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    with suppress(OSError):  # a kernel without them
        memory.madvise(mmap.MADV_HUGEPAGE)
    return torch.frombuffer(memory, dtype=dtype).view(shape)


def streamable(tensor: Tensor) -> Tensor:
    """A copy in large pages, for repeated reading."""
    return zeros(tuple(tensor.shape), tensor.dtype, tensor.device).copy_(tensor.detach())


@dataclass(frozen=True)
class Csr:
    """Compressed sparse rows: indptr int32 `[n_rows + 1]`, indices int32 `[nnz]`, values `[nnz]`."""

    indptr: Tensor
    indices: Tensor
    values: Tensor
    n_cols: int

    @property
    def n_rows(self) -> int:
        return self.indptr.shape[0] - 1

    @classmethod
    def from_scipy(cls, matrix: sp.spmatrix | sp.sparray, dtype: torch.dtype = torch.float32) -> "Csr":
        """Convert a scipy sparse matrix, without stored zeros.

        Raises: ValueError where int32 cannot count its rows, columns or entries.
        """
        csr = matrix.tocsr(copy=True)
        if csr.nnz >= 2**31 or max(csr.shape) >= 2**31:
            raise ValueError(f"a {csr.shape[0]} x {csr.shape[1]} matrix of {csr.nnz} entries is too large for int32 indices: split it")
        csr.sum_duplicates()
        csr.eliminate_zeros()
        return cls(
            torch.from_numpy(csr.indptr.astype(np.int32)),
            torch.from_numpy(csr.indices.astype(np.int32)),
            streamable(torch.from_numpy(np.asarray(csr.data)).to(dtype)),
            csr.shape[1],
        )

    def to_scipy(self) -> sp.csr_matrix:
        arrays = (self.values.cpu().numpy(), self.indices.cpu().numpy(), self.indptr.cpu().numpy())
        return sp.csr_matrix(arrays, shape=(self.n_rows, self.n_cols))

    def to(self, target: torch.device | torch.dtype) -> "Csr":
        """Move to a device (everything) or a floating dtype (the values)."""
        if isinstance(target, torch.dtype):
            return self.with_values(self.values.to(target))
        return Csr(self.indptr.to(target), self.indices.to(target), self.values.to(target), self.n_cols)

    def with_values(self, values: Tensor) -> "Csr":
        """The same pattern with other values `[nnz]`."""
        return Csr(self.indptr, self.indices, values, self.n_cols)

    def streamable(self) -> "Csr":
        """A copy in large pages for repeated products (see `streamable`); itself if not on the CPU."""
        if self.values.device.type != "cpu":
            return self
        return Csr(streamable(self.indptr), streamable(self.indices), streamable(self.values), self.n_cols)

    def band(self, start: int, stop: int) -> "Csr":
        """Rows start to stop as a matrix of their own; a view of indices and values, not a copy."""
        if (start, stop) == (0, self.n_rows):
            return self
        indptr = self.indptr[start : stop + 1]
        first, last = indptr[:: stop - start].tolist() if stop > start else 2 * indptr.tolist()
        return Csr(indptr - first, self.indices[first:last], self.values[first:last], self.n_cols)

    def part(self, rows: Tensor, columns: Tensor) -> "Csr":
        """`A[rows][:, columns]` for ascending columns; its cost is proportional to the entries in these rows."""
        row, entry = entries_in(self, rows)
        column = numbers(columns, self.n_cols)[self.indices[entry]]
        kept = column >= 0
        stop = torch.bincount(row[kept], minlength=len(rows)).cumsum(0)
        return Csr(torch.nn.functional.pad(stop, (1, 0)).int(), column[kept], self.values[entry[kept]], len(columns))

    @cached_property
    def torch_csr(self) -> Tensor:
        return torch.sparse_csr_tensor(self.indptr, self.indices, self.values.detach(), (self.n_rows, self.n_cols), check_invariants=False)

    @cached_property
    def transpose(self) -> "Csr":
        return Csr.from_scipy(self.to_scipy().T, self.values.dtype).to(self.values.device)


class _Multiply(torch.autograd.Function):
    """CSR product with autograd; the backward pass needs the transpose in CSR, which torch does not have."""

    @staticmethod
    def forward(ctx: Any, matrix: Csr, x: Tensor) -> Tensor:
        ctx.matrix = matrix
        return _product(matrix, x)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[None, Tensor]:
        return None, multiply(ctx.matrix.transpose, grad_outputs[0])


def _product(matrix: Csr, x: Tensor) -> Tensor:
    if x.ndim == 1:
        return torch.mv(matrix.torch_csr, x)
    flat = x.reshape(x.shape[:-1].numel(), matrix.n_cols)
    if len(flat) == 1:
        return torch.mv(matrix.torch_csr, flat[0]).reshape(*x.shape[:-1], matrix.n_rows)
    return (matrix.torch_csr @ flat.T).T.reshape(*x.shape[:-1], matrix.n_rows)


def multiply(matrix: Csr, x: Tensor) -> Tensor:
    """`A x` for x `[..., n_cols]`, differentiable in x; returns `[..., n_rows]` (T 2.5, eq. 5.3.1)."""
    if x.shape[-1] != matrix.n_cols:
        raise ValueError(f"a matrix with {matrix.n_cols} columns cannot multiply a vector of {x.shape[-1]}")
    if x.requires_grad:
        return _Multiply.apply(matrix, x)  # type: ignore[no-any-return]
    return _product(matrix, x)


def segment_bounds(keys: Tensor, values: Tensor, n_keys: int) -> tuple[Tensor, Tensor]:
    """Smallest and largest value of each key: both `[n_keys]`, int64; (largest int64, -1) where a key does not occur."""
    first = torch.full((n_keys,), torch.iinfo(torch.int64).max, dtype=torch.int64, device=keys.device)
    last = torch.full((n_keys,), -1, dtype=torch.int64, device=keys.device)
    keys, values = keys.long(), values.long()
    return first.scatter_reduce(0, keys, values, "amin"), last.scatter_reduce(0, keys, values, "amax")


def row_bounds(matrix: Csr, values: Tensor) -> tuple[Tensor, Tensor]:
    """`segment_bounds` of a value per entry by row, on the host; five times as fast, since the entries of a row lie together."""
    indptr, of_entries = matrix.indptr.cpu().numpy(), values.cpu().numpy()
    there = np.flatnonzero(np.diff(indptr))
    first, last = np.full(matrix.n_rows, np.iinfo(np.int64).max), np.full(matrix.n_rows, -1)
    if len(there):
        first[there], last[there] = (each.reduceat(of_entries, indptr[there]) for each in (np.minimum, np.maximum))
    return torch.from_numpy(first), torch.from_numpy(last)


def span_of(first: Tensor, last: Tensor, keys: slice) -> tuple[int, int]:
    """Least of first and greatest of last, both int64 `[n_keys]` as of `segment_bounds`, over some keys, at least one.

    NumPy finds them three times as fast.
    """
    low, high = (each[keys].cpu().numpy() for each in (first, last))
    return int(low.min()), int(high.max())


def numbers(chosen: Tensor, n: int) -> Tensor:
    """Position `[n]` int32 of each of 0..n-1 in `chosen` `[m]` int64, ascending; -1 if absent."""
    number = torch.full((n,), -1, dtype=torch.int32, device=chosen.device)
    number[chosen] = torch.arange(len(chosen), dtype=torch.int32, device=chosen.device)
    return number


def row_of_entries(matrix: Csr) -> Tensor:
    """Row index of every stored entry, `[nnz]` int64."""
    counts = (matrix.indptr[1:] - matrix.indptr[:-1]).long()
    return torch.repeat_interleave(torch.arange(matrix.n_rows, device=counts.device), counts)


def entries_in(matrix: Csr, rows: Tensor) -> tuple[Tensor, Tensor]:
    """For all stored entries in rows `[m]`: index into `rows`, and index into the stored values."""
    start, stop = matrix.indptr[:-1].long()[rows], matrix.indptr[1:].long()[rows]
    row = torch.repeat_interleave(torch.arange(len(rows), device=rows.device), stop - start)
    before = (stop - start).cumsum(0) - (stop - start)
    return row, torch.arange(len(row), device=rows.device) + (start - before)[row]


CHECKED_EVERY = 10  # iterations between convergence checks, each of which synchronises the device


def solve(
    matrix: Csr,
    wanted: Tensor | tuple[Tensor, Tensor],
    *,
    weight: Tensor | None = None,
    upper: Tensor | None = None,
    start: Tensor | None = None,
    iterations: int = 300,
    tolerance: float = 1e-4,
) -> Tensor:
    """u `[..., n]` in `0..upper` with the least `sum (weight * distance of A u from low..high)^2` (T 3.5.2, eq. B.1.1).

    matrix: A `[m, n]`, several modules side by side. wanted: `[..., m]`, or bounds low and high between which the error is zero, infinite
    without a bound. weight: `[m]` or `[..., m]`, 1 by default. upper: `[n]` or `[..., n]`, 1 by default. start: `[..., n]`, warm start; a
    pixel that reaches no row keeps it. Stops when ten steps in a row move no pixel by more than the tolerance. Accelerated projected
    gradient with restarts, all batch entries at once.
    """
    low, high = wanted if isinstance(wanted, tuple) else (wanted, wanted)
    squared = torch.ones_like(low) if weight is None else weight.to(low).square().expand(low.shape)
    upper = low.new_ones(matrix.n_cols) if upper is None else upper.to(low)
    u = low.new_zeros(*low.shape[:-1], matrix.n_cols) if start is None else start.to(low).expand(*low.shape[:-1], -1).clone()
    transposed = matrix.transpose
    # diag(|A|' W^2 |A| 1) dominates A' W^2 A: a step length for each pixel that never overshoots, without the matrix norm.
    size = matrix.with_values(matrix.values.abs())
    curvature = multiply(size.transpose, squared * multiply(size, torch.ones_like(u)))
    step = torch.where(curvature > 0, 1 / curvature, 0.0)

    ahead, momentum = u, u.new_ones(*u.shape[:-1], 1)
    moved = torch.zeros_like(step)
    for iteration in range(1, iterations + 1):
        light = multiply(matrix, ahead)
        residual = squared * (light - light.clamp(low, high))
        following = (ahead - step * multiply(transposed, residual)).clamp(min=0).minimum(upper)
        uphill = ((ahead - following) * (following - u) * curvature).sum(-1, keepdim=True) > 0
        momentum = torch.where(uphill, 1.0, momentum)
        next_momentum = (1 + (1 + 4 * momentum.square()).sqrt()) / 2
        ahead = following + torch.where(uphill, 0.0, (momentum - 1) / next_momentum) * (following - u)
        moved = torch.maximum(moved, (following - u).abs())
        u, momentum = following, next_momentum
        if iteration % CHECKED_EVERY == 0:
            if bool((moved <= tolerance).all()):
                break
            moved = torch.zeros_like(moved)
    return u
