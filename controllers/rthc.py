"""Ray tracing headlight control (T 7.3): from primitives to a setpoint for every ray of a light texture.

All rays of a module share their origin, so the ray-plane system (7.3.3) is one 3 x 3 homography a primitive: with q from the lamp to the
primitive's centre, n = d1 x d2 and the unnormalised ray d = [1, y, z], u = d.(d2 x q) / d.n, v = d.(q x d1) / d.n, x = q.n / d.n. Counted
from the centre, u and v run from -1/2 to 1/2; twice that, from -1 to 1, is what image sampling takes. Turned so that q.n > 0, a ray hits
where |u d.n| <= d.n and |v d.n| <= d.n. Each term is affine in the texel's row and column, so no rays are stored.

Primitives are painted one after the other, so that the last that may cover a ray is the one that wins it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from kornia.geometry.transform import remap
from torch import Tensor

from controllers.primitives import E_V, Primitives
from controllers.windows import NEAREST_M, SLACK, Window, union, whole
from world.texels import TexelGrid

COPLANAR = 1e-4  # of the distance: what lies closer together counts as one plane, whatever the dtype rounds
PARALLEL = 1e-6  # of the cosine: a given normal that is that of the edges


@dataclass(frozen=True)
class Setpoints:
    """Ray setpoints on a window of the light texture.

    value: `[..., rows, cols]`, in cd (I_v, E_v) or as a share (u_abs, u_rel). hit: `[..., rows, cols]` bool; elsewhere the default counts
    with weight 1. weight: `[..., rows, cols]`, 0 to infinity, None where all are 1. quantity: `[..., rows, cols]` uint8, None where all are
    `quantities[0]`. quantities: codes that may occur. winner: `[..., rows, cols]` int16, the primitive that was hit, undefined elsewhere.
    """

    value: Tensor
    hit: Tensor
    window: Window
    quantities: tuple[int, ...]
    weight: Tensor | None = None
    quantity: Tensor | None = None
    winner: Tensor | None = None


@dataclass(frozen=True)
class Homographies:
    """Primitives as a headlight sees them: `[..., P, 3]`, to be multiplied with rays [1, y, z], and `[..., P]`.

    n, u, v: d.n and twice u d.n and v d.n, turned so that `qn`, q.n, is positive. normal: as given. mask: a zero setpoint of infinite
    weight. widen_u, widen_v, widen_n: by how much u, v and the cosine change over one texel. near, far: 1/x of the nearest and the
    farthest corner. low, high: `[..., P, 2]`, projected outline in rows and columns, infinite where it reaches behind the lamp.
    """

    n: Tensor
    u: Tensor
    v: Tensor
    normal: Tensor
    qn: Tensor
    mask: Tensor
    widen_u: Tensor
    widen_v: Tensor
    widen_n: Tensor
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

    def change(a: Tensor) -> Tensor:
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
        (primitives.value == 0) & primitives.weight.isinf(),
        change(u) + change(n),
        change(v) + change(n),
        change(normal),
        1 / x.amin(-1),
        1 / x.amax(-1),
        at.amin(-2).masked_fill(behind, -torch.inf),
        at.amax(-2).masked_fill(behind, torch.inf),
    )


def paint_order(primitives: Primitives) -> list[tuple[int, bool]]:
    """Primitives as they are painted, and whether each one begins a class that beats all before it, at any distance.

    Forced hits come after the others, by priority; within a class the nearer one wins, coplanar ones by priority and then as listed.
    """
    keys = [(forced, priority) for forced, priority in zip(primitives.forced.tolist(), primitives.priority.tolist(), strict=True)]
    order = sorted(range(len(keys)), key=keys.__getitem__)
    classes = [keys[p] if keys[p][0] else None for p in order]
    return [(p, k > 0 and classes[k] != classes[k - 1]) for k, p in enumerate(order)]


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
    windows = [whole(grid)] * len(primitives) if windows is None else windows
    window = union(list(windows))
    seen = homographies(primitives, grid, T_world_headlight)
    codes = primitives.quantity.tolist()
    weighted = bool((primitives.weight != 1).any()) if primitives.weight.device.type == "cpu" else True
    canvas = _Canvas.blank(primitives, window, weighted, len(set(codes)) > 1)
    front = _from_the_front(seen) if single else [None] * len(primitives)
    is_mask = masks(primitives) if single else [None] * len(primitives)
    y, z = grid.tangents(primitives.origin.dtype, primitives.origin.device)
    for p, beats in paint_order(primitives):
        if windows[p].empty or front[p] is False:
            continue
        rays = _Rays(y[windows[p].slices[1]], z[windows[p].slices[0]], windows[p])
        canvas.paint(p, _hit(rays, seen, p, is_mask[p], front[p]), rays, primitives, seen, beats)
    return canvas.setpoints(window, tuple(sorted(set(codes))))


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

    It has where a given normal is not that of the edges.
    """
    toward = -(seen.normal * seen.n).sum(-1) / seen.n.norm(dim=-1)
    return [cosine > 0 if abs(abs(cosine) - 1) < PARALLEL else None for cosine in toward.tolist()]


