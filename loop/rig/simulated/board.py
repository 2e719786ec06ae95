"""A ChArUco board in the hand or on the screen, and a luxmeter."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from luxloop.loop.rig.arrays import Array, Image
from luxloop.loop.rig.calibration.digitise import lux, sensor
from luxloop.loop.rig.calibration.intrinsics import BoardParams, picture
from luxloop.loop.rig.simulated.faults import BoardFaultParams
from luxloop.loop.rig.simulated.lens import Lens, distort
from luxloop.loop.rig.simulated.scene import RigScene
from luxloop.perception.camera import CameraParams, luminance_of
from luxloop.world.caches import keeping
from luxloop.world.errors import LuxloopError

POSES = 20
POSE_S = 1.0  # duration of each pose
LAID_S = 2.0  # time without light until the board lies on the screen
TILTS_DEG = (25.0, 33.0, 41.0)
ROLL_DEG = 15.0
GOLDEN_RAD = 2.4  # golden angle between the tilt directions of consecutive poses
FILLED = (0.9, 0.65)  # share of the picture's height or width that the board fills
ASIDE = (0.0, -0.22, 0.22)  # offset from the picture's centre, as a share of its width and height
FINER = 3  # oversampling of the board's edges
DPI = 100.0
PAPER, ROOM = 0.6, 0.2  # digital numbers of white paper and of all else in room light, as shares of the largest
BLACK = 0.05  # reflectance of the ink as a share of the paper's
LIT = 0.5  # share of the largest illuminance at the edge of the light
READ = (0.1, 0.5, 0.9)  # positions of readings, as shares of the light's width and height


@dataclass(frozen=True, eq=False)
class BoardView:
    """A board in room light.

    T_view_screen: pose on the surface in the centre of the picture. paper, room: luminances in cd/m^2.
    """

    board: BoardParams
    lens: Lens
    T_view_screen: Array
    paper: float
    room: float

    @classmethod
    def of(cls, params: BoardFaultParams, rig_scene: RigScene) -> Self:
        """Board before a rig's camera. Raises LuxloopError if the picture's centre shows no surface for the board."""
        paper, room = luminance_of(torch.tensor([PAPER, ROOM]) * (2**rig_scene.camera.bits - 1), rig_scene.camera).tolist()
        T_world_view = rig_scene.world.view.T_world_view.numpy()
        surfaces = rig_scene.world.lit(0.0).surfaces
        row, column = (n // 2 for n in surfaces.object_id.shape)
        if int(surfaces.object_id[row, column]) < 0:
            raise LuxloopError(
                "board: the camera's middle looks at nothing that it could lie on; turn the camera, or set board.shown = false"
            )
        point, normal = (each[:, row, column].double().numpy() for each in (surfaces.position, surfaces.normal))
        turn = T_world_view[:3, :3].T
        return cls(params, rig_scene.lens, _lying(turn @ (point - T_world_view[:3, 3]), turn @ normal, _size_m(params)), paper, room)

    def at(self, from_s: float, heard_s: float | None) -> Image | None:
        """Image `[height, width]` in cd/m^2 from a time on; None while light arrives, during which there is no board.

        heard_s: time of the last light, None before the first, when the board is in the hand.
        """
        if heard_s is None:
            return self._images(int(from_s / POSE_S) % POSES)
        return None if from_s - heard_s < LAID_S else self._images(None)

    @cached_property
    def _images(self) -> Callable[[int | None], Image]:
        return keeping(1, self.image)

    def image(self, pose: int | None) -> Image:
        """Image `[height, width]` in cd/m^2 of the board in the hand in one of its poses, or, for None, on the screen."""
        T_view_board = self.T_view_screen if pose is None else board_pose(self.board, self.lens.camera, pose)
        drawn = picture(self.board, DPI)
        m_per_px = self.board.square_mm / 1000 * self.board.columns / drawn.shape[1]
        on_board = np.array([[m_per_px, 0, m_per_px / 2], [0, m_per_px, m_per_px / 2], [0, 0, 1]])  # from pixel centres to m
        camera, focal = self.lens.camera, FINER * self.lens.camera.focal_px
        size = FINER * camera.width_px, FINER * camera.height_px
        pinhole = np.array([[focal, 0, size[0] / 2 - 0.5], [0, focal, size[1] / 2 - 0.5], [0, 0, 1]])
        homography = pinhole @ T_view_board[:3][:, [0, 1, 3]] @ on_board
        white = np.ones_like(drawn)
        shown, there = (cv2.warpPerspective(each, homography, size, flags=cv2.INTER_LINEAR) for each in (drawn, 255 * white))
        ink, covered = (cv2.resize(each, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA) for each in (shown, there))
        share = (covered.astype(np.float32) * BLACK + ink.astype(np.float32) * (1 - BLACK)) / 255
        return self.lens.image((self.paper * share + self.room * (1 - covered.astype(np.float32) / 255)).astype(np.float32))


def board_pose(board: BoardParams, camera: CameraParams, pose: int) -> Array:
    """T_view_board `[4, 4]` of a tilted board in the hand, in the picture's centre or beside it."""
    width, height = _size_m(board)
    way, tilt = GOLDEN_RAD * pose, math.radians(TILTS_DEG[pose % len(TILTS_DEG)])
    roll = math.radians(ROLL_DEG) * math.sin(1.7 * pose)
    tilted = Rotation.from_rotvec([tilt * math.cos(way), tilt * math.sin(way), 0.0])
    turn = (tilted * Rotation.from_rotvec([0.0, 0.0, roll])).as_matrix()
    focal = camera.focal_px
    depth = focal * max(height / camera.height_px, width / camera.width_px) / FILLED[pose % len(FILLED)]
    aside = np.array([ASIDE[pose % 3] * camera.width_px, ASIDE[pose // 3 % 3] * camera.height_px, focal]) * depth / focal
    return _pose(turn, aside - turn @ np.array([width / 2, height / 2, 0.0]))


def readings(rig_scene: RigScene) -> list[tuple[float, float, float]]:
    """Readings of a luxmeter at nine points of the light on the screen with all pixels on: lx, and image position (u, v) px.

    Raises LuxloopError if the camera sees no light.
    """
    scene = rig_scene.world.lit(0.0, direct=True)
    bright, _ = scene.light([torch.ones(each.headlight.n_pixels) for each in rig_scene.modules])
    lit = (bright > LIT * bright.max()).numpy()
    if not float(bright.max()) > 0:
        raise LuxloopError("board: the camera sees no light of the lamp on anything; turn the camera, or set board.shown = false")
    rows, columns = (np.flatnonzero(lit.any(axis)) for axis in (1, 0))
    T_world_body = scene.vehicle.T_world_body.double().numpy()
    found = []
    for row in np.quantile(rows, READ).astype(int):
        for column in np.quantile(columns, READ).astype(int):
            point, normal = (each[:, row, column].double().numpy() for each in (scene.surfaces.position, scene.surfaces.normal))
            side = np.cross(normal, [0.0, 0.0, 1.0] if abs(normal[2]) < 0.9 else [0.0, 1.0, 0.0])
            side /= np.linalg.norm(side)
            points = point + sensor(side, np.cross(normal, side))
            modules = ((each.headlight, T_world_body @ each.T_body_headlight.double().numpy()) for each in rig_scene.modules)
            found.append((sum(lux(light, T, points, normal) for light, T in modules), *_image_place(rig_scene, row, column)))
    return found


def _image_place(rig_scene: RigScene, row: int, column: int) -> tuple[float, float]:
    """Image position (u, v) px through the lens of a pixel of the pinhole picture."""
    lens, focal = rig_scene.lens, rig_scene.lens.camera.focal_px
    straight = np.array([[(column + 0.5) / rig_scene.columns - lens.camera.width_px / 2, row + 0.5 - lens.camera.height_px / 2]]) / focal
    u, v = (distort(lens.params, straight) * focal)[0] + lens.matrix[:2, 2]
    return float(u), float(v)


def _lying(point: Array, normal: Array, size_m: tuple[float, float]) -> Array:
    """T_view_board of a board whose middle lies at a point of a surface `[3]` m, with its rows along the picture's."""
    right = np.array([1.0, 0.0, 0.0]) + normal[0] * -normal
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(-normal, right), -normal], 1)
    return _pose(turn, point - turn @ np.array([size_m[0] / 2, size_m[1] / 2, 0.0]))


def _pose(turn: Array, place: Array) -> Array:
    return np.vstack([np.column_stack([turn, place]), [0, 0, 0, 1]])


def _size_m(board: BoardParams) -> tuple[float, float]:
    return board.columns * board.square_mm / 1000, board.rows * board.square_mm / 1000
