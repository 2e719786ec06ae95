"""Light sources that face the camera: their image, and the veiling luminance of light scattered in the lens."""

import math
from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor

from luxloop.world.frames import View
from luxloop.world.params import Metres, Params

# Disability glare (Stiles & Holladay, CIE 31-1976): 10 cd/m^2 of veil at 1 deg from a source of 1 lx at the eye
EYE_DEG2 = 10.0
BLOOM_DEG = 0.1  # inside this angle the veil is constant, since the formula diverges

Speed = Annotated[float, Field(ge=-200, le=200)]


class OncomingParams(Params):
    """One oncoming headlamp as a source that faces the camera; it lights nothing, and nothing occludes it."""

    position_m: tuple[Metres, Metres, Metres] = Field(
        examples=[[40.0, 3.0, 0.7]], description="position in the world at the scenario's start"
    )
    velocity_m_s: tuple[Speed, Speed, Speed] = Field((0.0, 0.0, 0.0), description="velocity")
    intensity_cd: float = Field(500.0, gt=0, le=500_000, description="luminous intensity towards the camera")
    diameter_m: float = Field(0.15, gt=0, le=1, description="diameter of the luminous surface")
    veil: float = Field(
        0.1,
        ge=0,
        le=10,
        description="stray light of the lens, as a multiple of the eye's (disability glare); 0.1 is about 1 % of the light",
    )

    def position_at(self, t_s: float) -> Tensor:
        """Position `[3]` m in the world at a time."""
        start, velocity = (torch.tensor(each, dtype=torch.float64) for each in (self.position_m, self.velocity_m_s))
        return start + t_s * velocity


def glare(view: View, position: Tensor, lamp: OncomingParams, device: torch.device | str = "cpu") -> Tensor:
    """Luminance `[height, width]` in cd/m^2, float32, that a lamp at a position `[3]` m in the world adds to a view's image.

    Its image is a Gaussian as wide as lamp and pixel together and integrates to the illuminance E = I / r^2; the veil is `veil * 10 E /
    theta^2` with theta in deg, at least 0.1. Zero if the lamp is behind the camera.
    """
    at = view.T_world_view[:3, :3].T @ (position - view.origin)
    distance = float(at.norm())
    x, y, z = (at / distance).tolist()
    if z <= 0:
        return torch.zeros(view.height, view.width, device=device)
    u = (torch.arange(view.width, device=device) + 0.5 - view.cx) / view.fx
    v = ((torch.arange(view.height, device=device) + 0.5 - view.cy) / view.fy)[:, None]
    shorter = (u * u + v * v + 1).rsqrt()
    chord2 = (u * shorter - x).square() + (v * shorter - y).square() + (shorter - z).square()
    theta2 = (2 * (chord2.sqrt() / 2).clamp(max=1).asin()).square()
    illuminance = lamp.intensity_cd / distance**2
    width2 = (lamp.diameter_m / distance / 4) ** 2 + 1 / (view.fx * view.fy)
    image = (theta2 / (-2 * width2)).exp_().mul_(illuminance / (2 * math.pi * width2))
    veil = lamp.veil * EYE_DEG2 * illuminance * math.radians(1) ** 2
    return image.add_(theta2.clamp_(min=math.radians(BLOOM_DEG) ** 2).reciprocal_(), alpha=veil)
