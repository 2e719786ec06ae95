"""A small rig_scene on a flat road, and how to make others. Its renderer is at home in all threads."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.simulated.faults import FaultParams, read
from luxloop.loop.rig.simulated.scene import RigScene
from luxloop.loop.rig.wire.ddp import LightFrame
from luxloop.loop.scenario.model import Scenario, load

SIZE = ("camera.width_px=160", "camera.height_px=120", "camera.oversampling=1", "camera.hfov_deg=40")
KEYS = ("renderer=raycast", "headlight.model=ssl-hd-lores", *SIZE)
DARK = ("light.ambient_lx=0", "camera.noise=false")


def scenario_of(*keys: str) -> Scenario:
    return load("flat", [*KEYS, *keys])


def faults_of(*keys: str) -> FaultParams:
    return read(None, [f"faults.{key}" for key in keys])


def light(codes: np.ndarray, *timecodes: int) -> LightFrame:
    return LightFrame(codes, timecodes or (0,))


def seen_px(rig_scene: RigScene, y: np.ndarray, z: np.ndarray, wall_m: float) -> np.ndarray:
    """Where OpenCV has a light `[n, 2]` px whose tangents are y and z `[n]`, on a wall at an x; pixel centres at integer + 0.5."""
    T, T_view = rig_scene.modules[0].T_body_headlight.double().numpy(), rig_scene.world.view.T_world_view.numpy()
    rays = np.stack([np.ones_like(y), y, z], 1) @ T[:3, :3].T
    on_wall = T[:3, 3] + rays * ((wall_m - T[0, 3]) / rays[:, :1])
    in_camera, lens = (on_wall - T_view[:3, 3]) @ T_view[:3, :3], rig_scene.lens
    return cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), lens.matrix, lens.params.k)[0][:, 0]


@pytest.fixture(scope="session")
def rig_scene() -> RigScene:
    return RigScene(scenario_of(), faults_of())


@pytest.fixture(scope="session")
def pattern(rig_scene: RigScene) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, rig_scene.pixels, np.uint8)


@pytest.fixture
def image_with(rig_scene: RigScene, pattern: np.ndarray) -> Callable[..., np.ndarray]:
    """What the lens sees of the pattern on a rig_scene with faults."""
    return lambda *keys: RigScene(scenario_of(), faults_of(*keys)).light(light(pattern), 0.0)
