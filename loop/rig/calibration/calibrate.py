"""Calibration of a rig: camera response, lens, poses of camera, screen and modules, and the file that holds them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.digitise import FRAMES, Nominal, Reading, locate_pixels
from luxloop.loop.rig.calibration.geometry import DISTORTION, HALF, ISO, MOST_PX, CameraModel, Geometry, Observation, Pose, adjust
from luxloop.loop.rig.calibration.intrinsics import Corners, brightness
from luxloop.loop.rig.calibration.shots import Shots, response_curve
from luxloop.loop.rig.calibration.structured_light import Places, patterns
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.arrays import read_npz, write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import content, reading
from luxloop.world.frames import is_rigid

FORMAT = "luxloop rig calibration"
AGAIN = "run `luxloop rig calibrate` again"
LARGEST_PX = 16384


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of a rig.

    camera: lens camera. response: see `response_curve`. vignetting: `[3]`, coefficients of `brightness`. screen: T_camera_screen. modules:
    T_camera_lamp by module name. rms: residuals in px, by measurement. lux: illuminance of the screen in lx that saturates the camera, None
    without a luxmeter reading.
    """

    camera: CameraModel
    response: Array
    vignetting: Array
    screen: Pose
    modules: dict[str, Pose]
    rms: dict[str, float]
    lux: float | None = None

    def geometry(self, module: str) -> Geometry:
        """Geometry of camera, screen and one module. Raises LuxloopError if the module was not calibrated."""
        if module not in self.modules:
            known = ", ".join(self.modules)
            raise LuxloopError(f"the calibration knows the modules {known}, not {module!r}; {AGAIN} with this scenario")
        return Geometry(self.camera, self.screen, self.modules[module])


OVERRIDES = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg", "hfov_deg")  # keys of the scenario's camera


def refuse_name(path: Path) -> None:
    """Raise LuxloopError if the file name does not end in .npz."""
    if path.suffix != ".npz":
        raise LuxloopError(f"{path}: its name ends in .npz; write for example {path.with_suffix('.npz')}")


def save(path: Path, calibration: Calibration) -> None:
    """Write a calibration file atomically. Raises LuxloopError if its name does not end in .npz, or on a write error."""
    refuse_name(path)
    camera = calibration.camera
    header = {"format": FORMAT, "version": 1, "modules": list(calibration.modules), "rms_px": calibration.rms}
    arrays: dict[str, Any] = {
        "header": np.frombuffer(json.dumps(header).encode(), np.uint8),
        "size_px": np.array([camera.width, camera.height]),
        "camera_matrix": camera.matrix - HALF,
        "distortion": camera.distortion,
        "response": calibration.response.clip(0, 1),
        "response_signed": calibration.response,
        "vignetting": calibration.vignetting,
        "T_camera_screen": calibration.screen.matrix,
        "T_camera_modules": np.stack([each.matrix for each in calibration.modules.values()]),
    }
    if camera.covariance is not None:
        arrays["covariance"] = camera.covariance
    if calibration.lux is not None:
        arrays["lux"] = np.array([calibration.lux])
    write_npz(path, arrays.items())


def load(path: Path) -> Calibration:
    """Read a calibration file. Raises LuxloopError if the file is missing, damaged, or no calibration."""
    with reading(path, "no calibration of a rig, or damaged", AGAIN):
        content(path)
        arrays = read_npz(path)
        header = json.loads(arrays["header"].tobytes())
        if header["format"] != FORMAT or header["version"] != 1:
            raise ValueError("another format")
        names, rms = [str(name) for name in header["modules"]], {str(key): float(value) for key, value in header["rms_px"].items()}
        width, height = (int(each) for each in _array(arrays, "size_px", (2,)))
        if not (0 < width <= LARGEST_PX and 0 < height <= LARGEST_PX):
            raise ValueError("size_px is none")
        matrix = _array(arrays, "camera_matrix", (3, 3)) + HALF
        covariance = _array(arrays, "covariance", (9, 9)) if "covariance" in arrays else None
        camera = CameraModel(width, height, matrix, _array(arrays, "distortion", (len(DISTORTION),)), covariance)
        if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
            raise ValueError("camera_matrix has no positive focal length")
        curve = arrays["response_signed"]
        if curve.ndim != 1 or not 256 <= len(curve) <= 65536 or not np.isfinite(curve).all():
            raise ValueError("response has no 256 to 65536 finite numbers")
        poses = _array(arrays, "T_camera_modules", (len(names), 4, 4))
        screen, *modules = (_pose(each) for each in (_array(arrays, "T_camera_screen", (4, 4)), *poses))
        vignetting = _array(arrays, "vignetting", (3,))
        lux = float(_array(arrays, "lux", (1,))[0]) if "lux" in arrays else None
        if lux is not None and lux <= 0:
            raise ValueError("lux is none")
        placed = dict(zip(names, modules, strict=True))
        return Calibration(camera, curve.astype(np.float32), vignetting, screen, placed, rms, lux)


