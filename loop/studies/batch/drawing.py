"""One symbol drawn at many poses by a module: on a window of its light texture, and on the pixels and the part of the image that it
reaches.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from luxloop.controllers.pixels.mapping import stroke_light
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.rthc import RayBatch
from luxloop.controllers.pixels.ssc import PixelController, Ssc, WindowedSsc
from luxloop.controllers.pixels.windows import Window
from luxloop.perception.extraction import Crop
from luxloop.world.light.illumination import Transport
from luxloop.world.spmv import multiply, numbers, row_of_entries


def rays_at(controller: Ssc, primitives: Primitives, T_world_headlight: Tensor) -> RayBatch:
    """Rays at one primitive in B poses `[B, 1]`: at B primitives of one scene, painted separately so that none hides another."""
    count = len(primitives.origin)
    each = replace(
        primitives,
        **{name: getattr(primitives, name)[:, 0] for name in ("origin", "d1", "d2", "normal", "value", "weight")},
        **{name: getattr(primitives, name).expand(count) for name in ("quantity", "symbol_of", "nearest", "shared")},
        forced=torch.ones(count, dtype=torch.bool),
        priority=torch.arange(count),
        modules=primitives.modules * count,
    )
    return controller.ray_batch(each, T_world_headlight)


@dataclass(frozen=True, eq=False)
class ModulePart:
    """Pixels `[m]` of a module that draw, and their utilisations `[m]` at rest.

    drawn: from primitives in a window of the light texture to these pixels; None if all pixels draw.
    """

    pixels: Tensor
    rest: Tensor
    drawn: WindowedSsc | None

    @classmethod
    def of(cls, controller: PixelController, window: Window | None) -> "ModulePart":
        """Pixels that light a window; all pixels without a window."""
        if window is None:
            return cls(torch.arange(len(controller.default), device=controller.default.device), controller.default, None)
        assert isinstance(controller, Ssc)
        drawn = WindowedSsc.of(controller, window)
        return cls(drawn.pixels, controller.default[drawn.pixels], drawn)

    @property
    def window(self) -> Window | None:
        return None if self.drawn is None else self.drawn.window

    def crop(self, transport: Transport, width: int) -> Crop:
        """Crop that its pixels light in an image of this width."""
        matrix = transport.matrix
        lit = torch.unique_consecutive(row_of_entries(matrix)[numbers(self.pixels, matrix.n_cols)[matrix.indices] >= 0])
        if not len(lit):
            return Crop(0, 0, 0, 0)
        index = transport.index[lit]
        (top, left), (bottom, right) = (each.tolist() for each in torch.stack([index // width, index % width]).aminmax(dim=1))
        return Crop(top, bottom + 1, left, right + 1)


def utilisations(drawn: WindowedSsc, rays: RayBatch) -> Iterator[Tensor]:
    """Utilisations `[m]` of the pixels for each primitive in turn, as `WindowedSsc.utilisation` of one, by rays of any kind."""
    height, width = (each.stop - each.start for each in drawn.window.slices)
    strokes = rays.strokes()
    for window in rays.windows:
        image = drawn.ssc.default.new_zeros(height, width)
        if not window.empty:
            stroke = next(strokes)
            image[window.within(drawn.window)] = stroke_light(stroke, drawn.ssc.pixels) * stroke.hit
        yield multiply(drawn.weight, image.flatten()).clamp(0, 1)
