"""The sparse formats by name, and their products as captured CUDA graphs."""

import torch
from torch import Tensor, cuda

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.spmv import Csr
from sparse.compressed import Coo, CsrRows, Lgc, ScipyWindow, Submatrix, Window
from sparse.padded import Ell, Sell
from sparse.protocol import SparseFormat, lit_rows
from sparse.tiles import Tiles, Tiles64

LARGEST = 3  # times the bytes of CSR: what a format may store to be considered
LONG_ROWS = 6  # entries a lit row from which tiles can pay
TILED = 0.9  # times the bytes of CSR: largest size at which tiles pay, which save bytes only and take long to build
PART_ROWS = 2**15  # on either side of the middle: tiles are counted on this part, since planning all of them takes long
ALL: tuple[type[SparseFormat], ...] = (Coo, CsrRows, Window, ScipyWindow, Submatrix, Ell, Sell, Lgc, Tiles, Tiles64)
FORMATS = {each.name: each for each in ALL}
WARM_UPS = 3  # libraries make their workspaces in the first calls, which must not be captured


def build(csr: Csr, name: str) -> SparseFormat:
    """A matrix in a format by name, in memory of its own on the CPU. Raises LuxloopError for a name that is none of FORMATS."""
    if name not in FORMATS:
        raise LuxloopError(f"there is no sparse format {name!r}; {did_you_mean(name, FORMATS)}")
    return FORMATS[name](csr.streamable())


def candidates(csr: Csr) -> list[str]:
    """Formats that can pay: those that do not store several times what CSR stores."""
    names = ["scipy"] if csr.values.device.type == "cpu" else []
    names += [name for name in ("csr", "window", "submatrix", "sell", "ell") if _size(csr, name) <= LARGEST]
    lit = lit_rows(csr)
    if len(csr.values) >= LONG_ROWS * len(lit) > 0:
        middle = int(lit[len(lit) // 2])
        part = csr.band(max(middle - PART_ROWS, 0), min(middle + PART_ROWS, csr.n_rows))
        names += [name for name in ("tiles", "tiles64") if _size(part, name) <= TILED]
    return names


def _size(csr: Csr, name: str) -> float:
    """Bytes in a format as a share of those in CSR."""
    of_format, of_csr = (FORMATS[each].count(csr).bytes(csr.values.dtype) for each in (name, "csr"))
    return of_format / of_csr


class CapturedProduct:
    """`A x` of one shape of x as a captured CUDA graph: one launch a step; `input` and `output` are the same tensors at each call.

    A caller that writes its utilisation into `input` itself saves a copy: `replay()` does the rest.
    """

    def __init__(self, form: SparseFormat, batch: tuple[int, ...] = ()) -> None:
        """Capture the product of `x [*batch, n_cols]`. Raises LuxloopError where the matrix is not on a CUDA device."""
        if form.device.type != "cuda":
            raise LuxloopError(f"CUDA graphs need a matrix on a CUDA device, this one is on {form.device}: move it with Csr.to first")
        with cuda.device(form.device):
            self.form = form
            self.input = torch.zeros(*batch, form.n_cols, dtype=form.dtype, device=form.device)
            self.output = form.multiply(self.input)
            side = cuda.Stream()
            side.wait_stream(cuda.current_stream())
            with cuda.stream(side):
                for _ in range(WARM_UPS):
                    form.refresh(self.input, self.output)
            cuda.current_stream().wait_stream(side)
            self.graph = cuda.CUDAGraph()
            with cuda.graph(self.graph, stream=cuda.Stream()):  # torch's own is on the device that captured first
                form.refresh(self.input, self.output)

    def replay(self) -> Tensor:
        """The product of what is in `input`, in `output`, without waiting for the device."""
        self.graph.replay()
        return self.output

    def __call__(self, x: Tensor) -> Tensor:
        """The product of x `[*batch, n_cols]` on the matrix's device, in `output`.

        Raises: ValueError for any other shape, dtype or device (copying would broadcast, convert or wait), or where x wants a gradient.
        """
        self.form.check(x, self.output)
        self.input.copy_(x)
        return self.replay()
