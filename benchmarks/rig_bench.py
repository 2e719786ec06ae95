"""A rig whose every value is known, with effects that its calibration does not model."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from luxloop.loop.rig.calibration.bench import Array, SimulatedBench, simulated_bench
from luxloop.loop.rig.calibration.board import Corners
from luxloop.loop.rig.calibration.geometry import CameraModel, Geometry, Pose
from luxloop.loop.rig.calibration.intrinsics import lens
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.simulation.build_lamps import mount
from luxloop.loop.simulation.lamps import lamp_modules
from luxloop.perception.camera import camera_view
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.lamps import archive

SCREEN_M = 5.95  # of the screen before the lamp
ALBEDO = 0.8
BLUR_PX, VEIL, VEIL_PX = 0.6, 0.03, 40.0
SHEEN, SHEEN_DEG = 0.15, 12.0  # of the screen that is not Lambertian: brighter near the mirror direction
BROWN, DIVISION = (-0.12, 0.05), -0.1


@dataclass(frozen=True)
class Effects:
    """What the calibration does not know of: blur of the lens, veiling glare, a glossy screen, a lens of another model than its own."""

    blur: bool = False
    veil: bool = False
    gloss: bool = False
    lens: bool = False


@dataclass(frozen=True, eq=False)
class Rig:
    bench: SimulatedBench
    scenario: Scenario
    light: Headlight
    truth: Geometry
    known: Geometry
    lens_of: Callable[[Array, Array], tuple[Array, Array]]


def wall(model: str, width: int, height: int, hfov_deg: float, **camera: float) -> Scenario:
    """A lamp on a table before a screen."""
    return validate(
        {
            "name": "wall",
            "steps": 1,
            "renderer": "raycast",
            "headlight": {"model": model, "lamps": ["left"], "distance_m": 0.0},
            "surface": {"grain": 0.0},
            "camera": {
                **{"x_m": -0.3, "y_m": 0.25, "z_m": 1.0, "pitch_deg": 3.0, "yaw_deg": -2.0},
                **{"width_px": width, "height_px": height, "hfov_deg": hfov_deg},
                **{"exposure_s": 0.004, "sensitivity_e_per_cd_s_m2": 5e3, "saturation_e": 10_000.0},
                **camera,
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
        },
        "wall",
    )


def rig(scenario: Scenario, effects: Effects, fine: int = 2, seed: int = 0) -> Rig:
    """The rig of a scenario with effects; its camera and screen as a board would have shown them."""
    (module,) = lamp_modules(mount(scenario.headlight))
    pinhole = CameraModel.of(scenario.camera)
    true_lens = _lens(pinhole, effects.lens)
    bench = simulated_bench(scenario, [module], true_lens, fine)
    T_world_camera = camera_view(scenario.camera).T_world_view.numpy()
    T_world_screen = np.eye(4)
    T_world_screen[:3, :3] = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]]).T
    T_world_screen[:3, 3] = SCREEN_M, 0.0, 1.0
    to_camera = np.linalg.inv(T_world_camera)
    screen, lamp = (Pose.of(to_camera @ each) for each in (T_world_screen, module.T_world_headlight.numpy()))
    truth = Geometry(pinhole, (screen,), lamp, np.ones(2), {}, {})
    if effects.gloss:
        bench = replace(bench, optics=_gloss(truth, pinhole, true_lens, bench.optics))
    if effects.blur or effects.veil:
        bench = replace(bench, optics=_optics(effects, bench.optics))
    rng = np.random.default_rng(seed)
    known = replace(truth, camera=lens(_views(pinhole, true_lens, rng), pinhole.width, pinhole.height).camera)
    off = Pose(lamp.turn + rng.normal(0, 0.01, 3), lamp.place + rng.normal(0, 0.05, 3))
    return Rig(bench, scenario, module.headlight, truth, replace(known, lamp=off), true_lens)


def _lens(camera: CameraModel, other: bool) -> Callable[[Array, Array], tuple[Array, Array]]:
    """From the lens' image to the pinhole's: as the calibration has it, or by the division model (Fitzgibbon 2001)."""
    half = camera.width / 2
    focal = camera.matrix[0, 0]
    if other:

        def divided(u: Array, v: Array) -> tuple[Array, Array]:
            x, y = (u - camera.width / 2) / half, (v - camera.height / 2) / half
            part = 1 + DIVISION * (x * x + y * y)
            return camera.width / 2 + half * x / part, camera.height / 2 + half * y / part

        return divided
    scale = (focal / half) ** 2
    brown = camera.with_values(np.array([*camera.values[:4], BROWN[0] * scale, BROWN[1] * scale**2, 0.0, 0.0, 0.0]))

    def straight(u: Array, v: Array) -> tuple[Array, Array]:
        rays = brown.rays(u, v)
        return camera.width / 2 + focal * rays[..., 0], camera.height / 2 + focal * rays[..., 1]

    return straight


def _views(camera: CameraModel, lens_of: Callable[[Array, Array], tuple[Array, Array]], rng: np.random.Generator) -> list[Corners]:
    """Corners of a board in twenty views, found to 0.03 px."""
    y, x = (each.ravel() * 0.03 for each in np.mgrid[0:10, 0:7])
    board = np.stack([x - x.mean(), y - y.mean()], -1)
    views = []
    distance = 0.30 * camera.matrix[0, 0] / camera.width * 1.4
    for _ in range(20):
        tilt, way = rng.uniform(0.4, 0.8), rng.uniform(0, 2 * np.pi)
        pose = Pose(tilt * np.array([np.cos(way), np.sin(way), 0.0]), np.array([0.0, 0.0, distance]) * rng.uniform(0.9, 1.4))
        aside = np.array([*rng.uniform(-0.1, 0.1, 2), 0.0])
        at = camera.project(aside + pose.points(np.concatenate([board, np.zeros((len(board), 1))], 1)))
        u, v = seen_at(at, lens_of)
        seen = (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
        if seen.sum() >= 12:
            views.append(Corners(board[seen], np.stack([u, v], -1)[seen] + rng.normal(0, 0.03, (int(seen.sum()), 2))))
    return views


def seen_at(at: Array, lens_of: Callable[[Array, Array], tuple[Array, Array]]) -> tuple[Array, Array]:
    """Where a lens shows points of the pinhole's image `[n, 2]` px, NaN where it shows them nowhere near."""
    u, v = at.T
    with np.errstate(all="ignore"):
        for _ in range(60):
            du, dv = lens_of(u, v)
            u, v = u - (du - at[:, 0]), v - (dv - at[:, 1])
        sound = np.hypot(*(np.stack(lens_of(u, v)) - at.T)) < 1e-6
    return np.where(sound, u, np.nan), np.where(sound, v, np.nan)


