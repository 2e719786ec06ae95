"""Labels of a recording's frames, which say what is true: objects, masks, depth and illuminance at pixels, poses of camera and vehicle."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, Literal, get_args

import cv2
import numpy as np
from torch import Tensor

from luxloop.loop.recording.frames import FrameRecorder
from luxloop.loop.simulation.frames import FOLDER as FRAMES
from luxloop.loop.simulation.frames import QUICK, image_file, light_file
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.result import Reception
from luxloop.loop.simulation.world import TrueObject, World
from luxloop.perception.ground_truth import Box
from luxloop.world.arrays import write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, link, whole
from luxloop.world.frames import View, inverse, transform
from luxloop.world.scene.body import Figure
from luxloop.world.scene.vehicle import VehicleState
from luxloop.world.traffic.tracked import Category

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


def label_name(kind: str, number: int) -> str:
    """A mask of the instances or parts of an exposure's frame, or values at its pixels, from the recording's folder on."""
    return f"{FOLDER}/{kind}_{number:08d}.{'png' if kind in ('instances', 'parts') else 'npz'}"


class LabelRecorder:
    """Labels the frames of a run; `add` what was shown in a step, `write` the table of all now and then."""

    def __init__(self, directory: Path, world: World, labels: Labels, frames: FrameRecorder) -> None:
        """frames: which keeps the frames that are labelled, and is given each step before."""
        self._directory, self._world, self._labels, self._frames = directory, world, labels, frames
        self._parts = part_names(world)
        self._waiting: dict[int, Exposure] = {}  # for their frames
        self._images: list[str] = []
        self._annotations: list[str] = []

    def begin(self) -> None:
        """Make the folders. Raises OSError where that cannot be."""
        for name in (FOLDER, *((IMAGE_2, LABEL_2, CALIB) if self._labels.layout == "kitti" else ())):
            (self._directory / name).mkdir(exist_ok=True)

    def add(self, reception: Reception) -> None:
        """Label the frames that have come, each with what was true when it was exposed. Raises LuxloopError where that cannot be."""
        self._waiting |= {each.number: each for each in reception.exposures}
        for frame in reception.frames:
            exposure = self._waiting.get(frame.number)
            self._waiting = {number: each for number, each in self._waiting.items() if number > frame.number}
            if exposure is not None and frame.image is not None:
                shown = replace(frame.shown or exposure, number=frame.number)
                self._keep(LabelledImage.of(self._world, shown, self._labels, self._parts))

    def write(self) -> None:
        """Write what is known of all images, whole or not at all. Raises LuxloopError where that cannot be."""
        names = {"instances": self._world.instances, "parts": ("", *self._parts)}
        head: Entry = {"camera": coco_camera(self._world.view), **names}
        lists, file = {"images": self._images}, IMAGES
        if self._labels.layout == "coco":
            head["categories"] = coco_categories()
            lists, file = {**lists, "annotations": self._annotations}, COCO
        atomic_write(self._directory / file, coco_document(head, lists))

    def _keep(self, labelled: LabelledImage) -> None:
        number = labelled.number
        files = {"file_name": frame_name(number), "light": f"{FRAMES}/{light_file(Path(), self._frames.light_of(number)).name}"}
        if labelled.parts is not None:
            for kind, mask in (("instances", labelled.instances), ("parts", labelled.parts)):
                files[kind] = label_name(kind, number)
                atomic_write(self._directory / files[kind], cv2.imencode(".png", mask, QUICK)[1].tobytes())
        for kind, values in (("depth", labelled.depth), ("lux", labelled.lux)):
            if values is not None:
                files[kind] = label_name(kind, number)
                with whole(self._directory / files[kind]) as part:
                    write_npz(part, [(kind, values)])
        self._images.append(json.dumps(coco_image(labelled, files)))
        if self._labels.layout == "kitti":
            self._write_kitti(labelled)
        else:
            self._annotations += map(json.dumps, coco_annotations(labelled, len(self._annotations) + 1))

    def _write_kitti(self, labelled: LabelledImage) -> None:
        name = f"{labelled.number:06d}"
        with whole(self._directory / IMAGE_2 / f"{name}.png") as part:
            link(self._directory / frame_name(labelled.number), part)
        for folder, text in (
            (LABEL_2, "".join(kitti_line(each, labelled.view) for each in labelled.objects)),
            (CALIB, kitti_calibration(self._world.view)),
        ):
            atomic_write(self._directory / folder / f"{name}.txt", text)


Entry = dict[str, Any]
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)  # numbered from 1 on


def coco_document(head: Mapping[str, Any], lists: Mapping[str, Iterable[str]]) -> str:
    """A file's text. lists: their entries, coded already, each on a line of its own."""
    listed = (f',\n"{name}": [\n' + ",\n".join(entries) + "\n]" for name, entries in lists.items())
    return json.dumps(head)[:-1] + "".join(listed) + "}\n"


