"""One symbol drawn at many poses by a module: on a window of its light texture, and on the pixels and the part of the image that it
reaches.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.controllers.pixels.mapping import stroke_light
from luxloop.controllers.pixels.primitives import U_ABS, Primitives
from luxloop.controllers.pixels.rthc import GRAZING, RayBatch
from luxloop.controllers.pixels.ssc import PixelController, Ssc, WindowedSsc
from luxloop.controllers.pixels.windows import row_bands
from luxloop.world.light.illumination import Transport
from luxloop.world.spmv import multiply, numbers, row_of_entries
from luxloop.world.texels import NOWHERE, Window


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

    def crop(self, transport: Transport, width: int) -> Window:
        """Window that its pixels light in an image of this width."""
        matrix = transport.matrix
        lit = torch.unique_consecutive(row_of_entries(matrix)[numbers(self.pixels, matrix.n_cols)[matrix.indices] >= 0])
        if not len(lit):
            return NOWHERE
        index = transport.index[lit]
        (top, left), (bottom, right) = (each.tolist() for each in torch.stack([index // width, index % width]).aminmax(dim=1))
        return Window(top, bottom + 1, left, right + 1)


def utilisations(drawn: WindowedSsc, rays: RayBatch) -> Iterator[Tensor]:
    """Utilisations `[m]` of the pixels for each primitive in turn, as `WindowedSsc.utilisation` of one."""
    images = _sample(drawn, rays) if _plain(drawn, rays) else _paint(drawn, rays)
    for image in images:
        yield multiply(drawn.weight, image.flatten()).clamp(0, 1)


def _paint(drawn: WindowedSsc, rays: RayBatch) -> Iterator[Tensor]:
    """Setpoints `[rows, cols]` of the window for each primitive in turn, by rays of any kind, with gradients."""
    height, width = (each.stop - each.start for each in drawn.window.slices)
    strokes = rays.strokes()
    for window in rays.windows:
        image = drawn.ssc.default.new_zeros(height, width)
        if not window.empty:
            stroke = next(strokes)
            image[window.within(drawn.window)] = stroke_light(stroke, drawn.ssc.pixels) * stroke.hit
        yield image


def _plain(drawn: WindowedSsc, rays: RayBatch) -> bool:
    """Whether the setpoints sample one image, seen from the front, without gradients."""
    primitives = rays.primitives
    image = primitives.image_of(0)
    sampled = image.dim() == 2 and image.numel() > 1 and not bool(primitives.nearest[0]) and primitives.observer is None
    absolute = rays.quantities == (U_ABS,) and drawn.ssc.pixels.darkening is None and rays.secondary is None
    return sampled and absolute and None not in rays.front and True not in rays.is_mask and not primitives.origin.requires_grad


def _sample(drawn: WindowedSsc, rays: RayBatch) -> Iterator[Tensor]:
    """Setpoints `[rows, cols]` of the window for each primitive in turn, in few passes over bands of rows. The image yielded is reused."""
    grid, primitives, window = rays.grid, rays.primitives, drawn.window
    y, z = grid.tangents(primitives.origin.dtype, primitives.origin.device)
    products = torch.cat([rays.seen.n[:, None], rays.seen.uv], 1)[..., None]  # [B, 3, 3, 1]: d.n, and twice u d.n and v d.n
    rows, cols = products[:, :, 0] + products[:, :, 2] * z, products[:, :, 1] * y  # [B, 3, R], [B, 3, C]
    symbol, value = primitives.image_of(0)[None, None], float(primitives.value[0])  # common to all
    image = drawn.ssc.default.new_zeros(*(each.stop - each.start for each in window.slices))
    for k, bands in enumerate(row_bands(primitives, grid, rays.T_world_headlight, rays.windows)):
        for band in bands:
            r, c = band.slices
            rays_ = rows[k, :, r, None] + cols[k, :, None, c]  # [3, rows, cols]
            n, uv = rays_[0], rays_[1:]
            off = uv.abs()
            hit = torch.maximum(*off).neg_().add_(n).ge_(0)  # |2 u d.n| <= d.n and |2 v d.n| <= d.n (T eq. 7.3.3)
            uv.div_(n.clamp_(min=GRAZING))
            found = grid_sample(symbol, uv.movedim(0, -1)[None], padding_mode="border", align_corners=False)[0, 0]
            image[band.within(window)] = (found if value == 1 else found.mul_(value)).clamp_(0, 1).mul_(hit)
        yield image
        for band in bands:
            image[band.within(window)].zero_()
