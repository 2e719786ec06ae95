"""What is true of a frame: objects, masks, depth and illuminance at its pixels, poses of camera and vehicle."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np
from torch import Tensor

from luxloop.loop.simulation.frames import FOLDER as FRAMES
from luxloop.loop.simulation.frames import image_file, light_file
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.world import TrueObject, World
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import View
from luxloop.world.scene.body import Figure
from luxloop.world.scene.vehicle import VehicleState

Layout = Literal["coco", "kitti"]


@dataclass(frozen=True)
class Labels:
    """What is written beside frames. masks: of instances and parts. depth, lux: at each pixel."""

    layout: Layout
    masks: bool = False
    depth: bool = False
    lux: bool = False

    @classmethod
    def asked(cls, layout: Layout | None, **files: bool) -> "Labels | None":
        """None where no layout is asked for. Raises LuxloopError where files are, all the same, and for a layout that is none."""
        if layout is None:
            if lonely := [name for name, wanted in files.items() if wanted]:
                raise LuxloopError(f"--{lonely[0]}: is written beside labels; give --labels coco or --labels kitti as well")
            return None
        if layout not in get_args(Layout):
            raise LuxloopError(f"labels = {layout!r}: is no layout; choose from {' and '.join(map(repr, get_args(Layout)))}")
        return cls(layout, **files)

    def of(self, world: World | None, plant: str) -> World:
        """The world that tells the truth. Raises LuxloopError where the plant does not know it."""
        if world is None:
            raise LuxloopError(
                f'--labels {self.layout}: the plant {plant!r} does not know what is true; set plant.kind = "simulated", or leave it out'
            )
        return world


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """What is true of a frame at the beginning of its exposure.

    number: of the exposure. view: of the camera. objects: those of a class of which a pixel is seen at least. instances: `[height, width]`
    uint16, number among the instances of the world. parts: `[height, width]` uint16, number among the names of parts; depth: float32 m
    along the camera's axis, 0 where nothing is; lux: float32, of the lamps alone; all None where they are not wanted.
    """

    number: int
    time_s: float
    view: View
    vehicle: VehicleState
    objects: tuple[TrueObject, ...]
    instances: np.ndarray
    parts: np.ndarray | None
    depth: np.ndarray | None
    lux: np.ndarray | None

    @classmethod
    def of(cls, world: World, exposure: Exposure, labels: Labels, parts: Sequence[str]) -> "LabelledImage":
        """Of an exposure. parts: names of parts, from number 1 on."""
        time_s = exposure.start_s
        lit = world.lit(time_s)
        return cls(
            exposure.number,
            time_s,
            lit.view,
            lit.vehicle,
            tuple(each for each in world.objects_at(time_s) if each.seen is not None),
            _array(lit.surfaces.object_id + 1, np.uint16),
            _array(lit.parts(parts) + 1, np.uint16) if labels.masks else None,
            _array(lit.depth, np.float32) if labels.depth else None,
            _array(world.illuminance(time_s, exposure.lights, exposure.commands), np.float32) if labels.lux else None,
        )


def part_names(world: World) -> tuple[str, ...]:
    """Names of the parts of all objects, each once."""
    bodies = (each.at(0.0) if isinstance(each, Figure) else each for each in world.scene.objects)
    return tuple(dict.fromkeys(part.name for body in bodies for part in body.parts))


def _array(values: Tensor, dtype: Any) -> np.ndarray:
    array: np.ndarray = np.ascontiguousarray(values.detach().cpu().numpy(), dtype)
    return array


FOLDER: Final = "labels"
COCO, IMAGES = f"{FOLDER}/coco.json", f"{FOLDER}/images.json"
IMAGE_2, LABEL_2, CALIB = (f"{FOLDER}/{name}" for name in ("image_2", "label_2", "calib"))
PATTERNS: Final = {
    FOLDER: ("coco.json", "images.json", "instances_*.png", "parts_*.png", "depth_*.npz", "lux_*.npz"),
    IMAGE_2: ("*.png",),
    LABEL_2: ("*.txt",),
    CALIB: ("*.txt",),
}


def frame_name(number: int) -> str:
    """The frame of an exposure, from the recording's folder on."""
    return f"{FRAMES}/{image_file(Path(), number).name}"


def light_name(number: int) -> str:
    """A light, from the recording's folder on."""
    return f"{FRAMES}/{light_file(Path(), number).name}"


def mask_name(kind: str, number: int) -> str:
    """A mask of the instances or parts of an exposure's frame, from the recording's folder on."""
    return f"{FOLDER}/{kind}_{number:08d}.png"


def values_name(kind: str, number: int) -> str:
    """Values at the pixels of an exposure's frame, depth or lux, from the recording's folder on."""
    return f"{FOLDER}/{kind}_{number:08d}.npz"
