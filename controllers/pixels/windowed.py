"""The same as `Ssc` where one primitive is drawn over dark pixels again and again, near the same place: products on its window alone."""

from dataclasses import dataclass

import torch
from torch import Tensor

from luxloop.controllers.pixels.map_products import light_of
from luxloop.controllers.pixels.map_sums import Band
from luxloop.controllers.pixels.mrpc import same_for_all_pixels
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.rthc import RayBatch
from luxloop.controllers.pixels.ssc import PixelController, Ssc
from luxloop.controllers.pixels.windows import Window
from luxloop.world.spmv import Csr, multiply, numbers, row_of_entries


@dataclass(frozen=True, eq=False)
class WindowedSsc:
    """Utilisations of the pixels that light a window of the light texture, from primitives within that window.

    pixels: `[m]` int64, ascending. weight: `[m, rows * cols]`, their part of the pixel-major matrix. window: of rows x cols texels.
    """

    ssc: Ssc
    window: Window
    pixels: Tensor
    weight: Csr

    @classmethod
    def of(cls, ssc: Ssc, window: Window) -> "WindowedSsc":
        """Cut the window's part out of the tables."""
        band = Band.touched(ssc.pixels, window).pixels
        matrix, grid = ssc.pixels.full.band(band.start, band.stop), ssc.pixels.grid
        texel = torch.arange(grid.rows * grid.cols, device=matrix.indices.device).view(grid.rows, grid.cols)[window.slices].flatten()
        number = numbers(texel, grid.rows * grid.cols)
        lit = torch.unique_consecutive(row_of_entries(matrix)[number[matrix.indices] >= 0])
        weight = matrix.part(numbers(lit, matrix.n_rows), number, (len(lit), len(texel)))
        return cls(ssc, window, band.start + lit, weight)

    def utilisation(self, casting: RayBatch) -> Tensor:
        """Utilisation `[m]` of the pixels, as `Ssc.utilisation` gives them."""
        height, width = (each.stop - each.start for each in self.window.slices)
        image = self.ssc.default.new_zeros(height, width)
        for stroke in casting.strokes():
            image[stroke.window.within(self.window)] = light_of(stroke, self.ssc.pixels) * stroke.hit
        return multiply(self.weight, image.flatten()).clamp(0, 1)


def serves(controller: PixelController, primitives: Primitives, T_world_headlight: Tensor) -> bool:
    """Whether a window's products are all that primitives need: there is one, its setpoints are the same utilisation for all pixels of a
    texel, all pixels beside it are dark, and neither weights nor the number of lit setpoints count.
    """
    if not isinstance(controller, Ssc) or not controller.dark or len(primitives) != 1:
        return False
    casting, params = controller.casting(primitives, T_world_headlight), controller.params
    alone = casting.unit and casting.finite and not (params.sharpening or params.corrections or params.a_ac)
    return alone and same_for_all_pixels(casting, controller.pixels, params, dark=True)
