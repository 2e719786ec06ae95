"""Zones: places controlled to a target luminance, independent of their reflectance (T 9.3, fig. 9.6).

The camera measures the luminance of a zone, and a PID sets the illuminance. The unknown reflectance is a factor between both quantities,
hence an offset between their logarithms, so the loop gain is the same on black cloth as on paint. The PID is incremental and its output is
limited to the lamps' range, so that it does not wind up.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, Self

import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.controllers.geometry import Place, facing
from luxloop.controllers.pid import PidGains, PidParams, PidState, pid_gains, pid_reset, pid_step
from luxloop.controllers.pixels.primitives import Primitives, names_module
from luxloop.controllers.situation import LAYERS, DrawingModules, Priority, Situation
from luxloop.world.frames import View, inverse, pose_from_degrees
from luxloop.world.params import Degrees, Metres, NotNegative, Params, Positive, Slope


def box_region(view: View, T_world_box: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Pixels whose centres see a box, `[height, width]` bool, ignoring occlusion.

    T_world_box: `[4, 4]`. low, high: `[3]` m, opposite corners in the box's frame; equal along one axis of a rectangle. A ray hits the box
    where it lies between all three pairs of planes at once (slab method).
    """
    T = inverse(T_world_box.to(view.T_world_view))
    eye = T[:3, :3] @ view.origin + T[:3, 3]
    rays = torch.einsum("ij,jhw->ihw", T[:3, :3], view.rays())
    rays = torch.where(rays == 0, torch.finfo(rays.dtype).tiny, rays)
    first, second = ((corner.to(eye) - eye)[:, None, None] / rays for corner in (low, high))
    enter, leave = torch.minimum(first, second).amax(0), torch.maximum(first, second).amin(0)
    return (enter <= leave) & (leave > 0)


DARKEST = 0.01  # of the target: least measured luminance, so that the logarithm stays finite
CLIPPED = 0.5  # share of saturated pixels above which the mean is only a lower bound of the zone's luminance
LIMIT_POINTS = 5  # along each side of a zone, at which the lamps' largest illuminance is computed


@dataclass(frozen=True)
class ZoneState:
    """State. pid: one loop `[1]` whose output is the natural logarithm of the illuminance in lx. luminance: last measured, in cd/m^2, or
    NaN.
    """

    pid: PidState
    luminance: float = math.nan

    @property
    def lx(self) -> float:
        """Commanded illuminance."""
        return math.exp(float(self.pid.output))


