"""Ray tracing headlight control (T 7.3): from primitives to a setpoint for every ray of a light texture.

All rays of a module share their origin, so the ray-plane system (7.3.3) is one 3 x 3 homography a primitive: with q from the lamp to the
primitive's centre, n = d1 x d2 and the unnormalised ray d = [1, y, z], u = d.(d2 x q) / d.n, v = d.(q x d1) / d.n, x = q.n / d.n. Counted
from the centre, u and v run from -1/2 to 1/2; twice that, from -1 to 1, is what image sampling takes. Turned so that q.n > 0, a ray hits
where |u d.n| <= d.n and |v d.n| <= d.n. Each term is affine in the texel's row and column, so no rays are stored.

Primitives are painted one after the other, so that the last that may cover a ray is the one that wins it. On the CPU comparisons and
selections cost ten times as much as sums, so masks are images of zeros and ones, and painting is blending.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import torch
from kornia.geometry.transform import remap
from torch import Tensor

from controllers.primitives import E_V, U_ABS, U_REL, Primitives
from controllers.windows import NEAREST_M, NOWHERE, SLACK, Window, union, whole
from world.texels import TexelGrid

COPLANAR = 1e-4  # of the distance: what lies closer together counts as one plane, whatever the dtype rounds
PARALLEL = 1e-6  # of the cosine: a given normal that is that of the edges
STEEP = 1e30  # takes whatever is not rounded to zero beyond one


@dataclass(frozen=True)
class Setpoints:
    """Ray setpoints on a window of the light texture; all images are `[..., rows, cols]`, those that are 0 or 1 in the dtype of value.

    value: in cd (I_v, E_v) or as a share (u_abs, u_rel), 0 without a hit. cover: 1 where a primitive is hit; elsewhere the default counts
    with weight 1. quantities: codes that may occur. finite: weights where they are finite, else 0; None where all are 1. forced: 1 where
    the weight is infinite, None if it is so nowhere; masking: whether the setpoint is zero there, as far as the host knows. in_cd,
    relative: 1 where the value is an intensity or a share of the default, None if all rays are alike. winner: the primitive that is hit,
    where something is, None if there is only one.
    """

    value: Tensor
    cover: Tensor
    window: Window
    quantities: tuple[int, ...]
    finite: Tensor | None = None
    forced: Tensor | None = None
    masking: bool = False
    in_cd: Tensor | None = None
    relative: Tensor | None = None
    winner: Tensor | None = None

    @property
    def hit(self) -> Tensor:
        """Which rays hit a primitive, `[..., rows, cols]` bool."""
        return self.cover > 0

    @property
    def weight(self) -> Tensor | None:
        """Weights from 0 to infinity, 1 without a hit; None where all are 1."""
        return self.finite if self.forced is None or self.finite is None else self.finite.masked_fill(self.forced > 0, torch.inf)

    @property
    def quantity(self) -> Tensor | None:
        """Codes `[..., rows, cols]`, I_v for all that is in cd; None if all rays are alike."""
        if self.in_cd is None and self.relative is None:
            return None
        absolute = torch.full_like(self.value, U_ABS)
        absolute = absolute if self.in_cd is None else absolute - U_ABS * self.in_cd
        return absolute if self.relative is None else absolute + (U_REL - U_ABS) * self.relative


@dataclass(frozen=True)
class Homographies:
    """Primitives as a headlight sees them: `[..., P, 3]`, to be multiplied with rays [1, y, z], and `[..., P]`.

    n, u, v: d.n and twice u d.n and v d.n, turned so that `qn`, q.n, is positive. normal: as given. mask: a zero setpoint of infinite
    weight. aside_u, wider_u, aside_v, wider_v: how far a mask's edges move for it to reach one texel further: |u - aside| <= n + wider.
    toward: cosine, times a length, at which the lamp sees the primitive's middle. near, far: 1/x of the nearest and the
    farthest corner. low, high: `[..., P, 2]`, projected outline in rows and columns, infinite where it reaches behind the lamp.
    """

    n: Tensor
    u: Tensor
    v: Tensor
    normal: Tensor
    qn: Tensor
    mask: Tensor
    aside_u: Tensor
    wider_u: Tensor
    aside_v: Tensor
    wider_v: Tensor
    toward: Tensor
    near: Tensor
    far: Tensor
    low: Tensor
    high: Tensor


def homographies(primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor) -> Homographies:
    """Every primitive in the coordinates of a headlight's rays."""
    R = T_world_headlight[:3, :3].to(primitives.origin)
    origin, d1, d2, normal = (
        v @ R for v in (primitives.origin - T_world_headlight[:3, 3].to(R), primitives.d1, primitives.d2, primitives.normal)
    )
    q = origin + (d1 + d2) / 2
    n = torch.linalg.cross(d1, d2)
    qn = (q * n).sum(-1)
    sign = torch.where(qn < 0, -1.0, 1.0).to(qn)[..., None]
    n, u, v = n * sign, 2 * torch.linalg.cross(d2, q) * sign, 2 * torch.linalg.cross(q, d1) * sign

    mask = (primitives.value == 0) & primitives.weight.isinf()

    def change(a: Tensor) -> Tensor:
        """By how much a product with a ray changes over one texel."""
        a = a.detach()
        return a[..., 1].abs() * ((grid.left - grid.right) / grid.cols) + a[..., 2].abs() * ((grid.top - grid.bottom) / grid.rows)

    x, y, z = torch.stack([origin, origin + d1, origin + d2, origin + d1 + d2], -2).detach().unbind(-1)
    behind = (x < NEAREST_M).any(-1)[..., None]
    x = x.clamp(min=NEAREST_M)
    at = torch.stack(grid.texel_of(y / x, z / x), -1)
    return Homographies(
        n,
        u,
        v,
        normal,
        qn.abs(),
        mask,
        *(mask * moved / 2 for a in (u, v) for moved in (change(n - a) - change(n + a), change(n - a) + change(n + a))),
        -(normal * q).sum(-1).detach(),
        1 / x.amin(-1),
        1 / x.amax(-1),
        at.amin(-2).masked_fill(behind, -torch.inf),
        at.amax(-2).masked_fill(behind, torch.inf),
    )


