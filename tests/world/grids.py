"""Small scenes for tests of rendering."""

from collections.abc import Callable

import numpy as np
import trimesh

from luxloop.world.frames import T_ISO_OPENCV, View, pose_from_degrees
from luxloop.world.rendering.gbuffer import GBuffer, gbuffer
from luxloop.world.rendering.raycast import RayCaster
from luxloop.world.scene.body import Body
from luxloop.world.scene.scene import Scene


def grid(z: Callable[[np.ndarray, np.ndarray], np.ndarray], x: np.ndarray, y: np.ndarray) -> trimesh.Trimesh:
    """Height field `z(x, y)` over the grid of x and y, facing up."""
    X, Y = np.meshgrid(x, y, indexing="ij")
    n = len(y)
    i = (np.arange(len(x) - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.r_[np.c_[i, i + n, i + n + 1], np.c_[i, i + n + 1, i + 1]]
    return trimesh.Trimesh(np.c_[X.ravel(), Y.ravel(), np.broadcast_to(z(X, Y), X.shape).ravel()], faces, process=False)


def flat(length_m: float = 70.0) -> trimesh.Trimesh:
    return grid(lambda x, y: 0 * x, np.linspace(-5, length_m, 60), np.linspace(-10, 10, 17))


def bumpy() -> trimesh.Trimesh:
    return grid(lambda x, y: 0.03 * np.sin(1.3 * x) * np.cos(0.9 * y), np.linspace(-5, 50, 500), np.linspace(-8, 8, 100))


def camera(width: int = 320, height: int = 180, pitch_deg: float = 3.0) -> View:
    """The default camera, smaller: 30 deg wide, 1.35 m high, 1.6 m behind the lamps."""
    f = width / 2 / np.tan(np.radians(15))
    eye = pose_from_degrees((-1.6, 0, 1.35), pitch_deg=pitch_deg) @ T_ISO_OPENCV
    return View(width, height, f, f, width / 2, height / 2, eye)


def lamp(width: int = 1024, height: int = 512) -> View:
    """A shadow view of the left lamp: +-10 deg wide, +1.5 to -3.5 deg high, so neither centred nor square in its texels."""
    left, top, bottom = np.tan(np.radians([10, 1.5, -3.5]))
    fx, fy = width / (2 * left), height / (top - bottom)
    eye = pose_from_degrees((0, 0.6, 0.75)) @ T_ISO_OPENCV
    return View(width, height, fx, fy, fx * left, fy * top, eye)


def see(*bodies: Body, view: View | None = None) -> GBuffer:
    """What a camera, by default the one above, sees of bodies."""
    triangles, view = Scene(bodies).at(0.0), view or camera()
    return gbuffer(triangles, view, RayCaster().face_ids(triangles, view))
