"""True camera and lamps of a disturbed scenario. The controller uses the undisturbed ones."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from luxloop.loop.scenario.disturbances import AimParams, WearParams
from luxloop.loop.scenario.model import Scenario
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import ModuleCommand
from luxloop.world.light.illumination import LastTextures, TextureSource
from luxloop.world.light.soiling import SoilingParams


@dataclass(frozen=True, eq=False)
class LampModule:
    """A shining module. T_body_headlight: `[4, 4]`, pose at rest on the body.

    measured: source of measured light textures, None for the headlight's matrix.
    """

    name: str
    headlight: Headlight
    T_body_headlight: Tensor
    measured: TextureSource | None = None

    def turned(self, command: ModuleCommand) -> Tensor:
        """Pose `[4, 4]` float64 on the CPU of the module that a command turns, on the body."""
        return command.turn(self.T_body_headlight).double().cpu()

    @cached_property
    def textures(self) -> TextureSource:
        """Source of its light textures."""
        return self.measured or LastTextures(self.headlight)


def true_camera(scenario: Scenario) -> CameraParams:
    """The camera with its calibration error."""
    camera, error = scenario.camera, scenario.disturbances.calibration
    half = math.tan(math.radians(camera.hfov_deg) / 2) / (1 + error.focal_percent / 100)
    moved = {name: getattr(camera, name) + value for name, value in error if name != "focal_percent" and value}
    if error.focal_percent:
        moved["hfov_deg"] = math.degrees(2 * math.atan(half))
    return camera.model_copy(update=moved)


def true_modules(modules: Iterable[LampModule], aim: Iterable[AimParams], wear: WearParams, cover: SoilingParams) -> tuple[LampModule, ...]:
    """Modules with dead and aged pixels and aiming errors, behind soiled covers.

    Raises LuxloopError for an unknown pixel, or an aim that puts a module below the road.
    """
    true = []
    for number, module in enumerate(modules):
        errors = [each for each in aim if each.lamp is None or module.name.startswith(f"{each.lamp} ")]
        headlight = cover.cover(wear_out(module.headlight, module.name, wear, number), int(module.name.startswith("right ")))
        true.append(replace(module, headlight=headlight, T_body_headlight=misaim(module.T_body_headlight, errors)))
    return tuple(true)


def misaim(T_body_headlight: Tensor, errors: Iterable[AimParams]) -> Tensor:
    """A pose `[4, 4]` moved and rotated by aiming errors, about its origin and the vehicle's axes. Raises LuxloopError below the road."""
    T = T_body_headlight.clone()
    for aim in errors:
        if aim.z_m and T[2, 3] > 0 >= T[2, 3] + aim.z_m:
            raise LuxloopError(f"disturbances.aim.z_m: the lamp is at {float(T[2, 3]) + aim.z_m:.3g} m, not above the road; lower it less")
        error = pose_from_degrees((aim.x_m, aim.y_m, aim.z_m), aim.roll_deg, aim.pitch_deg, aim.yaw_deg).to(T)
        T[:3, :3] = error[:3, :3] @ T[:3, :3]
        T[:3, 3] += error[:3, 3]
    return T


def wear_out(headlight: Headlight, name: str, wear: WearParams, number: int) -> Headlight:
    """A module's headlight with dead and aged pixels. Raises LuxloopError for an unknown pixel."""
    n = headlight.n_pixels
    if wrong := [pixel for pixel in wear.dead_pixels if not 0 <= pixel < n]:
        raise LuxloopError(f"disturbances.wear.dead_pixels: {name} has no pixel {wrong[0]}; give numbers from 0 to {n - 1}")
    if not (wear.dead or wear.aged or wear.dead_pixels):
        return headlight
    order = np.random.default_rng(np.random.SeedSequence(wear.seed, spawn_key=(number,))).permutation(n)
    dead = round(wear.dead * n)
    left = np.ones(n, np.float32)
    left[order[dead : dead + round(wear.aged * n)]] = wear.aged_factor
    left[[*order[:dead], *wear.dead_pixels]] = 0
    return headlight.dim(torch.from_numpy(left))
