"""A product as a captured CUDA graph: one launch a step, into memory that stays in place."""

import torch
from torch import Tensor, cuda

from luxloop.world.errors import LuxloopError
from sparse.protocol import SparseFormat

WARM_UPS = 3  # libraries make their workspaces in the first calls, which must not be captured


class CapturedProduct:
    """`A x` of one shape of x; `input` and `output` are the same tensors at each call.

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
