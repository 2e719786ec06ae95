"""Images taken at other places, bilinearly."""

from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import grid_sample


def resampled(image: Tensor, u: Tensor, v: Tensor, beyond: Literal["zeros", "border"] = "zeros", corners: bool = False) -> Tensor:
    """An image `[B, channels, H, W]` at places u, v `[B or 1, h, w]`, which run from -1 to 1 over its width and height:
    `[B, channels, h, w]`.

    beyond: what is taken beyond its borders. corners: whether -1 and 1 are the middles of the outer pixels, in place of their edges.
    """
    places = torch.stack([u, v], -1).expand(len(image), -1, -1, -1)  # [B, h, w, 2]
    return grid_sample(image, places, mode="bilinear", padding_mode=beyond, align_corners=corners)