def _array(arrays: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    array = np.asarray(arrays[name], float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name} is no {list(shape)} of finite numbers")
    return array


def _pose(T: Array) -> Pose:
    if not is_rigid(T):
        raise ValueError("a pose is none")
    return Pose.of(T)


LADDER = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 0.75, 1.0)  # utilisations, for a camera with one exposure
AVERAGED = 8  # frames of each rung
SENSOR_PX = 3  # width and height of a luxmeter's sensor, whose light is the mean over them
SCREEN = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]]).T  # of a screen ahead: x to the right, y up, z towards the lamp


def _uniform(sizes: Sequence[int], u: float) -> list[Array]:
    return [np.full(n, u) for n in sizes]


def measure_response(shots: Shots, sizes: Sequence[int]) -> Array:
    """Camera response, from a series of exposure times if the camera has three or more, else from utilisations in a dark room.

    sizes: number of pixels of each module. Raises LuxloopError if the frames do not suffice.
    """
    times = shots.setup.exposures_s
    if len(times) >= 3:
        series = [("black", 0.0, times[0], 0.0), *(("response", 1.0, each, each) for each in times)]
    else:
        series = [(f"response_{100 * u:.0f}", u, times[-1], u) for u in LADDER]
    frames = [shots.frames(name, _uniform(sizes, u), AVERAGED, exposure_s).mean(0) for name, u, exposure_s, _ in series]
    return response_curve(frames, [ratio for *_, ratio in series], shots.setup.levels)


def calibrate_poses(
    shots: Shots,
    modules: Sequence[LampModule],
    params: CameraParams,
    vignetting: Array,
    lens: tuple[CameraModel, float] | None,
    screen: Corners | float,
) -> tuple[Calibration, dict[str, Geometry], dict[str, float]]:
    """Bundle adjustment of all modules to their located pixels. Returns the calibration, and by module name the geometry and the located
    share of its pixels.

    params: the scenario's camera. lens: camera model and rms in px from board views, None for the scenario's pinhole camera. screen:
    corners of a board lying on the screen, or the distance in m from the lamps to a screen perpendicular to the x axis. Raises LuxloopError
    if too few pixels are located, or residuals are too large.
    """
    board = screen if isinstance(screen, Corners) else None
    camera = CameraModel.of(params) if lens is None else lens[0]
    if (camera.height, camera.width) != shots.setup.shape:
        height, width = shots.setup.shape
        raise LuxloopError(f"the camera has {width} x {height} px, but the board's pictures {camera.width} x {camera.height} px")
    sizes = [each.headlight.n_pixels for each in modules]
    T_camera_world = np.linalg.inv(camera_view(params).T_world_view.numpy())
    start = _screen(camera, screen, T_camera_world)
    geometry, found = {}, {}
    for number, module in enumerate(modules):
        nominal = Nominal.of(number, module.name, module.headlight)
        places = _places(shots, nominal, sizes)
        seen = _observation(nominal, places, board)
        lamp = Pose.of(T_camera_world @ module.T_body_headlight.double().cpu().numpy())
        geometry[module.name] = adjust(camera, start, lamp, seen)
        found[module.name] = float(np.isfinite(places.u).mean())
    last = next(iter(geometry.values()))
    poses = {name: each.lamp for name, each in geometry.items()}
    rms = {f"module {name}": each.rms["lamp"] for name, each in geometry.items()}
    if board is not None:
        rms["board on the screen"] = last.rms["board"]
    if lens is not None:
        rms["boards"] = lens[1]
    for what, left in rms.items():
        if not left < MOST_PX:
            raise LuxloopError(
                f"{what}: is {left:.3g} px rms from where lamp, screen and camera have it; check the poses and the camera of the scenario, "
                "the screen's distance or the picture of the board on it, and the order of the lamp's pixels"
            )
    kept = replace(last.camera, covariance=camera.covariance)
    return Calibration(kept, shots.response, vignetting, last.screen, poses, rms), geometry, found


