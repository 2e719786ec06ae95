"""Bundle adjustment of camera, screen and lamp.

The lamp is an inverse camera: each pixel has a direction from the data sheet, and its light falls where this ray meets the screen.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from luxloop.loop.rig.arrays import Array, Indices
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.errors import LuxloopError

DISTORTION = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's, in its order
ISO = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # OpenCV axes of ISO 8855 vectors
HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # from OpenCV's pixel centres at integers to ours at integer + 0.5
MOST_PIXELS = 2000  # lamp pixels in the adjustment
INVERSION = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-10)  # of the distortion: steps, tangents
PLACED_M = 0.1  # standard deviation of the lamp's start position, which decides for lamps with a narrow field
UNSURE_PX = 0.05  # standard deviation of an image position
MOST_PX = 3.0  # rms of residuals, above which a calibration has failed
SIDE = 4  # blocks across a picture; residuals within a block are correlated
TINY = 1e-12  # least variance of a residual
UNDETERMINED = 1e-12  # least eigenvalue of a normal matrix with unit diagonal
# Standard deviations without a measurement: focal length (relative), angle and position of the screen.
ASSUMED_FOCAL, ASSUMED_RAD, ASSUMED_M = 0.01, math.radians(0.5), 0.005


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A camera with lens distortion.

    matrix: `[3, 3]` px, pixel centres at integer + 0.5. distortion: `[5]`, OpenCV's coefficients. covariance: `[9, 9]` of fx, fy, cx, cy
    and distortion; None if the lens was not measured.
    """

    width: int
    height: int
    matrix: Array
    distortion: Array = field(default_factory=lambda: np.zeros(5))
    covariance: Array | None = None

    @classmethod
    def of(cls, camera: CameraParams) -> Self:
        """The pinhole camera of a scenario."""
        view = camera_view(camera)
        return cls(view.width, view.height, np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1.0]]))

    def rays(self, u: Array, v: Array) -> Array:
        """Directions `[..., 3]` of camera pixels in the camera's frame, with z = 1."""
        pixels = np.stack([u, v], -1).astype(float)
        tangents = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.matrix, self.distortion, criteria=INVERSION)
        return np.asarray(cv2.convertPointsToHomogeneous(tangents), float).reshape(*pixels.shape[:-1], 3)

    def project(self, points: Array) -> Array:
        """Image positions `[n, 2]` px of points `[n, 3]` m in the camera's frame."""
        found = cv2.projectPoints(np.ascontiguousarray(points)[:, None], np.zeros(3), np.zeros(3), self.matrix, self.distortion)
        return np.asarray(found[0][:, 0], float)

    @property
    def values(self) -> Array:
        """fx, fy, cx, cy and the distortion, `[9]`."""
        return np.array([self.matrix[0, 0], self.matrix[1, 1], self.matrix[0, 2], self.matrix[1, 2], *self.distortion])

    def with_values(self, values: Array) -> Self:
        fx, fy, cx, cy = values[:4]
        return replace(self, matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), distortion=np.asarray(values[4:], float))


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of one frame in another: rotation vector `[3]` in rad, and position `[3]` of the origin in m."""

    turn: Array
    place: Array

    @classmethod
    def of(cls, T: Array) -> Self:
        return cls(Rotation.from_matrix(T[:3, :3]).as_rotvec(), np.asarray(T[:3, 3], float))

    @property
    def matrix(self) -> Array:
        """Homogeneous matrix `[4, 4]`."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.rotation, self.place
        return T

    @property
    def values(self) -> Array:
        """Rotation vector and position, `[6]`."""
        return np.concatenate([self.turn, self.place])

    @property
    def rotation(self) -> Array:
        return Rotation.from_rotvec(self.turn).as_matrix()

    def points(self, points: Array) -> Array:
        return points @ self.rotation.T + self.place


@dataclass(frozen=True, eq=False)
class Observation:
    """Measured image positions of lamp pixels and board corners on a screen.

    tangents: `[n, 2]`, y and z of the lamp pixels' directions by data sheet. pixels: `[n, 2]` px, their image positions. board: `[k, 2]` m,
    corners of a board on the screen. corners: `[k, 2]` px, their image positions. Both are empty without a board.
    """

    tangents: Array
    pixels: Array
    board: Array = field(default_factory=lambda: np.zeros((0, 2)))
    corners: Array = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class Geometry:
    """Adjusted geometry of camera, screen and lamp.

    screen: T_camera_screen; the screen is its plane z = 0. lamp: T_camera_lamp; axes are OpenCV's for the camera, ISO 8855 for the lamp.
    std: standard deviations by name, assumptions included (`covariance_of`). rms: of the residuals of lamp pixels and board corners, in px.
    """

    camera: CameraModel
    screen: Pose
    lamp: Pose
    std: Mapping[str, Array] = field(default_factory=dict)
    rms: Mapping[str, float] = field(default_factory=dict)

    def on_screen(self, u: Array, v: Array) -> Array:
        """Points `[..., 3]` m of the screen at camera pixels, in the camera's frame."""
        return on_plane(self.camera.rays(u, v), np.zeros(3), self.screen)

    def tangents(self, points: Array) -> tuple[Array, Array]:
        """Tangents (y, z) of the lamp's rays to points `[..., 3]` m in the camera's frame."""
        x, y, z = np.moveaxis((points - self.lamp.place) @ self.lamp.rotation, -1, 0)
        return y / x, z / x


