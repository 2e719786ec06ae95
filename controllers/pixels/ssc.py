"""SuperSampling Control (SSC, T 7) from primitives to pixel utilisations, and the protocol of all pixel controllers.

`WindowedSsc` is its form for repeated drawing of one primitive near one place over dark pixels.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import torch
from torch import Tensor

from luxloop.controllers.pixels.mapping import Band, stroke_light
from luxloop.controllers.pixels.mrpc import reduce_setpoints, same_for_all_pixels
from luxloop.controllers.pixels.pixel_major import MrpcParams, PixelMajor
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.rthc import RayBatch, Setpoints, masks
from luxloop.controllers.pixels.secondary import SecondaryRays
from luxloop.controllers.pixels.windows import projected_windows
from luxloop.world.headlight import Headlight
from luxloop.world.spmv import Csr, multiply, numbers, row_of_entries
from luxloop.world.texels import Window


@dataclass(frozen=True)
class Utilisation:
    """The light of one module.

    u: utilisation `[..., n_p]` of its pixels in 0..1. band: range of pixels outside which all are dark, None if unknown.
    """

    u: Tensor
    band: slice | None = None


class PixelController(Protocol):
    """Turns primitives into the utilisations of one lamp."""

    @property
    def headlight(self) -> Headlight: ...

    @property
    def default(self) -> Tensor:
        """Utilisation `[n_p]` of the base pattern."""
        ...

    def utilisation(self, primitives: Primitives, T_world_headlight: Tensor, secondary: SecondaryRays | None = None) -> Utilisation:
        """Utilisation `[..., n_p]` for primitives with the same batch dimensions. secondary: secondary rays, by default none."""
        ...

    def over(self, default: Tensor) -> Self:
        """The controller over another base pattern `[n_p]`."""
        ...


@dataclass(frozen=True)
class Ssc:
    """RTHC and MRPC for one headlight; default: `[n_p]`, the base pattern's utilisation."""

    pixels: PixelMajor
    default: Tensor

    @property
    def headlight(self) -> Headlight:
        return self.pixels.grid

    @property
    def params(self) -> MrpcParams:
        return self.pixels.params

    @cached_property
    def dark(self) -> bool:
        """Whether the base pattern is zero; then only rays that hit a primitive and their pixels matter."""
        return not bool(self.default.any())

    @classmethod
    def prepare(cls, headlight: Headlight, params: MrpcParams | None = None, default: Tensor | None = None) -> "Ssc":
        """default: base pattern `[n_p]`, by default dark."""
        values = headlight.matrix.values
        default = torch.zeros(headlight.n_pixels, dtype=values.dtype, device=values.device) if default is None else default
        return cls(PixelMajor(headlight, params or MrpcParams()), default)

    def utilisation(self, primitives: Primitives, T_world_headlight: Tensor, secondary: SecondaryRays | None = None) -> Utilisation:
        """Utilisation `[..., n_p]`. A single scene on the CPU uses only the projected windows and their band of pixels, others all rays.

        Raises LuxloopError for values on the host that are not finite.
        """
        u, band = self.reduce(self.ray_batch(primitives, T_world_headlight, secondary))
        return Utilisation(u, band if _on_host(primitives) and self.dark else None)

    def ray_batch(self, primitives: Primitives, T_world_headlight: Tensor, secondary: SecondaryRays | None = None) -> RayBatch:
        """Rays to cast at primitives, which are converted to the dtype of the headlight."""
        if primitives.origin.dtype != self.default.dtype:
            primitives = primitives.to(self.default.dtype)
        windows = None
        if _on_host(primitives):
            windows = projected_windows(primitives, self.headlight, T_world_headlight, masks(primitives))
        return RayBatch.prepare(primitives, self.headlight, T_world_headlight, windows, secondary)

    def reduce(self, asked: Setpoints | RayBatch) -> tuple[Tensor, slice]:
        """Utilisation `[..., n_p]` and the band of pixels that may differ from the default, see `reduce_setpoints`."""
        return reduce_setpoints(asked, self.pixels, self.params, self.default, self.dark)

    def over(self, default: Tensor) -> "Ssc":
        """The controller over another base pattern `[n_p]`, such as a morphed beam, with the same tables."""
        default = default.to(self.default)
        return self if default is self.default else replace(self, default=default)


def _on_host(primitives: Primitives) -> bool:
    """Whether the primitives are a single scene on the host, whose windows need no synchronisation with a device."""
    return primitives.origin.ndim == 2 and primitives.origin.device.type == "cpu"


@dataclass(frozen=True, eq=False)
class WindowedSsc:
    """SSC of the pixels that light a window of the light texture, for primitives within the window.

    pixels: `[m]` int64, ascending. weight: `[m, rows * cols]`, part of the pixel-major matrix for these pixels and the texels of the
    window.
    """

    ssc: Ssc
    window: Window
    pixels: Tensor
    weight: Csr

    @classmethod
    def of(cls, ssc: Ssc, window: Window) -> "WindowedSsc":
        """The window's part of the tables."""
        band = Band.of_window(ssc.pixels, window).pixels
        matrix, grid = ssc.pixels.full.band(band.start, band.stop), ssc.pixels.grid
        texel = torch.arange(grid.rows * grid.cols, device=matrix.indices.device).view(grid.rows, grid.cols)[window.slices].flatten()
        number = numbers(texel, grid.rows * grid.cols)
        lit = torch.unique_consecutive(row_of_entries(matrix)[number[matrix.indices] >= 0])
        return cls(ssc, window, band.start + lit, matrix.part(lit, texel))

    def utilisation(self, casting: RayBatch) -> Tensor:
        """Utilisation `[m]` of the pixels, as `Ssc.utilisation` gives them."""
        height, width = (each.stop - each.start for each in self.window.slices)
        image = self.ssc.default.new_zeros(height, width)
        for stroke in casting.strokes():
            image[stroke.window.within(self.window)] = stroke_light(stroke, self.ssc.pixels) * stroke.hit
        return multiply(self.weight, image.flatten()).clamp(0, 1)


def window_suffices(controller: PixelController, primitives: Primitives, T_world_headlight: Tensor) -> bool:
    """Whether `WindowedSsc` gives the utilisations of `Ssc`: for one primitive, with one utilisation for all pixels of a texel, a dark base
    pattern, unit weights, and neither sharpening, corrections nor an activation threshold.
    """
    if not isinstance(controller, Ssc) or not controller.dark or len(primitives) != 1:
        return False
    casting, params = controller.ray_batch(primitives, T_world_headlight), controller.params
    alone = casting.unit and casting.finite and not (params.sharpening or params.corrections or params.a_ac)
    return alone and same_for_all_pixels(casting, controller.pixels, params, dark=True)