def _optics(effects: Effects, before: Callable[[Array], Array] | None) -> Callable[[Array], Array]:
    def seen(luminance: Array) -> Array:
        image = luminance if before is None else before(luminance)
        image = gaussian_filter(image, BLUR_PX) if effects.blur else image
        return (1 - VEIL) * image + VEIL * gaussian_filter(image, VEIL_PX, truncate=3) if effects.veil else image

    return seen


def _gloss(
    truth: Geometry, camera: CameraModel, lens_of: Callable[[Array, Array], tuple[Array, Array]], before: Callable[[Array], Array] | None
) -> Callable[[Array], Array]:
    v, u = np.indices((camera.height, camera.width)) + 0.5
    points = truth.on_screen(*lens_of(u, v))
    normal = truth.screens[0].rotation[:, 2]
    to_lamp, to_eye = ((each / np.linalg.norm(each, axis=-1, keepdims=True)) for each in (truth.lamp.place - points, -points))
    half = to_lamp + to_eye
    cos = np.abs(half @ normal) / np.linalg.norm(half, axis=-1)
    gain = 1 + SHEEN * np.exp(-((np.degrees(np.arccos(cos.clip(max=1))) / SHEEN_DEG) ** 2))
    return lambda luminance: gain * (luminance if before is None else before(luminance))


def model(path: Path, light: Headlight) -> str:
    """A lamp file of one module."""
    archive.save(path, Lamp(path.stem, (Module("matrix", light),)))
    return str(path)
