"""Changes of setpoints before the mapping that compensate blur: sharpening (T 7.5.2) and corrections."""

from dataclasses import replace

import torch
from torch import Tensor

from luxloop.controllers.pixels.pixel_major import PixelMajor
from luxloop.controllers.pixels.primitives import E_V, I_V, U_REL
from luxloop.controllers.pixels.rthc import Setpoints
from luxloop.world.spmv import multiply

FAINT = 1e-6  # share of a wanted setpoint that a correction leaves at least, so that a lit setpoint stays lit


def corrected(asked: Setpoints, wanted: Setpoints, u: Tensor, pixels: PixelMajor, default: Tensor) -> Setpoints:
    """The setpoints that led to u `[..., n_p]`, plus the error of its light against the wanted ones; not from the thesis.

    Van Cittert's deconvolution with MRPC in place of the blur's inverse: the error is of all pixels together, and MRPC again decides pixel
    by pixel. Dark, lit and missed setpoints stay so. default: `[n_p]`. Costs one product with the matrix.
    """
    grid, w = pixels.grid, wanted.window
    band = grid.matrix.band(w.row_start * grid.cols, w.row_stop * grid.cols)

    def on_window(texels: Tensor) -> Tensor:
        return texels.unflatten(-1, (-1, grid.cols))[..., w.slices[1]]

    in_cd, relative = wanted.portion(wanted.in_cd, I_V, E_V), wanted.portion(wanted.relative, U_REL)
    unit = in_cd + (1 - in_cd - relative) * pixels.total.view(grid.rows, grid.cols)[w.slices]
    if U_REL in wanted.quantities:
        unit = unit + relative * on_window(multiply(band, default))
    if pixels.darkening is not None:
        unit = unit * pixels.darkening.view(grid.rows, grid.cols)[w.slices]
    given = on_window(multiply(band, u)) / unit.masked_fill(unit == 0, torch.inf)
    return replace(asked, value=(asked.value + wanted.value - given).maximum(FAINT * wanted.value))  # s + w - A u / unit, [..., rows, cols]


def sharpened(setpoints: Setpoints, pixels: PixelMajor, strength: float, dark: bool) -> Setpoints:
    """Setpoints raised by the darkness around them, blurred like a pixel's light (T 7.5.2). dark: whether the base pattern is zero.

    Darkness is the relative difference of a setpoint in cd to the greatest one in the window. Rays without a hit are dark if the base
    pattern is.
    """
    from kornia.filters import gaussian_blur2d

    grid, w = pixels.grid, setpoints.window
    total = pixels.total.view(grid.rows, grid.cols)[w.slices]
    in_cd = setpoints.portion(setpoints.in_cd, I_V, E_V)
    level = setpoints.value * (in_cd + total * (1 - in_cd))
    bright = (level / level.amax((-2, -1), keepdim=True).clamp(min=1e-30)).clamp(0, 1)
    lit = bright if dark else torch.lerp(torch.ones_like(bright), bright, setpoints.cover)
    sigma = (max(pixels.spread[0], 0.3), max(pixels.spread[1], 0.3))
    kernel = (2 * round(3 * sigma[0]) + 1, 2 * round(3 * sigma[1]) + 1)
    margins = (kernel[1] // 2, kernel[1] // 2, kernel[0] // 2, kernel[0] // 2)
    lit = torch.nn.functional.pad(lit, margins, value=0.0 if dark else 1.0)
    flat = lit.reshape(-1, 1, *lit.shape[-2:])
    blurred = gaussian_blur2d(flat, kernel, sigma, border_type="constant").reshape(lit.shape)
    rows, cols = bright.shape[-2:]
    raised = 1 + strength * (1 - blurred[..., margins[2] : margins[2] + rows, margins[0] : margins[0] + cols])  # T 7.5.2, [..., rows, cols]
    return replace(setpoints, value=setpoints.value * raised)
