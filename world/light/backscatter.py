"""Backscatter of a vehicle's own lamps in its camera: linear in the light textures, on a coarse grid of the image."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.world.caches import Part, keeping
from luxloop.world.frames import View
from luxloop.world.headlight import Headlight
from luxloop.world.light.volumetric import FARTHEST_M, airlight_matrix
from luxloop.world.scene.air import NEAR_M, Medium
from luxloop.world.spmv import Csr, multiply

CELLS: Final = 160  # least number of cells in a row of the image; their size is a power of two, in px
SAMPLES: Final = 32  # along a ray
KEPT: Final = 8  # matrices, of modules and their poses


@dataclass(eq=False)
class Backscatter:
    """Light of modules that the air scatters towards an eye, both rigid on a vehicle.

    view: of the eye in the vehicle's frame. Rays end on the plane z = 0 or after 400 m, so that a matrix holds while the vehicle moves:
    objects neither shadow the air nor hide the lit air behind them.
    """

    medium: Medium
    view: View

    def __post_init__(self) -> None:
        self._matrix = keeping(KEPT, self._matrix_of)

    @property
    def cell_px(self) -> int:
        """Width and height of a cell in px."""
        return 1 << max((max(self.view.width, self.view.height) // CELLS).bit_length() - 1, 0)

    def luminance(self, lit: Iterable[tuple[Headlight, Tensor, Tensor]], part: Part, of_texels: bool) -> Tensor | float:
        """Luminance `[..., h, w]` in cd/m^2 at a part of the image, interpolated between the centres of cells; 0.0 without a module.

        lit: modules with their pose `[4, 4]` on the vehicle, float64, and light texture `[..., n_texels]` in cd if of_texels, else
        utilisation `[..., n_p]`, which saves the texture.
        """
        size, columns = self.cell_px, self._cells.width
        (top, bottom), (left, right) = (
            (max(each.start // size - 1, 0), min((each.stop - 1) // size + 2, n))
            for each, n in zip(part, (self._cells.height, columns), strict=True)
        )
        total: Tensor | float = 0.0
        for headlight, T_body_headlight, light in lit:
            matrix = self._matrix(headlight, tuple(T_body_headlight.flatten().tolist()), of_texels)
            total = total + multiply(matrix.band(top * columns, bottom * columns), light)
        if isinstance(total, float):
            return total
        cells = total.unflatten(-1, (-1, columns))[..., left:right]
        image = interpolate(cells.reshape(-1, 1, *cells.shape[-2:]), scale_factor=size, mode="bilinear", align_corners=False)
        v, u = (slice(each.start - start * size, each.stop - start * size) for each, start in zip(part, (top, left), strict=True))
        return image.view(*cells.shape[:-2], *image.shape[-2:])[..., v, u]

    @property
    def _cells(self) -> View:
        """The view with a pixel for each cell; the last row and column may reach beyond the image."""
        size, view = self.cell_px, self.view
        shape = -(-view.width // size), -(-view.height // size)
        return View(*shape, view.fx / size, view.fy / size, view.cx / size, view.cy / size, view.T_world_view)

    def _matrix_of(self, headlight: Headlight, numbers: tuple[float, ...], of_texels: bool) -> Csr:
        T_body_headlight = torch.tensor(numbers, dtype=torch.float64).view(4, 4)
        rays, origin = self._cells.rays().flatten(1), self.view.origin
        rays = rays / rays.norm(dim=0)
        farthest_m = NEAR_M if self.medium.drawn_only else FARTHEST_M
        to_ground = torch.where(rays[2] < 0, -origin[2] / rays[2], farthest_m).clamp(0, farthest_m)
        given = T_body_headlight, origin.float(), rays.float(), to_ground.float()
        matrix = airlight_matrix(headlight, *given, self.medium, SAMPLES)
        matrix = matrix if of_texels else Csr.from_scipy(matrix.to_scipy() @ headlight.matrix.to_scipy())
        return matrix.to(headlight.matrix.values.device)
