"""A rig whose every value is known, with effects that its calibration does not model."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.sparse as sp

from luxloop import Scenario, validate
from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.geometry import CameraModel, Geometry, Pose
from luxloop.loop.rig.calibration.intrinsics import Corners, lens
from luxloop.loop.rig.calibration.setups import SimulatedSetup, simulated_setup
from luxloop.loop.rig.calibration.shapes import neighbours
from luxloop.loop.rig.simulated.faults import LensParams
from luxloop.loop.rig.simulated.lens import Lens, distort, undistort
from luxloop.loop.simulation.lamps import lamp_modules, mount
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import camera_view
from luxloop.world.headlight import Headlight

SCREEN_M = 5.95  # of the screen before the lamp
ALBEDO = 0.8
SHEEN, SHEEN_DEG = 0.15, 12.0  # of the screen that is not Lambertian: brighter near the mirror direction
BROWN, DIVISION = (-0.12, 0.05), (-0.1,)  # over half of the picture's width
CORNER_PX = 0.03  # standard deviation of corners that are found
WALL = {
    "name": "wall",
    "steps": 1,
    "renderer": "raycast",
    "headlight": {"lamps": ["left"], "distance_m": 0.0},
    "surface": {"grain": 0.0},
    "camera": {
        **{"x_m": -0.3, "y_m": 0.25, "z_m": 1.0, "pitch_deg": 3.0, "yaw_deg": -2.0, "exposure_s": 0.004},
        **{"sensitivity_e_per_cd_s_m2": 5e3, "saturation_e": 10_000.0},
    },
    "objects": [
        {
            "kind": "box",
            "name": "screen",
            "albedo": ALBEDO,
            "size_m": [0.1, 6.0, 4.0],
            "track": [{"position_m": [SCREEN_M + 0.05, 0.0, -1.0]}],
        }
    ],
}


@dataclass(frozen=True, eq=False)
class Rig:
    """params: of the lens, whose pinhole is `truth.camera`. known: as a board shows it, with a lamp that is a few cm off."""

    bench: SimulatedSetup
    light: Headlight
    truth: Geometry
    known: Geometry
    params: LensParams


def pinhole_px(camera: CameraModel, params: LensParams, u: Array, v: Array) -> tuple[Array, Array]:
    """From the lens' image to that of its pinhole."""
    focal, centre = camera.matrix[0, 0], np.array([camera.width, camera.height]) / 2
    straight = undistort(params, (np.stack([u.ravel(), v.ravel()], 1) - centre) / focal, focal) * focal + centre
    return straight[:, 0].reshape(u.shape), straight[:, 1].reshape(v.shape)


def lens_px(camera: CameraModel, params: LensParams, at: Array) -> Array:
    """Where the lens shows points of its pinhole's image, `[n, 2]` px."""
    focal, centre = camera.matrix[0, 0], np.array([camera.width, camera.height]) / 2
    return np.asarray(distort(params, (at - centre) / focal) * focal + centre)


SAMPLES = 4  # samples of the fine picture along each side of a camera pixel


@dataclass(frozen=True, eq=False, kw_only=True)
class OpticalSetup(SimulatedSetup):
    """A setup with an effect of the lens on the luminance image, such as blur."""

    optics: Callable[[Array], Array]

    def luminance(self, lights: list[Array]) -> Array:
        return self.optics(super().luminance(lights))


def lens_setup(
    scenario: Scenario, module: LampModule, lens: Callable[[Array, Array], tuple[Array, Array]], fine: int = 2
) -> SimulatedSetup:
    """The setup of a scenario behind a lens.

    lens: from positions `[n]` px (u, v) in the camera picture to those in a pinhole picture of the same size. fine: rendered pixels
    along a side of a camera pixel.
    """
    camera = scenario.camera
    width, height = fine * camera.width_px, fine * camera.height_px
    finer = camera.model_copy(update={"width_px": width, "height_px": height})
    setup = simulated_setup(scenario.model_copy(update={"camera": finer}), [module])
    v, u = (each.ravel() for each in np.indices((camera.height_px, camera.width_px)))
    resample = sp.csr_matrix((v.size, width * height), dtype=np.float32)
    for dv, du in itertools.product((np.arange(SAMPLES) + 0.5) / SAMPLES, repeat=2):
        x, y = lens(u + du, v + dv)
        for col, row, weight, inside in neighbours(fine * x - 0.5, fine * y - 0.5, (width, height)):
            entries = weight[inside].astype(np.float32), (np.flatnonzero(inside), (row * width + col)[inside])
            resample = resample + sp.csr_matrix(entries, shape=resample.shape)
    resample = resample / SAMPLES**2
    base = (resample @ setup.base.ravel()).reshape(camera.height_px, camera.width_px)
    transports = tuple(sp.csr_array(resample @ each).astype(np.float32) for each in setup.transports)
    return replace(setup, transports=transports, base=base, camera=camera)