def paint_classes(primitives: Primitives) -> list[list[int]]:
    """Primitives as they are painted, in classes of which each beats all before it, at any distance.

    Forced hits come after the others, by priority; within a class the nearer one wins, coplanar ones by priority and then as listed.
    """
    keys = [(forced, priority) for forced, priority in zip(primitives.forced.tolist(), primitives.priority.tolist(), strict=True)]
    order = sorted(range(len(keys)), key=keys.__getitem__)
    return [list(of_class) for _, of_class in groupby(order, key=lambda p: keys[p] if keys[p][0] else None)]


def masks(primitives: Primitives) -> list[bool]:
    """Which of a single scene's primitives are masks: a zero setpoint of infinite weight."""
    return [value == 0 and weight == torch.inf for value, weight in zip(primitives.value.tolist(), primitives.weight.tolist(), strict=True)]


def trace(primitives: Primitives, grid: TexelGrid, T_world_headlight: Tensor, windows: Sequence[Window] | None = None) -> Setpoints:
    """Cast a ray through every texel's centre and take the setpoint of the primitive that it hits.

    primitives: batch `[..., P]`. T_world_headlight: `[4, 4]`. windows: the texels that each primitive of a single scene on the host can
    touch (all); the setpoints lie on their union. Back faces are not hit; E_v becomes `E d^2 / cos` (T 7.2.1). A mask, which has a zero
    setpoint of infinite weight, is hit by all rays within one texel of its outline, since light is interpolated between them.
    Differentiable in the primitives (not across their edges).
    """
    single = windows is not None
    windows = [whole(grid)] * len(primitives) if windows is None else list(windows)
    seen = homographies(primitives, grid, T_world_headlight)
    front = _from_the_front(seen) if single else [None] * len(primitives)
    is_mask = masks(primitives) if single else [None] * len(primitives)
    windows = [NOWHERE if seen_from is False else window for window, seen_from in zip(windows, front, strict=True)]
    canvas = _Canvas.blank(primitives, union(windows))
    y, z = grid.tangents(primitives.origin.dtype, primitives.origin.device)
    for painted in paint_classes(primitives):
        canvas.begin([windows[p] for p in painted])
        for p in painted:
            if not windows[p].empty:
                rays = _Rays(y[windows[p].slices[1]], z[windows[p].slices[0]], windows[p])
                rivals = any(windows[p].meets(windows[k]) for k in painted if k != p)
                canvas.paint(p, _hit(rays, seen, p, is_mask[p], front[p]), rays, primitives, seen, rivals)
    masking = single and all(mask for mask, weight in zip(is_mask, primitives.weight.tolist(), strict=True) if weight == torch.inf)
    return canvas.setpoints(primitives, masking)


