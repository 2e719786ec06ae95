"""Drops and flakes near a camera, lit by the own lamps: streaks during an exposure (Garg and Nayar, "Vision and Rain", 2007)."""

from collections.abc import Iterable
from typing import Final

import numpy as np
import torch
from torch import Tensor

from luxloop.world.frames import View, inverse, transform
from luxloop.world.headlight import Headlight
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.light.volumetric import phase
from luxloop.world.scene.air import NEAR_M, Medium, Precipitation

SHELLS: Final = 600  # of depth, over which numbers of drops are tabled
PER_PX: Final = 2.0  # points that stand for a pixel of a streak
MOST_POINTS: Final = 4096  # of a streak
CLOSEST_M: Final = 0.1  # depth of a point that is seen


def drop_luminance(
    medium: Medium,
    view: View,
    later: View,
    exposure_s: float,
    lit: Iterable[tuple[Headlight, Tensor, Tensor]],
    random: np.random.Generator,
) -> Tensor:
    """Luminance `[height, width]` in cd/m^2, float32, of drops and flakes drawn at random, mean over an exposure.

    view, later: of the eye when the exposure begins and ends, in the vehicle's frame of the begin, along whose z they fall. lit: as of
    `Backscatter.luminance`, with light textures. A drop scatters twice the light on its cross-section, as the medium does; over many
    exposures the mean is the backscatter of the medium with `drawn_only`, where no light leaves a pixel by streaks.
    """
    image = torch.zeros(view.height * view.width)
    T_begin_later, lit = inverse(view.T_world_view) @ later.T_world_view, list(lit)
    T_later_begin = inverse(T_begin_later)
    for kind in medium.falling:
        longest, least, rate = kind.fall
        turned_m = NEAR_M * float((T_later_begin[:3, :3] - torch.eye(3)).norm())
        margin_m = (longest * exposure_s + float(T_begin_later[:3, 3].norm()) + turned_m) / 2
        middle, size_mm = _sizes(kind, view, margin_m, random)
        on_body = transform(view.T_world_view, middle)
        light = _light(medium, on_body, view, lit) * (on_body[2] > 0)
        bright = torch.nonzero(light)[:, 0]
        middle, size_mm, light = middle[:, bright], size_mm[bright], light[bright]
        width_m = 1e-3 * kind.width[0] * size_mm ** kind.width[1]
        fall_m = torch.zeros_like(middle)
        fall_m[2] = -exposure_s * (longest - least * (-rate * size_mm).exp()).clamp(min=0)
        path = transform(T_later_begin, middle + view.T_world_view[:3, :3].T @ fall_m) - middle
        depth = middle[2].clamp(min=CLOSEST_M)
        per_px = view.fx * view.fy * middle.norm(dim=0) / depth**3  # 1/m^2: distance^2 times a pixel's solid angle is its inverse
        discs = tuple(each.float() for each in (middle, path, width_m, light * torch.pi / 2 * width_m**2 * per_px))
        image += _streaks(view, discs, random)
    return image.view(view.height, view.width)


def _sizes(kind: Precipitation, view: View, margin_m: float, random: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Places `[3, n]` m in the view's frame and sizes D `[n]` in mm of those that are drawn, a margin around the view.

    Sizes above any least one are again exponential; a least size at a depth is thinned to that at the distance.
    """
    z = np.linspace(0, NEAR_M, SHELLS)
    wide, high = (n / f * z + 2 * margin_m for n, f in ((view.width, view.fx), (view.height, view.fy)))
    number = wide * high * kind.number_m3_mm / kind.slope_mm * np.exp(-kind.slope_mm * kind.least_mm(torch.from_numpy(z)).numpy())  # 1/m
    sums = np.r_[0, np.cumsum((number[1:] + number[:-1]) / 2 * np.diff(z))]
    n = random.poisson(sums[-1])
    depth = np.interp(random.random(n) * sums[-1], sums, z)
    aside = [
        random.random(n) * (pixels / f * depth + 2 * margin_m) - c / f * depth - margin_m
        for pixels, f, c in ((view.width, view.fx, view.cx), (view.height, view.fy, view.cy))
    ]
    place = torch.from_numpy(np.stack([*aside, depth]))
    distance = place.norm(dim=0)
    size = kind.least_mm(place[2]) + torch.from_numpy(random.exponential(1 / kind.slope_mm, n))
    seen = torch.nonzero((size >= kind.least_mm(distance)) & (distance < NEAR_M))[:, 0]
    return place[:, seen], size[seen]


def _light(medium: Medium, points: Tensor, view: View, lit: Iterable[tuple[Headlight, Tensor, Tensor]]) -> Tensor:
    """Luminous intensity towards the eye `[n]` in cd, less what the air takes, of points `[3, n]` that scatter the light on 1 m^2."""
    to_eye = view.origin[:, None] - points
    distance = to_eye.norm(dim=0)
    total = torch.zeros_like(distance)
    for headlight, T_body_headlight, texture in lit:
        ray = transform(inverse(T_body_headlight), points)
        intensity = headlight.intensity(texture.cpu().double().view(headlight.rows, headlight.cols), ray)
        from_lamp = points - T_body_headlight[:3, 3:]
        away = from_lamp.norm(dim=0)
        cosine = (from_lamp * to_eye).sum(0) / (away * distance)
        passed = torch.exp(-medium.extinction_per_m * (away + distance))
        total += intensity * lux_per_cd(from_lamp) * phase(cosine, medium.asymmetry) * passed
    return total


def _streaks(view: View, discs: tuple[Tensor, ...], random: np.random.Generator) -> Tensor:
    """Image `[height * width]` of discs that move: their middle `[3, n]` m and path about it `[3, n]` m, in the view's frame, width `[n]` m
    and light `[n]`, the sum over its pixels, which random points on a disc share.
    """
    middle, path, width_m, light = discs
    depth = middle[2].clamp(min=CLOSEST_M)
    disc = view.fx * width_m / depth  # px
    length = view.fx * (path[:2] - middle[:2] / depth * path[2]).norm(dim=0) / depth
    n = (PER_PX * (length + disc + 1) * (disc + 1)).ceil().clamp(max=MOST_POINTS).long()
    of = torch.repeat_interleave(torch.arange(len(n)), n)
    along = (torch.arange(len(of)) - (n.cumsum(0) - n)[of] + 0.5) / n[of] - 0.5
    radius, angle = torch.from_numpy(random.random((2, len(of)), np.float32))
    radius = disc[of] / 2 * radius.sqrt()
    x, y, z = middle[:, of] + along * path[:, of]
    z = z.clamp(min=CLOSEST_M)
    column = (view.fx * x / z + view.cx + radius * (2 * torch.pi * angle).cos()).floor().long()
    row = (view.fy * y / z + view.cy + radius * (2 * torch.pi * angle).sin()).floor().long()
    inside = torch.nonzero((row >= 0) & (row < view.height) & (column >= 0) & (column < view.width))[:, 0]
    pixel, share = (row * view.width + column)[inside], (light / n)[of[inside]]
    return torch.bincount(pixel, share, minlength=view.height * view.width)
