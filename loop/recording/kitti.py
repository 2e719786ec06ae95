"""Labels in the layout of KITTI's object data set: a text file of boxes and one of the calibration for each image (Geiger et al. 2012)."""

import math
from collections.abc import Mapping
from typing import Final

from torch import Tensor

from luxloop.loop.recording.labelled import LabelledImage
from luxloop.loop.simulation.world import TrueObject
from luxloop.world.frames import View, inverse, transform
from luxloop.world.traffic.tracked import Category

TYPES: Final[Mapping[Category, str]] = {"car": "Car", "truck": "Truck", "pedestrian": "Pedestrian", "cyclist": "Cyclist"}
OTHER: Final = "Misc"
SEEN: Final = (0.9, 0.5)  # visible shares from which on an object counts as fully visible, and as partly


def lines(labelled: LabelledImage) -> str:
    """One line for each object of an image."""
    return "".join(f"{_line(each, labelled.view)}\n" for each in labelled.objects)


def calibration(view: View) -> str:
    """The calibration file of a camera. view: from the body of the vehicle, which stands for the laser scanner's frame."""
    P = [view.fx, 0.0, view.cx, 0.0, 0.0, view.fy, view.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    eye = [float(row == column) for row in range(3) for column in range(3)]
    still = [float(row == column) for row in range(3) for column in range(4)]
    rows = {**{f"P{k}": P for k in range(4)}, "R0_rect": eye, "Tr_velo_to_cam": _upper(inverse(view.T_world_view)), "Tr_imu_to_velo": still}
    return "".join(f"{name}: {' '.join(f'{value:.12e}' for value in values)}\n" for name, values in rows.items())


def _line(each: TrueObject, view: View) -> str:
    assert each.seen is not None and each.seen.category is not None
    T_camera_world, T = inverse(view.T_world_view), each.boxed.T_world_object
    x, y, z = transform(T_camera_world, T[:3, 3:])[:, 0].tolist()
    ahead = (T_camera_world[:3, :3] @ T[:3, 0]).tolist()
    rotation_y = math.atan2(-ahead[2], ahead[0])
    alpha = math.remainder(rotation_y - math.atan2(x, z), 2 * math.pi)
    occluded = sum(each.seen.visible < share for share in SEEN)
    length, width, height = each.boxed.size_m
    values = [alpha, *each.seen.box, height, width, length, x, y, z, rotation_y]
    name = TYPES.get(each.seen.category, OTHER)
    return f"{name} {1 - each.seen.inside:.2f} {occluded} {' '.join(f'{value:.2f}' for value in values)}"


def _upper(T: Tensor) -> list[float]:
    found: list[float] = T[:3].flatten().tolist()
    return found