def lux_scale(shots: Shots, sizes: Sequence[int], readings: Sequence[Reading], vignetting: Array) -> float:
    """Illuminance of the screen in lx that saturates the camera at its longest exposure; mean over luxmeter readings with all pixels on.

    The screen is Lambertian. Raises LuxloopError if the camera sees no light at the position of a reading.
    """
    height, width = shots.setup.shape
    for _, u, v in readings:
        if not (0 <= u <= width and 0 <= v <= height):
            raise LuxloopError(f"--lux: {u:g}, {v:g} px lies outside of the camera's picture of {width} x {height} px")
    on, off = _uniform(sizes, 1.0), _uniform(sizes, 0.0)
    main = shots.exposures("lux_brightest", on)[:1]
    light = shots.light("lux", on, AVERAGED, main) - shots.light("lux_off", off, AVERAGED, main)
    light = (light / brightness(vignetting, height, width)).astype(np.float32)
    found = []
    for lux, u, v in readings:
        there = float(cv2.getRectSubPix(light, (SENSOR_PX, SENSOR_PX), (u - 0.5, v - 0.5)).mean())
        if there <= 0:
            raise LuxloopError(f"the camera sees no light at {u:g}, {v:g} px; give the place of the luxmeter's sensor in its picture")
        found.append(lux / there)
    return float(np.mean(found)) / shots.setup.exposures_s[-1]


def _places(shots: Shots, nominal: Nominal, sizes: Sequence[int]) -> Places:
    name, lit = nominal.shot, partial(nominal.alone, sizes)
    on = lit(np.ones(sizes[nominal.number]))
    main = shots.exposures(name("brightest"), on)[:1]
    repeats = shots.response[shots.frames(name("full"), on, 4, main[0])] / main[0]
    noise = float(np.sqrt(repeats.var(0, ddof=1).mean()) / np.sqrt(FRAMES))
    return locate_pixels(
        [shots.light(name(what), lit(u), FRAMES, main) for what, u in patterns(nominal.rows, nominal.cols)], noise, nominal
    )


def _observation(nominal: Nominal, places: Places, board: Corners | None) -> Observation:
    """Image positions of the located lamp pixels without the two outermost rows and columns, and the board corners on the screen."""
    inner = np.isfinite(places.u)
    inner &= np.pad(np.ones([n - 4 if n > 6 else n for n in inner.shape], bool), [(2, 2) if n > 6 else (0, 0) for n in inner.shape])
    row, col = np.argwhere(inner).T + 0.5
    tangents = np.stack([nominal.y[inner], nominal.z[inner]], -1)
    finite = np.isfinite(tangents).all(1)
    pixels = np.stack(places.chart(row, col), -1)
    corners = {} if board is None else {"board": board.board, "corners": board.pixels}
    return Observation(tangents[finite], pixels[finite], **corners)


def _screen(camera: CameraModel, screen: Corners | float, T_camera_world: Array) -> Pose:
    """Start value of T_camera_screen. Raises LuxloopError if the board does not determine it."""
    if isinstance(screen, Corners):
        points = np.pad(screen.board, ((0, 0), (0, 1)))
        rays = np.ascontiguousarray(camera.rays(*screen.pixels.T)[:, :2])  # as OpenCV takes them
        good, turn, move = cv2.solvePnP(points, rays, np.eye(3), None)
        if not good:
            raise LuxloopError("the board on the screen does not tell where that is; take a sharper picture of it")
        return Pose(np.asarray(turn, float).ravel(), np.asarray(move, float).ravel())
    T_world_screen = np.eye(4)
    T_world_screen[:3, :3], T_world_screen[0, 3] = SCREEN, screen
    return Pose.of(T_camera_world @ T_world_screen)


def overrides(calibration: Calibration, module: LampModule) -> dict[str, float]:
    """Scenario keys of the camera with calibrated values, relative to the scenario's pose of the lamp that has this module."""
    T = module.T_body_headlight.double().cpu().numpy() @ np.linalg.inv(calibration.modules[module.name].matrix)
    yaw_deg, pitch_deg, roll_deg = Rotation.from_matrix(T[:3, :3] @ ISO).as_euler("ZYX", degrees=True)
    hfov_deg = 2 * np.degrees(np.arctan(calibration.camera.width / 2 / calibration.camera.matrix[0, 0]))
    values = zip(OVERRIDES, (*T[:3, 3], roll_deg, pitch_deg, yaw_deg, hfov_deg), strict=True)
    return {f"camera.{name}": round(float(value), 5) for name, value in values}
