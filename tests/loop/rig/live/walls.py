"""A lamp of 12 x 24 pixels before a wall, a camera that sees its light, and the calibration that says truly where all is."""

from dataclasses import replace

import numpy as np
import torch

from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.calibrate import SCREEN, Calibration
from luxloop.loop.rig.calibration.geometry import CameraModel, Pose
from luxloop.loop.rig.calibration.shots import linear_response
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import CameraParams, camera_view, saturation_luminance
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised

SCREEN_M, ALBEDO = 5.95, 0.8
LAMP = idealised(12, 24, (4, 2), 3.5, 1.8, -1.8)
CAMERA = {
    **{"x_m": -0.3, "y_m": 0.25, "z_m": 1.0, "pitch_deg": 3.0, "yaw_deg": -1.0},
    **{"width_px": 160, "height_px": 120, "hfov_deg": 12.0, "bits": 12},
    **{"exposure_s": 0.004, "sensitivity_e_per_cd_s_m2": 5e3, "saturation_e": 10_000.0},
}


def wall(ambient_lx: float = 0.0, **camera: float) -> Scenario:
    """Its lamp is to be given as a module."""
    screen = {"kind": "box", "name": "screen", "albedo": ALBEDO, "size_m": [0.1, 6.0, 4.0], "track": [{"position_m": [6.0, 0.0, -1.0]}]}
    return validate(
        {
            **{"name": "wall", "steps": 2, "renderer": "raycast", "surface": {"grain": 0.0}, "objects": [screen]},
            **{"light": {"ambient_lx": ambient_lx}, "camera": {**CAMERA, **camera}, "headlight": {"lamps": ["left"], "distance_m": 0.0}},
        },
        "wall",
    )


def module(light: Headlight = LAMP) -> LampModule:
    """At the height at which the scenario has it."""
    T_body_headlight = torch.eye(4, dtype=torch.float64)
    T_body_headlight[2, 3] = 0.75
    return LampModule("left matrix", light, T_body_headlight)


def calibration(camera: CameraParams, lamp: LampModule, model: CameraModel | None = None, screen_m: float = SCREEN_M) -> Calibration:
    """model: the camera's, by default the pinhole of the scenario's camera."""
    T_camera_world = np.linalg.inv(camera_view(camera).T_world_view.numpy())
    T_world_screen = np.eye(4)
    T_world_screen[:3, :3], T_world_screen[:3, 3] = SCREEN, (screen_m, 0.0, 0.0)
    levels = 2**camera.bits - 1
    response = linear_response(levels) ** np.float32(camera.gamma)
    poses = {lamp.name: Pose.of(T_camera_world @ lamp.T_body_headlight.numpy())}
    known = Calibration(model or CameraModel.of(camera), response, np.zeros(3), Pose.of(T_camera_world @ T_world_screen), poses, {})
    return replace(known, lux=float(np.pi * saturation_luminance(camera) / ALBEDO))


def blob(rows: int = 12, cols: int = 24) -> Array:
    """Utilisations `[rows * cols]` of a smooth beam."""
    r, c = np.indices((rows, cols))
    return np.exp(-(((r - 0.55 * rows) / (0.4 * rows)) ** 2) - ((c - 0.5 * cols) / (0.3 * cols)) ** 2).ravel().astype(np.float32)


def off_by(texture: torch.Tensor, light: Headlight, u: Array) -> float:
    """Root mean square of a texture's difference from the true one, over lit texels, as a share of their light."""
    true = light.light_texture(torch.from_numpy(u.astype(np.float32)))
    lit = true > 0.02 * true.max()
    return float((texture - true)[lit].square().mean().sqrt() / true[lit].square().mean().sqrt())