@dataclass(frozen=True)
class _Rays:
    """Tangents of the rays [1, y, z] through a window: y `[cols]`, z `[rows]`."""

    y: Tensor
    z: Tensor
    window: Window

    def times(self, a: Tensor) -> Tensor:
        """Products with vectors `[..., 3]`: `[..., rows, cols]`."""
        a = a[..., None, :]
        return (a[..., 0] + a[..., 2] * self.z)[..., :, None] + (a[..., 1] * self.y)[..., None, :]


def _from_the_front(seen: Homographies) -> list[bool | None]:
    """Whether the lamp sees the front of a single scene's primitives, None where each ray has to be asked.

    It has where a given normal is not that of the edges, except of masks, which are seen as their middles are.
    """
    cosine = (seen.normal * seen.n).sum(-1).abs() / seen.n.norm(dim=-1)
    decided = seen.mask | (cosine > 1 - PARALLEL)
    return [front if known else None for front, known in zip((seen.toward > 0).tolist(), decided.tolist(), strict=True)]


def _step(a: Tensor) -> Tensor:
    """One where a >= 0, else zero; overwrites a."""
    return a.mul_(STEEP).add_(1).clamp_(0, 1)


def _hit(rays: _Rays, seen: Homographies, p: int, mask: bool | None, front: bool | None) -> Tensor:
    """One where a ray hits the p-th primitive, `[..., rows, cols]`; mask, front: whether it is one and is seen so, where the host knows."""
    n = rays.times(seen.n[..., p, :].detach())
    u, v = (rays.times(a[..., p, :].detach()) for a in (seen.u, seen.v))
    if mask is False:
        hit = _step(n - torch.maximum(u.abs_(), v.abs_()))
        return hit if front else hit * _step(rays.times(-seen.normal[..., p, :].detach()))
    aside_u, wider_u, aside_v, wider_v = (a[..., p, None, None] for a in (seen.aside_u, seen.wider_u, seen.aside_v, seen.wider_v))
    hit = _step(n - torch.maximum((u - aside_u).abs_() - wider_u, (v - aside_v).abs_() - wider_v))
    wide = seen.mask[..., p, None, None]
    if not front:
        facing = torch.where(wide, seen.toward[..., p, None, None], rays.times(-seen.normal[..., p, :].detach()))
        hit *= _step(facing)
    return hit * torch.where(wide, _near_outline(rays, seen.low[..., p, :], seen.high[..., p, :]), 1.0)


def _near_outline(rays: _Rays, low: Tensor, high: Tensor) -> Tensor:
    """Texels at most one beyond the rectangle around an outline: where its corners are acute, widening alone would reach too far."""
    within = []
    for axis, (start, stop) in enumerate((rays.window.slices[0].indices(1 << 30)[:2], rays.window.slices[1].indices(1 << 30)[:2])):
        centre = torch.arange(start, stop, dtype=low.dtype, device=low.device) + 0.5
        within.append((centre >= low[..., axis, None] - 1 - SLACK) & (centre <= high[..., axis, None] + 1 + SLACK))
    return (within[0][..., :, None] & within[1][..., None, :]).to(low)