def _hit(rays: _Rays, seen: Homographies, p: int, mask: bool | None, front: bool | None) -> Tensor:
    """Which rays hit the p-th primitive, `[..., rows, cols]`; mask, front: whether it is one and is seen so, where the host knows."""
    n = rays.times(seen.n[..., p, :]).detach()
    u, v = (rays.times(a[..., p, :]).detach().abs_() for a in (seen.u, seen.v))
    if mask is False:
        hit = (torch.maximum(u, v, out=u) <= n) & (n > 0)
        return hit if front else hit & (rays.times(-seen.normal[..., p, :]) > 0)
    wide = seen.mask[..., p]

    def only_masks(a: Tensor) -> Tensor:
        return torch.where(wide, a[..., p], 0.0)[..., None, None]

    hit = (u - n <= only_masks(seen.widen_u)) & (v - n <= only_masks(seen.widen_v)) & ((n > 0) | wide[..., None, None])
    if not front:
        hit &= rays.times(-seen.normal[..., p, :]) + only_masks(seen.widen_n) > 0
    return hit & _near_outline(rays, seen.low[..., p, :], seen.high[..., p, :])


def _near_outline(rays: _Rays, low: Tensor, high: Tensor) -> Tensor:
    """Texels at most one beyond the rectangle around an outline: where its corners are acute, widening alone would reach too far."""
    within = []
    for axis, (start, stop) in enumerate((rays.window.slices[0].indices(1 << 30)[:2], rays.window.slices[1].indices(1 << 30)[:2])):
        centre = torch.arange(start, stop, dtype=low.dtype, device=low.device) + 0.5
        within.append((centre >= low[..., axis, None] - 1 - SLACK) & (centre <= high[..., axis, None] + 1 + SLACK))
    return within[0][..., :, None] & within[1][..., None, :]


@dataclass
class _Canvas:
    """What the rays of the window carry so far; closeness: 1/x of the nearest hit of the class that is being painted."""

    value: Tensor
    hit: Tensor
    winner: Tensor
    weight: Tensor | None
    quantity: Tensor | None
    closeness: Tensor | None
    window: Window

    @classmethod
    def blank(cls, primitives: Primitives, window: Window, weighted: bool, mixed: bool) -> "_Canvas":
        size = (window.row_stop - window.row_start, window.col_stop - window.col_start)
        zero = primitives.origin.new_zeros(*primitives.origin.shape[:-2], *size)
        return cls(
            zero,
            torch.zeros_like(zero, dtype=torch.bool),
            torch.zeros_like(zero, dtype=torch.int16),
            torch.ones_like(zero) if weighted else None,
            torch.zeros_like(zero, dtype=torch.uint8) if mixed else None,
            torch.zeros_like(zero) if len(primitives) > 1 else None,
            window,
        )

    def paint(self, p: int, hit: Tensor, rays: _Rays, primitives: Primitives, seen: Homographies, beats: bool) -> None:
        """Lay the p-th primitive over the rays that it wins."""
        cut = (..., *rays.window.within(self.window))
        if self.closeness is not None:
            if beats:
                self.closeness.zero_()
            ends = (a.detach()[..., p, None, None] for a in (seen.far, seen.near))
            closeness = rays.times((seen.n[..., p, :] / seen.qn[..., p, None]).detach()).nan_to_num_().clamp(*ends)
            before = self.closeness[cut]
            hit = hit & (closeness * (1 + COPLANAR) >= before)
            self.closeness[cut] = torch.where(hit, torch.maximum(before, closeness), before)
        value = _setpoint(p, hit, rays, primitives, seen)
        self.value[cut] = torch.where(hit, value, self.value[cut])
        self.hit[cut] |= hit
        if self.weight is not None:
            self.weight[cut] = torch.where(hit, primitives.weight[..., p, None, None], self.weight[cut])
        if self.quantity is not None:
            self.quantity[cut].masked_fill_(hit, int(primitives.quantity[p]))
        if self.closeness is not None:
            self.winner[cut].masked_fill_(hit, p)

    def setpoints(self, window: Window, quantities: tuple[int, ...]) -> Setpoints:
        return Setpoints(self.value, self.hit, window, quantities, self.weight, self.quantity, self.winner)


def _setpoint(p: int, hit: Tensor, rays: _Rays, primitives: Primitives, seen: Homographies) -> Tensor:
    """Setpoint of the p-th primitive for the rays that hit it, elsewhere undefined but finite; broadcastable to `[..., rows, cols]`."""
    symbol, value = primitives.symbols[int(primitives.symbol_of[p])], primitives.value[..., p, None, None]
    homogeneous, illuminance = symbol.numel() == 1, int(primitives.quantity[p]) == E_V
    value = value * symbol if homogeneous else value
    if homogeneous and not illuminance:
        return value
    n = rays.times(seen.n[..., p, :]).masked_fill(~hit, 1.0)
    if not homogeneous:
        u, v = (rays.times(a[..., p, :]).masked_fill(~hit, 0.0) / n for a in (seen.u, seen.v))
        value = value * _symbol_value(symbol, u, v, bool(primitives.nearest[p]))
    if not illuminance:
        return value
    facing = rays.times(-seen.normal[..., p, :]).masked_fill(~hit, 1.0)
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