def coco_categories() -> list[Entry]:
    """All classes that objects can have."""
    return [{"id": number, "name": name, "supercategory": "object"} for number, name in enumerate(CATEGORIES, 1)]


def coco_camera(view: View) -> Entry:
    """Calibration of a camera. view: from the body of the vehicle."""
    of_it = {name: getattr(view, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return {**of_it, "T_body_camera": numbers(view.T_world_view)}


def coco_image(labelled: LabelledImage, files: dict[str, str]) -> Entry:
    """An image's entry. files: that belong to it, by what they hold."""
    vehicle, view = labelled.vehicle, labelled.view
    scalars = {each.name: getattr(vehicle, each.name) for each in fields(vehicle) if not each.name.startswith("T_")}
    return {
        "id": labelled.number,
        **files,
        "width": view.width,
        "height": view.height,
        "time_s": labelled.time_s,
        "T_world_camera": numbers(view.T_world_view),
        "ego": {"T_world_body": numbers(vehicle.T_world_body), "T_world_ground": numbers(vehicle.T_world_ground), **scalars},
    }


def coco_annotations(labelled: LabelledImage, first: int) -> Iterator[Entry]:
    """The entries of all objects of an image, numbered from first on."""
    for number, each in enumerate(labelled.objects, first):
        assert each.seen is not None and each.seen.category is not None
        yield {
            "id": number,
            "image_id": labelled.number,
            "category_id": CATEGORIES.index(each.seen.category) + 1,
            "bbox": corner_and_size(each.seen.box),
            "area": each.seen.pixels,
            "iscrowd": 0,
            "segmentation": run_lengths(labelled.instances == each.instance),
            "name": each.name,
            "instance": each.instance,
            "visible": each.seen.visible,
            "inside": each.seen.inside,
            "bbox_whole": corner_and_size(each.seen.whole),
            "T_world_object": numbers(each.boxed.T_world_object),
            "size_m": [*each.boxed.size_m],
        }


def run_lengths(mask: np.ndarray) -> Entry:
    """A mask `[height, width]` bool as COCO's run lengths: down the columns, the first run outside the mask."""
    flat = mask.T.ravel()
    ends = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    counts = np.diff([0, *ends, flat.size]).tolist()
    return {"size": [*mask.shape], "counts": [0, *counts] if flat[0] else counts}


def corner_and_size(box: Box) -> list[float]:
    """Left, top, width and height of a box of left, top, right and bottom."""
    left, top, right, bottom = box
    return [left, top, right - left, bottom - top]


def numbers(T: Tensor) -> list[float]:
    """A pose as 16 numbers, row by row."""
    found: list[float] = T.flatten().tolist()
    return found


TYPES: Final[Mapping[Category, str]] = {"car": "Car", "truck": "Truck", "pedestrian": "Pedestrian", "cyclist": "Cyclist"}

SEEN: Final = (0.9, 0.5)  # visible shares from which on an object counts as fully visible, and as partly


def kitti_calibration(view: View) -> str:
    """The calibration file of a camera. view: from the body of the vehicle, which stands for the laser scanner's frame."""
    P = [view.fx, 0.0, view.cx, 0.0, 0.0, view.fy, view.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    eye = [float(row == column) for row in range(3) for column in range(3)]
    still = [float(row == column) for row in range(3) for column in range(4)]
    rows = {
        **{f"P{k}": P for k in range(4)},
        "R0_rect": eye,
        "Tr_velo_to_cam": numbers(inverse(view.T_world_view)[:3]),
        "Tr_imu_to_velo": still,
    }
    return "".join(f"{name}: {' '.join(f'{value:.12e}' for value in values)}\n" for name, values in rows.items())


def kitti_line(each: TrueObject, view: View) -> str:
    """The line of an object of an image."""
    assert each.seen is not None and each.seen.category is not None
    T_camera_world, T = inverse(view.T_world_view), each.boxed.T_world_object
    x, y, z = transform(T_camera_world, T[:3, 3:])[:, 0].tolist()
    ahead = (T_camera_world[:3, :3] @ T[:3, 0]).tolist()
    rotation_y = math.atan2(-ahead[2], ahead[0])
    alpha = math.remainder(rotation_y - math.atan2(x, z), 2 * math.pi)
    occluded = sum(each.seen.visible < share for share in SEEN)
    length, width, height = each.boxed.size_m
    values = [alpha, *each.seen.box, height, width, length, x, y, z, rotation_y]
    name = TYPES.get(each.seen.category, "Misc")
    return f"{name} {1 - each.seen.inside:.2f} {occluded} {' '.join(f'{value:.2f}' for value in values)}\n"
