"""Primitives: rectangles in the world that carry a symbol image and a setpoint (T 7.1, 7.2.1)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from torch import Tensor

from world.errors import LuxloopError
from world.frames import rotation

Quantity = Literal["I_v", "E_v", "u_abs", "u_rel"]


@dataclass(frozen=True)
class Primitives:
    """P rectangles per scene, batch dimensions first.

    origin: `[..., P, 3]` m, the corner where symbol coordinates are (0, 0). d1, d2: `[..., P, 3]` m, the edges along symbol u and v.
    normal: `[..., P, 3]`, unit, towards the side that takes light. symbols: `[P, h, w]` in 0..1, image row 0 at v = 0.
    value: `[..., P]`, setpoint at symbol value 1 in cd, lx or as a share, by `quantity`.
    """

    origin: Tensor
    d1: Tensor
    d2: Tensor
    normal: Tensor
    symbols: Tensor
    value: Tensor
    quantity: Quantity = "u_abs"

    def corners(self) -> Tensor:
        """The four corners, `[..., P, 4, 3]` m."""
        return torch.stack([self.origin, self.origin + self.d1, self.origin + self.d2, self.origin + self.d1 + self.d2], -2)


def road_symbol(pose: Tensor, z_m: float, width_m: float, length_m: float, symbol: Tensor, value: float, quantity: Quantity) -> Primitives:
    """The thesis' four degrees of freedom (T 9.4.2): one symbol near the road, read by the driver, far end = image row 0.

    pose: `[..., 4]` = x, y in m of the centre, roll, pitch in rad, `R = Ry(pitch) Rx(roll)`; z and size stay fixed, yaw is zero.
    symbol: `[h, w]` in 0..1. Returns Primitives with P = 1.
    """
    R = rotation(pose[..., 2], pose[..., 3], torch.zeros_like(pose[..., 3]))
    centre = torch.cat([pose[..., :2], torch.full_like(pose[..., :1], z_m)], -1)
    forward, left, up = R.unbind(-1)
    d1, d2 = -width_m * left, -length_m * forward
    origin = centre - (d1 + d2) / 2
    values = torch.full_like(pose[..., :1], value)
    return Primitives(origin[..., None, :], d1[..., None, :], d2[..., None, :], up[..., None, :], symbol[None].to(pose), values, quantity)


def load_symbol(path: Path) -> Tensor:
    """Grey image `[h, w]` float32 in 0..1 from a picture; transparent parts are dark. Raises LuxloopError for what is no picture."""
    if not path.is_file():
        raise LuxloopError(f"symbol image {path} does not exist: give the path of a PNG or the name of a shipped symbol")
    image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED) if path.stat().st_size else None
    if image is None or image.dtype.kind != "u":
        raise LuxloopError(f"symbol image {path} cannot be read as a picture of 8 or 16 bits: save it as an 8-bit PNG")
    grey = image.astype(np.float32) / (2 ** (8 * image.itemsize) - 1)
    if grey.ndim == 3:
        alpha = grey[..., 3] if grey.shape[2] == 4 else 1.0
        grey = cv2.cvtColor(grey[..., :3], cv2.COLOR_BGR2GRAY) * alpha
    if not grey.any():
        raise LuxloopError(f"symbol image {path} is all black: draw the symbol in white, since white is light")
    return torch.from_numpy(np.ascontiguousarray(grey))
