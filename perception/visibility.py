"""Differentiable metrics of how well objects stand out in an image (T 9.2)."""

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

RING_PX = 6  # width of the ring around an object that counts as its background


def around(mask: Tensor, px: int = RING_PX) -> Tensor:
    """Ring of pixels `[height, width]` bool within a distance of px around an object. mask: of the object, `[height, width]` bool."""
    wider = max_pool2d(mask[None].float(), 2 * px + 1, 1, px)[0] > 0
    return wider & ~mask


def weber_contrast(luminance: Tensor, mask: Tensor, floor: float) -> Tensor:
    """`|L_o - L_b| / (L_b + floor)`, a scalar, of the mean luminances of an object and of the ring around it.

    luminance: `[height, width]` cd/m^2. floor: luminance that cannot be told from black, so that contrast in the dark counts nothing.
    """
    own, background = luminance[mask].mean(), luminance[around(mask)].mean()
    return (own - background).abs() / (background + floor)


def edge_definition(luminance: Tensor, mask: Tensor, floor: float) -> Tensor:
    """Mean steepness of the logarithm of `L + floor` along an object's outline, per px, a scalar."""
    log = (luminance + floor).log()
    steps = torch.stack([log[1:, :-1] - log[:-1, :-1], log[:-1, 1:] - log[:-1, :-1]])
    outline = (mask[1:, :-1] ^ mask[:-1, :-1]) | (mask[:-1, 1:] ^ mask[:-1, :-1])
    return (steps[:, outline].square().sum(0) + 1e-12).sqrt().mean()


def unevenness(light: Tensor, mask: Tensor, floor: float) -> Tensor:
    """Standard deviation over the mean plus floor of light `[height, width]` on an object, a scalar: 0 where it is homogeneous."""
    return light[mask].std(correction=0) / (light[mask].mean() + floor)
