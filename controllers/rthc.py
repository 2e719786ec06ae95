"""Ray tracing headlight control (T 7.3): from primitives to a setpoint for every ray of a light texture.

All rays of a module share their origin, so the ray-plane system (7.3.3) is one 3 x 3 homography a primitive: with q from the lamp to the
primitive's centre, n = d1 x d2 and the unnormalised ray d = [1, y, z], u = d.(d2 x q) / d.n, v = d.(q x d1) / d.n, l = q.n / d.n. Counted
from the centre, u and v run from -1/2 to 1/2; twice that, from -1 to 1, is what image sampling takes.
"""

import math
from dataclasses import dataclass

import torch
from kornia.geometry.transform import remap
from torch import Tensor

from controllers.primitives import E_V, Primitives
from world.headlight import Headlight

COPLANAR = 1e-4  # of the distance: what lies closer together counts as one plane, whatever the dtype rounds


@dataclass(frozen=True)
class Window:
    """A rectangle of the light texture, texels; stop is exclusive."""

    row_start: int
    row_stop: int
    col_start: int
    col_stop: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Row and column slices of a light texture."""
        return slice(self.row_start, self.row_stop), slice(self.col_start, self.col_stop)


@dataclass(frozen=True)
class Setpoints:
    """Ray setpoints on a window of the light texture.

    value: `[..., rows, cols]`, in cd (I_v, E_v) or as a share (u_abs, u_rel). hit: `[..., rows, cols]` bool; elsewhere the default counts.
    """

    value: Tensor
    hit: Tensor
    window: Window


def whole(headlight: Headlight) -> Window:
    """The whole light texture as a window."""
    return Window(0, headlight.rows, 0, headlight.cols)


def projected_window(primitives: Primitives, headlight: Headlight, T_world_headlight: Tensor) -> Window:
    """The texels that a single scene's primitives can touch, by their projected corners; the whole texture if one lies behind the lamp.

    The host learns the rectangle, so on an accelerator this waits for the device.
    """
    corners = primitives.corners().reshape(-1, 3).T
    T = T_world_headlight.to(corners)
    x, y, z = T[:3, :3].T @ (corners - T[:3, 3:])
    if bool((x <= 0).any()):
        return whole(headlight)
    row, col = headlight.texel_of(y / x, z / x)
    low, high = torch.stack([row, col]).aminmax(dim=1)
    ends = (*low.floor().tolist(), *high.ceil().tolist())
    clip = [min(max(int(v), 0), n) for v, n in zip(ends, (headlight.rows, headlight.cols) * 2, strict=True)]
    return Window(clip[0], max(clip[2], clip[0]), clip[1], max(clip[3], clip[1]))


def trace(primitives: Primitives, headlight: Headlight, T_world_headlight: Tensor, window: Window | None = None) -> Setpoints:
    """Cast a ray through every texel centre of the window (default: all) and take the setpoint of the nearest primitive hit.

    primitives: batch `[..., P]`. T_world_headlight: `[4, 4]`. Back faces are not hit; of coplanar primitives the last in the list wins;
    E_v becomes `E d^2 / cos` (T 7.2.1). Differentiable in the primitives (not across their edges).
    """
    window = window or whole(headlight)
    y, z = headlight.tangents(primitives.origin.dtype, primitives.origin.device)
    y, z = y[window.slices[1]], z[window.slices[0]]
    R_t = T_world_headlight[:3, :3].T.to(primitives.origin)
    position = T_world_headlight[:3, 3].to(primitives.origin)
    centre = primitives.origin + (primitives.d1 + primitives.d2) / 2
    q, d1, d2, normal = (v @ R_t.T for v in (centre - position, primitives.d1, primitives.d2, primitives.normal))
    n = torch.linalg.cross(d1, d2)

    def along_rays(a: Tensor) -> Tensor:
        a = a[..., None, None, :]
        return a[..., 0] + a[..., 1] * y + a[..., 2] * z[:, None]

    dn = along_rays(n)
    if dn.requires_grad:  # a ray along the plane is a miss either way, but its gradient would be NaN
        dn = dn.masked_fill(dn == 0, math.inf)
    u = along_rays(2 * torch.linalg.cross(d2, q)) / dn
    v = along_rays(2 * torch.linalg.cross(q, d1)) / dn
    length = (q * n).sum(-1)[..., None, None] / dn
    facing = along_rays(-normal)
    hit = (torch.maximum(u.abs(), v.abs()) <= 1) & (torch.minimum(length, facing) > 0)
    seen = [_symbol_value(primitives.symbols[k], u[..., p, :, :], v[..., p, :, :]) for p, k in enumerate(primitives.symbol_of.tolist())]
    value = torch.stack(seen, -3) * primitives.value[..., None, None]
    illuminance = primitives.quantity == E_V
    if illuminance.any():
        d = (1 + y * y + z[:, None] ** 2).sqrt()
        intensity = value * length**2 * d**3 / torch.where(hit, facing, 1.0)
        value = torch.where(illuminance.to(value.device)[:, None, None], intensity, value)
    value = torch.where(hit, value, 0.0)
    if value.shape[-3] == 1:
        return Setpoints(value[..., 0, :, :], hit[..., 0, :, :], window)
    return Setpoints(value.gather(-3, _nearest(hit, length))[..., 0, :, :], hit.any(-3), window)


def _nearest(hit: Tensor, length: Tensor) -> Tensor:
    """Index of the nearest primitive hit, the last of several in one plane (painter's order): `[..., 1, rows, cols]` int64."""
    distance = torch.where(hit, length, math.inf)
    order = torch.arange(hit.shape[-3], device=hit.device)[:, None, None]
    in_front = distance <= distance.amin(-3, keepdim=True) * (1 + COPLANAR)
    return torch.where(in_front, order, -1).amax(-3, keepdim=True)


def _symbol_value(symbol: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Symbol image `[h, w]` at coordinates -1..1 `[..., rows, cols]`, bilinear, texel centres at (2 k + 1) / n - 1."""
    shape = u.shape
    if not u.numel():
        return u  # out of sight
    u, v = u.reshape(-1, *shape[-2:]), v.reshape(-1, *shape[-2:])
    images = symbol.expand(len(u), 1, *symbol.shape)
    return remap(images, u, v, padding_mode="border", align_corners=False, normalized_coordinates=True).reshape(shape)
