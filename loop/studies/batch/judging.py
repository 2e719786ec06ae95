"""`luxloop.perception.metrics.evaluate` of many images at once, with fewer passes over them: the places in the image, and what is known
of the target, are the same for all.
"""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, pad

from luxloop.perception.appearance import appearance
from luxloop.perception.birdseye import BirdsEye, span
from luxloop.perception.metrics import SSIM_RADIUS, THRESHOLD, Metrics, Target, around, gaussian, hull


def judged(luminance: Tensor, view: BirdsEye, goal: Target, u_start: int, v_start: int) -> Metrics:
    """Verdicts `[B]` on luminances `[B, h, w]` in cd/m^2 of a crop of the image that starts at (u_start, v_start) px; the rest of the
    image is dark.
    """
    lit = (luminance != 0).any(0)
    v, u = span(lit.any(1)), span(lit.any(0))
    luminance, u_start, v_start = luminance[:, v, u], u_start + u.start, v_start + v.start
    found = view.cells_of(slice(v_start, v_start + luminance.shape[1]), slice(u_start, u_start + luminance.shape[2]))
    part = around(hull(found[0], goal.rows), hull(found[1], goal.cols), goal.mask.shape)
    seen, wanted, expected = view.within(*part), goal.mask[part].to(luminance), goal.luminance[part]
    plane = _rectified(seen, luminance, u_start, v_start)  # [B, rows, cols]
    mask = (plane > THRESHOLD * goal.median).to(plane)
    shape = appearance(mask, seen.axes)
    offset = shape.centroids[..., 0, :] - goal.shape.centroids[0]
    size = torch.tensor([goal.length_m, goal.width_m]).to(offset)
    both, either = mask.flatten(1) @ wanted.flatten(), mask.sum((1, 2)) + wanted.sum()  # numbers of cells, which are exact
    similarity = _similarity(_in_pairs(plane, goal), _in_pairs(expected, goal))
    share = similarity[0].numel() / (goal.mask.shape[0] // 2 * (goal.mask.shape[1] // 2))
    return Metrics(
        -100 * offset.flip(-1) / size,
        torch.where(either > both, both / (either - both).clamp(min=1), 1.0),
        1 - share * (1 - similarity.mean((1, 2))),
        shape.length / goal.shape.length,
        shape.shear,
    )


def _rectified(view: BirdsEye, images: Tensor, u_start: int, v_start: int) -> Tensor:
    """`luxloop.perception.birdseye.rectify` of images `[B, h, w]`, as channels of one, since all are sampled at the same places."""
    if not images.numel():
        return images.new_zeros(len(images), *view.map_u.shape)
    half = view.columns // 2
    flat = images[None] if not half else avg_pool2d(pad(images[None], (2 * half, 2 * half)), (1, view.columns), 1)
    height, width = flat.shape[-2:]
    u = 2 * (view.map_u.to(images) - u_start + half) / width - 1
    v = 2 * (view.map_v.to(images) - v_start) / height - 1
    return grid_sample(flat, torch.stack([u, v], -1)[None], padding_mode="zeros", align_corners=False)[0]


def _in_pairs(plane: Tensor, goal: Target) -> Tensor:
    """Light of cells `[..., rows, cols]`, from 0 to 1 at twice the target's median, as means of 2 x 2."""
    light = (plane * (0.5 / goal.median)).clamp_(0, 1)
    rows = light[..., ::2, :] + light[..., 1::2, :]
    return (rows[..., ::2] + rows[..., 1::2]).mul_(0.25)


def _similarity(a: Tensor, b: Tensor) -> Tensor:
    """Similarity `[B, rows, cols]` of images a `[B, rows, cols]` and b `[rows, cols]`; `luxloop.perception.metrics.ssim` is their mean."""
    mean_b, mean_bb = gaussian(torch.stack([b, b * b]), SSIM_RADIUS)
    mean_a, mean_aa, mean_ab = gaussian(torch.stack([a, a * a, a * b]), SSIM_RADIUS)
    product, squares = mean_a * mean_b, mean_a * mean_a + mean_b * mean_b
    c1, c2 = 0.01**2, 0.03**2
    alike = (2 * product + c1).mul_((mean_ab - product).mul_(2).add_(c2))
    return alike.div_((mean_aa.add_(mean_bb) - squares).add_(c2).mul_(squares + c1))