class ZoneParams(Params):
    """A place in the world, lit so that the camera measures the target luminance there."""

    kind: Literal["zone"] = "zone"
    centre_m: tuple[Metres, Metres, Metres] = Field(
        examples=[[20.0, 0.0, 0.0]], description="centre in the world (x forward, y left, z up)"
    )
    size_m: tuple[Metres, Metres, Metres] = Field(
        examples=[[4.0, 2.0, 0.0]], description="length, width and height of a box; a rectangle where one of them is 0"
    )
    roll_deg: Degrees = Field(0.0, description="rotation about its length axis, right side down positive")
    pitch_deg: Slope = Field(0.0, description="rotation about its width axis, nose down positive")
    yaw_deg: Degrees = Field(0.0, description="rotation about the upward axis, to the left positive")
    luminance_cd_m2: float = Field(gt=0, le=1e9, examples=[1.0], description="setpoint: mean luminance of the zone in the camera image")
    start_lx: Positive = Field(1.0, description="illuminance before the first measurement")
    pid: PidParams = Field(
        PidParams(kp=0.7, form="incremental", lower=-5.0, rate_limit=2.0),
        description="PID from the logarithm of luminance to the logarithm of illuminance; time is in steps",
    )
    weight: NotNegative = Field(20.0, description="weight against other light where a pixel lights more than the zone; the base beam has 1")
    priority: Priority = 0
    modules: DrawingModules = ()

    @model_validator(mode="after")
    def _box_or_rectangle(self) -> Self:
        if min(self.size_m) < 0 or sorted(self.size_m)[1] == 0:
            raise ValueError(f"size_m: {list(self.size_m)} is neither a box nor a rectangle; give three or two sides above zero")
        return self

    def start(self) -> ZoneState:
        return ZoneState(pid_reset(self._gains, torch.tensor([math.log(self.start_lx)], dtype=torch.float64)))

    def step(self, state: ZoneState, now: Situation) -> ZoneState:
        """The state after the last frame; unchanged while the zone is outside the image."""
        if now.seen is None or not bool((region := region_of(self, now.seen.view)).any()):
            return state
        values = now.seen.luminance[region.to(now.seen.luminance.device)].double()
        luminance = float(values.mean())
        error = math.log(self.luminance_cd_m2 / max(luminance, DARKEST * self.luminance_cd_m2))
        if float((values >= now.seen.saturation).double().mean()) > CLIPPED:
            error = min(error, 0.0)
        upper = torch.minimum(self._gains.upper, self._most_lx(now).clamp(min=1e-9).log())
        gains = replace(self._gains, upper=upper, lower=torch.minimum(self._gains.lower, upper))
        return ZoneState(pid_step(state.pid, state.pid.output.new_tensor([error]), 1.0, gains), luminance)

    def adapted(self, state: ZoneState, now: Situation) -> tuple[Primitives, ...]:
        """One rectangle: the zone itself, or for a box the upright rectangle through its centre that faces the lamps."""
        keys = {"weight": self.weight, "priority": self.priority * LAYERS, "modules": self.modules}
        return (self.place(now.lamps).light(state.lx, "E_v", **keys),)

    def base_share(self, state: ZoneState) -> None:
        """No demand on the base beam."""

    @property
    def box(self) -> tuple[Tensor, Tensor, Tensor]:
        """Pose `[4, 4]` of the zone in the world, and two opposite corners `[3]` m in its frame."""
        high = torch.tensor(self.size_m, dtype=torch.float64) / 2
        return pose_from_degrees(self.centre_m, self.roll_deg, self.pitch_deg, self.yaw_deg), -high, high

    def place(self, lamps: Tensor) -> Place:
        """The rectangle to light. lamps: positions `[L, 3]` m that the rectangle of a box faces."""
        T, low, high = self.box
        size, lamp = high - low, lamps.double().mean(0)
        if min(self.size_m) > 0:
            return facing(T, torch.stack([low, high]), lamp)
        flat = self.size_m.index(0)
        d1, d2 = (T[:3, k] * size[k] for k in range(3) if k != flat)
        towards = torch.where((lamp - T[:3, 3]) @ T[:3, flat] < 0, -1.0, 1.0)
        return Place(T[:3, 3] - (d1 + d2) / 2, d1, d2, towards * T[:3, flat])

    @property
    def _gains(self) -> PidGains:
        return pid_gains([self.pid], torch.float64)

    def _most_lx(self, now: Situation) -> Tensor:
        """The largest illuminance in lx that the lamps can give in the zone; infinite if the lamps are unknown."""
        lights = [light for name, light in now.lights if names_module(self.modules, name)]
        if not lights:
            return torch.tensor(math.inf, dtype=torch.float64)
        place = self.place(now.lamps)
        at = (torch.arange(LIMIT_POINTS, dtype=torch.float64) + 0.5) / LIMIT_POINTS
        u, v = torch.meshgrid(at, at, indexing="ij")
        points = place.origin[:, None] + place.d1[:, None] * u.flatten() + place.d2[:, None] * v.flatten()
        total = torch.zeros_like(points[0])
        for light in lights:
            away = light.T_world_headlight[:3, 3:].to(points) - points
            total += light.possible(points).to(points) * (place.normal @ away / away.norm(dim=0)).clamp(min=0)
        return total.amax()


@lru_cache(maxsize=32)
def region_of(zone: ZoneParams, view: View) -> Tensor:
    """Mask `[height, width]` bool of the pixels that see a zone; cached, since camera and zone are fixed."""
    return box_region(view, *zone.box)