def on_plane(rays: Array, origin: Array, screen: Pose) -> Array:
    """Intersections `[..., 3]` m of rays `[..., 3]` from an origin `[3]` with the plane z = 0 of a screen, in the camera's frame."""
    normal = screen.rotation[:, 2]
    return origin + rays * (normal @ (screen.place - origin) / (rays @ normal))[..., None]


def adjust(camera: CameraModel, screen: Pose, lamp: Pose, seen: Observation, fix_camera: bool = False) -> Geometry:
    """Bundle adjustment of camera, screen and lamp from start values.

    The start position of the lamp has a standard deviation of 0.1 m. The camera is constrained by its covariance; without a covariance, or
    with `fix_camera`, the camera is fixed, and so is a screen without a board. The scale of the lamp's field cannot be separated from the
    lamp's distance.
    """
    some = slice(None, None, max(1, len(seen.tangents) // MOST_PIXELS))
    seen = replace(seen, tangents=seen.tangents[some], pixels=seen.pixels[some])
    root = None if fix_camera or camera.covariance is None else np.linalg.pinv(_root(camera.covariance))
    start: dict[str, Array] = {} if root is None else {"camera": np.zeros(9)}
    start |= {"lamp": lamp.values} | ({"screen": screen.values} if len(seen.board) else {})
    ends = np.cumsum([len(each) for each in start.values()])[:-1]

    def unpack(x: Array) -> tuple[CameraModel, Pose, Pose]:
        values = dict(zip(start, np.split(x, ends), strict=True))
        eye = camera.with_values(camera.values + values["camera"]) if "camera" in values else camera
        plane, there = values.get("screen", screen.values), values["lamp"]
        return eye, Pose(plane[:3], plane[3:]), Pose(there[:3], there[3:])

    def residuals(x: Array) -> Array:
        eye, plane, there = unpack(x)
        left = [each.ravel() / UNSURE_PX for each in _residuals(eye, plane, there, seen)]
        left.append((there.place - lamp.place) / PLACED_M)
        return np.concatenate(left if root is None else [*left, root @ x[:9]])

    x0 = np.concatenate(list(start.values()))
    size = np.maximum(np.abs(x0), 1e-2)
    solved: Any = least_squares(residuals, x0, loss="soft_l1", f_scale=10.0, x_scale=size, xtol=1e-13, ftol=1e-13, gtol=1e-13)
    eye, plane, there = unpack(solved.x)
    pixels, corners = _residuals(eye, plane, there, seen)
    left = np.concatenate([pixels.ravel(), corners.ravel()]) / UNSURE_PX
    groups = np.concatenate([np.repeat(blocks(each), 2) for each in (seen.pixels, seen.corners)])
    jac, prior = np.split(solved.jac, [len(left)])
    variance = float(left @ left) / max(len(left) - len(x0), 1)
    covariance = covariance_of(*group_residuals(jac, left, groups), variance, prior.T @ prior)
    weight = np.linalg.pinv(jac.T @ jac + prior.T @ prior * variance) @ jac.T
    for other_eye, other_plane in _perturbations(eye, plane, not fix_camera and camera.covariance is None, "screen" not in start):
        other = _residuals(other_eye, other_plane, there, seen)
        by = weight @ (np.concatenate([part.ravel() for part in other]) / UNSURE_PX - left)
        covariance += np.outer(by, by)
    std = dict(zip(start, np.split(np.sqrt(np.diag(covariance)), ends), strict=True))
    return Geometry(eye, plane, there, std, {"lamp": rms_of(pixels), "board": rms_of(corners)})


def _residuals(camera: CameraModel, screen: Pose, lamp: Pose, seen: Observation) -> tuple[Array, Array]:
    """Residuals of lamp pixels `[n, 2]` and of board corners `[k, 2]` in px."""
    rays = np.insert(seen.tangents, 0, 1, 1) @ lamp.rotation.T
    pixels = camera.project(on_plane(rays, lamp.place, screen)) - seen.pixels
    board = screen.points(np.pad(seen.board, ((0, 0), (0, 1))))
    return pixels, camera.project(board) - seen.corners if len(board) else np.zeros((0, 2))


def _perturbations(camera: CameraModel, screen: Pose, lens: bool, plane: bool) -> Iterator[tuple[CameraModel, Pose]]:
    """Camera and screen with one assumption at a time off by its standard deviation. lens, plane: whether lens and screen are assumed."""
    if lens:
        yield camera.with_values(camera.values * np.where(np.arange(9) < 2, 1 + ASSUMED_FOCAL, 1)), screen
    for axis in np.eye(3) if plane else ():
        turn = Rotation.from_matrix(screen.rotation @ Rotation.from_rotvec(ASSUMED_RAD * axis).as_matrix()).as_rotvec()
        yield camera, Pose(turn, screen.place)
        yield camera, Pose(screen.turn, screen.place + ASSUMED_M * axis)


def blocks(pixels: Array) -> Indices:
    """Number of the block, of 4 x 4 over the points' extent, that contains each of the points `[n, 2]`."""
    if not len(pixels):
        return np.zeros(0, np.intp)
    at = SIDE * (pixels - pixels.min(0)) / np.maximum(np.ptp(pixels, axis=0), TINY)
    column, row = at.astype(np.intp).clip(0, SIDE - 1).T
    return np.asarray(SIDE * row + column)


def group_residuals(jacobian: Array, residuals: Array, groups: Indices) -> tuple[Array, Array]:
    """Normal matrices `[g, p, p]` and gradients `[g, p]` of groups of residuals `[n]`. jacobian: `[n, p]`. groups: group numbers, `[n]`."""
    parts = [(jacobian[groups == k], residuals[groups == k]) for k in np.unique(groups)]
    return np.stack([J.T @ J for J, _ in parts]), np.stack([J.T @ r for J, r in parts])


def covariance_of(normals: Array, gradients: Array, variance: float, prior: Array | float = 0.0) -> Array:
    """Covariance `[p, p]` of a least-squares fit whose residuals are correlated within groups, such as the views of a board.

    normals, gradients: as of `group_residuals`. variance: of a residual. prior: `[p, p]`, inverse covariance of prior knowledge. Standard
    deviations are the larger of those of independent residuals and those of the jackknife, which leaves out one group at a time (Efron
    1982). Undetermined values have very large ones.
    """
    variance = max(variance, TINY)
    total = normals.sum(0) / variance + prior
    size = 1 / np.sqrt(np.maximum(np.diag(total), TINY))

    def inverse(normal: Array) -> Array:
        values, vectors = np.linalg.eigh(normal * np.outer(size, size))
        return np.asarray(np.outer(size, size) * ((vectors / np.maximum(values, UNDETERMINED)) @ vectors.T))

    plain = inverse(total)
    changes = np.stack([inverse(total - N / variance) @ g / variance for N, g in zip(normals, gradients, strict=True)])  # [g, p]
    jackknife = (1 - 1 / len(changes)) * (changes**2).sum(0)
    larger = np.sqrt(np.maximum(jackknife / np.diag(plain), 1))
    return np.asarray(plain * np.outer(larger, larger))


def rms_of(residuals: Array) -> float:
    """Rms length of residuals `[n, 2]`; NaN if there are none."""
    return float(np.sqrt((residuals**2).sum(-1).mean())) if len(residuals) else float("nan")


def _root(covariance: Array) -> Array:
    """Square root of a covariance: its product with its own transpose is the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 1e-24))


def candela_factor(geometry: Geometry, shape: tuple[int, int], reflectance: Callable[[Array], Array]) -> Array:
    """Luminous intensity of the lamp in cd per cd/m^2 at each camera pixel, `[height, width]`: `I = pi L d^2 / (rho cos)` (T eq. 2.1.5).

    shape: rows and columns of the picture. reflectance: luminance factor of the screen by the cosine of the angle of view. Raises
    LuxloopError if the camera sees the back of the screen.
    """
    v, u = np.indices(shape) + 0.5
    points = geometry.on_screen(u, v)
    normal = geometry.screen.rotation[:, 2]
    seen = np.abs(points @ normal) / np.linalg.norm(points, axis=-1)
    if (normal @ (geometry.lamp.place - geometry.screen.place)) * (normal @ -geometry.screen.place) <= 0:
        raise LuxloopError("lamp and camera are on different sides of the screen; look at its pose, and at the lamp's")
    return np.pi / (lux_per_cd(points, geometry.lamp.place, normal) * reflectance(seen))


def lux_per_cd(points: Array, lamp: Array, normal: Array) -> Array:
    """Illuminance in lx per cd at points `[..., 3]` m of a surface, `cos / d^2`. lamp: position `[3]` m. normal: of the surface, `[3]`."""
    away = points - lamp
    distance = np.linalg.norm(away, axis=-1)
    return np.asarray(np.abs(away @ normal) / distance**3)