def wall(model: str, camera: Mapping[str, float]) -> Scenario:
    """A lamp on a table before a screen."""
    return validate(WALL | {"headlight": {**WALL["headlight"], "model": model}, "camera": WALL["camera"] | camera}, "wall")


def rig(scenario: Scenario, optics: Mapping[str, float] | None = None, gloss: bool = False, division: bool = False, fine: int = 2) -> Rig:
    """The rig of a scenario; its camera and screen as a board would have shown them.

    What the calibration does not know of: optics of the lens, a glossy screen, a lens of the division model (Fitzgibbon 2001).
    """
    (module,) = lamp_modules(mount(scenario.headlight))
    pinhole, rng = CameraModel.of(scenario.camera), np.random.default_rng(0)
    scale = (2 * pinhole.matrix[0, 0] / pinhole.width) ** 2
    coefficients = tuple(c * scale**k for k, c in enumerate(DIVISION if division else BROWN, 1))
    params = LensParams(model="division" if division else "opencv", coefficients=coefficients)
    bench = lens_setup(scenario, module, partial(pinhole_px, pinhole, params), fine)
    T_world_screen = np.array([[0.0, 0, -1, SCREEN_M], [-1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1]])
    to_camera = np.linalg.inv(camera_view(scenario.camera).T_world_view.numpy())
    screen, lamp = (Pose.of(to_camera @ each) for each in (T_world_screen, module.T_body_headlight.numpy()))
    truth = Geometry(pinhole, screen, lamp)
    if optics or gloss:
        gain, glass = _sheen(truth, params) if gloss else 1.0, Lens.of(LensParams(**optics or {}), scenario.camera)
        bench = OpticalSetup(**vars(bench), optics=lambda luminance: glass.image(gain * luminance))
    camera, _ = lens(views(pinhole, params, rng), pinhole.width, pinhole.height)
    off = Pose(lamp.turn + rng.normal(0, 0.01, 3), lamp.place + rng.normal(0, 0.05, 3))
    return Rig(bench, module.headlight, truth, Geometry(camera, screen, off), params)


def views(camera: CameraModel, params: LensParams, rng: np.random.Generator) -> list[Corners]:
    """Corners of a board in twenty views."""
    y, x = (each.ravel() * 0.03 for each in np.mgrid[0:10, 0:7])
    board, size = np.stack([x - x.mean(), y - y.mean(), 0 * x], -1), np.array([camera.width, camera.height])
    views, distance = [], 0.30 * camera.matrix[0, 0] / camera.width * 1.4
    for _ in range(20):
        tilt, way = rng.uniform(0.4, 0.8), rng.uniform(0, 2 * np.pi)
        pose = Pose(tilt * np.array([np.cos(way), np.sin(way), 0.0]), np.array([0.0, 0.0, distance]) * rng.uniform(0.9, 1.4))
        at = lens_px(camera, params, camera.project(np.array([*rng.uniform(-0.1, 0.1, 2), 0.0]) + pose.points(board)))
        inside = ((at > 0) & (at < size)).all(1)
        if inside.sum() >= 12:
            views.append(Corners(board[inside, :2], at[inside] + rng.normal(0, CORNER_PX, (int(inside.sum()), 2))))
    return views


def _sheen(truth: Geometry, params: LensParams) -> Array:
    """Gain of the luminance of a glossy screen, `[height, width]`."""
    v, u = np.indices((truth.camera.height, truth.camera.width)) + 0.5
    points, normal = truth.on_screen(*pinhole_px(truth.camera, params, u, v)), truth.screen.rotation[:, 2]
    to_lamp, to_eye = ((each / np.linalg.norm(each, axis=-1, keepdims=True)) for each in (truth.lamp.place - points, -points))
    half = to_lamp + to_eye
    cos = np.abs(half @ normal) / np.linalg.norm(half, axis=-1)
    return np.asarray(1 + SHEEN * np.exp(-((np.degrees(np.arccos(cos.clip(max=1))) / SHEEN_DEG) ** 2)))
