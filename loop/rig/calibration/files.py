"""The calibration of a rig as a file, `.npz`: camera, and poses of screen and modules. It has no pickle, so that it cannot run code."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from luxloop.loop.rig.calibration.bench import Array
from luxloop.loop.rig.calibration.geometry import DISTORTION, CameraModel, Geometry, Pose
from luxloop.loop.rig.calibration.response import Response
from luxloop.world.arrays import read_npz, write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import content, reading, whole

FORMAT: Final = "luxloop rig calibration"
AGAIN: Final = "run `luxloop rig calibrate` again"
HALF: Final = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV counts from a pixel's centre, we from its corner
LARGEST_PX: Final = 16384


@dataclass(frozen=True, eq=False)
class Calibration:
    """camera: the lens. response: from digital numbers to light. vignetting: `[3]`, as `brightness` takes it. screen: T_camera_screen.
    modules: T_camera_lamp of each, by name. rms: in px, by what was seen. lux: illuminance of the screen in lx that saturates the camera,
    None without a luxmeter reading.
    """

    camera: CameraModel
    response: Response
    vignetting: Array
    screen: Pose
    modules: dict[str, Pose]
    rms: dict[str, float]
    lux: float | None = None

    def geometry(self, module: str) -> Geometry:
        """The geometry of a module. Raises LuxloopError if it was not calibrated."""
        if module not in self.modules:
            known = ", ".join(self.modules)
            raise LuxloopError(f"the calibration knows the modules {known}, not {module!r}; {AGAIN} with this scenario")
        return Geometry(self.camera, (self.screen,), self.modules[module], np.ones(2), {}, {})


def refuse_name(path: Path) -> None:
    """Raises LuxloopError if a file's name does not end in .npz."""
    if path.suffix != ".npz":
        raise LuxloopError(f"{path}: its name ends in .npz; write for example {path.with_suffix('.npz')}")


def save(path: Path, calibration: Calibration) -> None:
    """Write a calibration atomically. Raises LuxloopError if the name does not end in .npz, or it cannot be written."""
    refuse_name(path)
    camera = calibration.camera
    header = {"format": FORMAT, "version": 1, "modules": list(calibration.modules), "rms_px": calibration.rms}
    arrays: dict[str, Any] = {
        "header": np.frombuffer(json.dumps(header).encode(), np.uint8),
        "size_px": np.array([camera.width, camera.height]),
        "camera_matrix": camera.matrix - HALF,
        "distortion": camera.distortion,
        "response": calibration.response.curve.clip(0, 1).astype(np.float32),
        "response_signed": calibration.response.curve,
        "vignetting": calibration.vignetting,
        "T_camera_screen": calibration.screen.matrix,
        "T_camera_modules": np.stack([each.matrix for each in calibration.modules.values()]),
    }
    if camera.covariance is not None:
        arrays["covariance"] = camera.covariance
    if calibration.lux is not None:
        arrays["lux"] = np.array([calibration.lux])
    with whole(path) as part:
        write_npz(part, arrays.items())


def load(path: Path) -> Calibration:
    """Read a calibration. Raises LuxloopError if the file is missing, damaged, or not a calibration."""
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
        return Calibration(camera, Response(curve.astype(np.float32)), vignetting, screen, placed, rms, lux)


def _array(arrays: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    array = np.asarray(arrays[name], float)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name} is no {list(shape)} of finite numbers")
    return array


def _pose(T: Array) -> Pose:
    turn = T[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-6 or np.linalg.det(turn) < 0 or (T[3] != (0, 0, 0, 1)).any():
        raise ValueError("a pose is none")
    return Pose.of(T)