@dataclass(frozen=True)
class _Canvas:
    """What the rays of the window carry so far; closeness: 1/x of the nearest hit of the class that is being painted."""

    window: Window
    value: Tensor
    cover: Tensor
    finite: Tensor | None
    forced: Tensor | None
    in_cd: Tensor | None
    relative: Tensor | None
    winner: Tensor | None
    closeness: Tensor | None

    @classmethod
    def blank(cls, primitives: Primitives, window: Window) -> "_Canvas":
        """Images only of what differs from ray to ray."""
        size = (window.row_stop - window.row_start, window.col_stop - window.col_start)
        zero = primitives.origin.new_zeros(*primitives.origin.shape[:-2], *size)
        codes, known = set(primitives.quantity.tolist()), primitives.weight.device.type == "cpu"

        def image(needed: bool, filled: float = 0.0) -> Tensor | None:
            return torch.full_like(zero, filled) if needed else None

        return cls(
            window,
            zero,
            torch.zeros_like(zero),
            image(not known or bool((primitives.weight != 1).any()), 1.0),
            image(not known or bool(primitives.weight.isinf().any())),
            image(min(codes) < U_ABS <= max(codes)),
            image(U_REL in codes and len(codes) > 1),
            image(len(primitives) > 1),
            image(len(primitives) > 1),
        )

    def begin(self, windows: Sequence[Window]) -> None:
        """A new class beats what is there at any distance."""
        if self.closeness is not None:
            for window in windows:
                self.closeness[(..., *window.within(self.window))] = 0

    def paint(self, p: int, hit: Tensor, rays: _Rays, primitives: Primitives, seen: Homographies, rivals: bool) -> None:
        """Lay the p-th primitive over the rays that it wins; rivals: whether others of its class may be before it."""
        cut = (..., *rays.window.within(self.window))
        if self.closeness is not None and rivals:
            ends = (a.detach()[..., p, None, None] for a in (seen.far, seen.near))
            closeness = rays.times((seen.n[..., p, :] / seen.qn[..., p, None]).detach())
            closeness = closeness.maximum(next(ends)).minimum(next(ends))
            before = self.closeness[cut]
            hit = hit * _step(closeness * (1 + COPLANAR) - before)
            self.closeness[cut] = before.maximum(closeness.mul_(hit))
        value, weight = _setpoint(p, hit, rays, primitives, seen), primitives.weight[..., p, None, None]
        infinite, code = weight.isinf(), int(primitives.quantity[p])
        painted = (
            (self.value, value),
            (self.cover, 1.0),
            (self.finite, torch.where(infinite, 0.0, weight)),
            (self.forced, infinite.to(value)),
            (self.in_cd, float(code < U_ABS)),
            (self.relative, float(code == U_REL)),
            (self.winner, float(p)),
        )
        for image, new in painted:
            if image is not None:
                image[cut] = torch.lerp(image[cut], torch.as_tensor(new, dtype=hit.dtype, device=hit.device).expand_as(hit), hit)

    def setpoints(self, primitives: Primitives, masking: bool) -> Setpoints:
        quantities = tuple(sorted(set(primitives.quantity.tolist())))
        images = (self.finite, self.forced, masking, self.in_cd, self.relative, self.winner)
        return Setpoints(self.value, self.cover, self.window, quantities, *images)


def _setpoint(p: int, hit: Tensor, rays: _Rays, primitives: Primitives, seen: Homographies) -> Tensor:
    """Setpoint of the p-th primitive for the rays that hit it, elsewhere undefined but finite; broadcastable to `[..., rows, cols]`."""
    symbol, value = primitives.symbols[int(primitives.symbol_of[p])], primitives.value[..., p, None, None]
    homogeneous, illuminance = symbol.numel() == 1, int(primitives.quantity[p]) == E_V
    value = value * symbol if homogeneous else value
    if homogeneous and not illuminance:
        return value
    miss = 1 - hit
    n = rays.times(seen.n[..., p, :]) * hit + miss
    if not homogeneous:
        u, v = (rays.times(a[..., p, :]) * hit / n for a in (seen.u, seen.v))
        value = value * _symbol_value(symbol, u, v, bool(primitives.nearest[p]))
    if not illuminance:
        return value
    facing = rays.times(-seen.normal[..., p, :]) * hit + miss
    d = (1 + rays.y * rays.y + rays.z[:, None] ** 2).sqrt()
    x = seen.qn[..., p, None, None] / n
    return value * x * x * d**3 / facing


def _symbol_value(symbol: Tensor, u: Tensor, v: Tensor, nearest: bool) -> Tensor:
    """Symbol image `[h, w]` at coordinates -1..1 `[..., rows, cols]`, bilinear or nearest, texel centres at (2 k + 1) / n - 1."""
    shape = u.shape
    if not u.numel():
        return u  # out of sight
    u, v = u.reshape(-1, *shape[-2:]), v.reshape(-1, *shape[-2:])
    images = symbol.expand(len(u), 1, *symbol.shape)
    mode = "nearest" if nearest else "bilinear"
    return remap(images, u, v, mode, padding_mode="border", align_corners=False, normalized_coordinates=True).reshape(shape)
