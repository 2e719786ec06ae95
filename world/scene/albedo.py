"""The albedo of a textured body as a picture, for programs that draw with pictures."""

from typing import Final

import torch
from torch import Tensor

from luxloop.world.scene.body import Body

TEXEL_M: Final = 0.05
MOST_TEXELS: Final = 2_000_000

Corner = tuple[float, float]


def albedo_picture(body: Body) -> tuple[Tensor, Corner, Corner]:
    """Albedo `[rows, columns]` over x and y of a body with a texture, x along columns, and the least and the greatest corner in m."""
    assert body.texture is not None
    (x0, y0), (x1, y1) = (each[:2].tolist() for each in body.bounds)
    texel_m = max(TEXEL_M, ((x1 - x0) * (y1 - y0) / MOST_TEXELS) ** 0.5)
    columns, rows = (max(round(side / texel_m), 1) for side in (x1 - x0, y1 - y0))
    x, y = (a + (torch.arange(n, dtype=torch.float64) + 0.5) * (b - a) / n for a, b, n in ((x0, x1, columns), (y0, y1, rows)))
    picture = body.texture.at(x.expand(rows, -1).contiguous(), y[:, None].expand(-1, columns).contiguous())
    return picture, (x0, y0), (x1, y1)
