"""Ground truth of a recording's frames as labels: objects, masks, depth and illuminance at pixels, poses of camera and vehicle."""

import json
import math
from collections.abc import Iterable, Mapping
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
from luxloop.loop.simulation.world import LitScene, TrueObject, World
from luxloop.perception.ground_truth import Box, GroundTruth
from luxloop.world.arrays import write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, link, whole
from luxloop.world.frames import View, inverse, transform
from luxloop.world.scene.body import Figure
from luxloop.world.traffic.tracked import Category

Layout = Literal["coco", "kitti", "yolo"]


@dataclass(frozen=True)
class Labels:
    """Files of labels beside frames.

    masks: of instances and parts. depth, lux: at each pixel. ignore_visible, ignore_height_px: visible share and height below which an
    object counts neither for nor against a detector.
    """

    layout: Layout
    masks: bool = False
    depth: bool = False
    lux: bool = False
    ignore_visible: float = 0.0
    ignore_height_px: float = 0.0

    def ignores(self, seen: GroundTruth) -> bool:
        return seen.visible < self.ignore_visible or seen.box[3] - seen.box[1] < self.ignore_height_px


def choose_labels(layout: Layout | None, **files: bool) -> Labels | None:
    """Labels in a layout; None without a layout. Raises LuxloopError for an unknown layout, and for files without a layout."""
    if layout is None:
        if lonely := [name for name, wanted in files.items() if wanted]:
            raise LuxloopError(f"--{lonely[0]}: is written beside labels; give --labels coco, --labels kitti or --labels yolo as well")
        return None
    if layout not in get_args(Layout):
        raise LuxloopError(f"labels = {layout!r}: is no layout; choose from {', '.join(map(repr, get_args(Layout)))}")
    return Labels(layout, **files)


def _array(values: Tensor, dtype: Any) -> np.ndarray:
    return np.ascontiguousarray(values.detach().cpu().numpy(), dtype)


FOLDER: Final = "labels"
COCO, IMAGES = f"{FOLDER}/coco.json", f"{FOLDER}/images.json"
IMAGE_FILES: Final[dict[Layout, dict[str, str]]] = {  # suffix by folder of the files of each image: the image first, as a hard link
    "coco": {},
    "kitti": {"image_2": "png", "label_2": "txt", "calib": "txt"},
    "yolo": {"images": "png", "labels": "txt"},
}
PATTERNS: Final = {
    FOLDER: ("coco.json", "images.json", "instances_*.png", "parts_*.png", "depth_*.npz", "lux_*.npz"),
    **{f"{FOLDER}/{name}": (f"*.{suffix}",) for each in IMAGE_FILES.values() for name, suffix in each.items()},
}


def frame_name(number: int) -> str:
    """File of an exposure's frame, relative to the recording's folder."""
    return f"{FRAMES}/{image_file(Path(), number).name}"


def label_name(kind: str, number: int) -> str:
    """File of an exposure's mask of instances or parts, or of values at its pixels, relative to the recording's folder."""
    return f"{FOLDER}/{kind}_{number:08d}.{'png' if kind in ('instances', 'parts') else 'npz'}"


class LabelRecorder:
    """Labels the frames of a run: `add` after each step, `write` for the table of all images."""

    def __init__(self, directory: Path, world: World, labels: Labels, frames: FrameRecorder) -> None:
        """frames: the recorder of the labelled frames, to which each step is added first."""
        self._directory, self._world, self._labels, self._frames = directory, world, labels, frames
        bodies = (each.at(0.0) if isinstance(each, Figure) else each for each in world.scene.objects)
        self._parts = tuple(dict.fromkeys(part.name for body in bodies for part in body.parts))
        self._waiting: dict[int, Exposure] = {}  # for their frames
        self._images: list[str] = []
        self._annotations: list[str] = []

    def begin(self) -> None:
        """Make the folders. Raises OSError where a folder cannot be made."""
        for name in ("", *IMAGE_FILES[self._labels.layout]):
            (self._directory / FOLDER / name).mkdir(exist_ok=True)

    def add(self, reception: Reception) -> None:
        """Label the frames that arrived, each with the truth at the start of its exposure. Raises LuxloopError where a file cannot be
        written.
        """
        self._waiting |= {each.number: each for each in reception.exposures}
        for frame in reception.frames:
            exposure = self._waiting.get(frame.number)
            self._waiting = {number: each for number, each in self._waiting.items() if number > frame.number}
            if exposure is not None and frame.image is not None:
                self._label(replace(frame.shown or exposure, number=frame.number))

    def write(self) -> None:
        """Write the table of all images, whole or not at all. Raises LuxloopError where it cannot be written."""
        view = self._world.view
        camera = {name: getattr(view, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
        head: Entry = {
            "camera": {**camera, "T_body_camera": numbers(view.T_world_view)},
            "instances": self._world.instances,
            "parts": ("", *self._parts),
            "categories": coco_categories(),
        }
        lists, file = {"images": self._images}, IMAGES
        if self._labels.layout == "coco":
            lists, file = {**lists, "annotations": self._annotations}, COCO
        atomic_write(self._directory / file, coco_document(head, lists))

    def _label(self, exposure: Exposure) -> None:
        world, number, time_s = self._world, exposure.number, exposure.start_s
        lit = world.lit(time_s)
        objects = [each for each in world.objects_at(time_s) if each.seen is not None]
        instances = _array(lit.surfaces.object_id + 1, np.uint16)
        files = {"file_name": frame_name(number), "light": f"{FRAMES}/{light_file(Path(), self._frames.light_of(number)).name}"}
        if self._labels.masks:
            for kind, mask in (("instances", instances), ("parts", _array(lit.parts(self._parts) + 1, np.uint16))):
                files[kind] = label_name(kind, number)
                atomic_write(self._directory / files[kind], cv2.imencode(".png", mask, QUICK)[1].tobytes())
        lights = exposure.lights, exposure.commands
        values = {"depth": _array(lit.depth, np.float32)} if self._labels.depth else {}
        if self._labels.lux:
            values["lux"] = _array(world.illuminance(time_s, *lights), np.float32)
        for kind, value in values.items():
            files[kind] = label_name(kind, number)
            write_npz(self._directory / files[kind], [(kind, value)])
        self._images.append(json.dumps({"id": number, **files, "time_s": time_s, **coco_poses(lit)}))
        if self._labels.layout == "coco":
            luminance = _array(world.luminance(time_s, *lights)[0], np.float32) if self._labels.lux else None
            for each in objects:
                entry = coco_annotation(number, each, instances, len(self._annotations) + 1, self._labels)
                if luminance is not None:
                    entry |= light_on(each, instances, values["lux"], luminance)
                self._annotations.append(json.dumps(entry))
            return
        text = {
            "label_2": "".join(kitti_line(each, lit.view, self._labels) for each in objects),
            "calib": kitti_calibration(world.view),
            "labels": "".join(yolo_line(each, lit.view) for each in objects if each.seen and not self._labels.ignores(each.seen)),
        }
        for name, suffix in IMAGE_FILES[self._labels.layout].items():
            file = self._directory / FOLDER / name / f"{number:06d}.{suffix}"
            if name in text:
                atomic_write(file, text[name])
            else:
                with whole(file) as part:
                    link(self._directory / frame_name(number), part)


Entry = dict[str, Any]
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)  # numbered from 1 on


def coco_document(head: Mapping[str, Any], lists: Mapping[str, Iterable[str]]) -> str:
    """Text of a COCO file. lists: entries already coded as JSON, one a line."""
    listed = (f',\n"{name}": [\n' + ",\n".join(entries) + "\n]" for name, entries in lists.items())
    return json.dumps(head)[:-1] + "".join(listed) + "}\n"


def coco_categories() -> list[Entry]:
    """All classes that objects can have."""
    return [{"id": number, "name": name, "supercategory": "object"} for number, name in enumerate(CATEGORIES, 1)]


def coco_poses(lit: LitScene) -> Entry:
    """Size of an image, pose of its camera, and motion of the vehicle."""
    vehicle, view = lit.vehicle, lit.view
    scalars = {each.name: getattr(vehicle, each.name) for each in fields(vehicle) if not each.name.startswith("T_")}
    return {
        "width": view.width,
        "height": view.height,
        "T_world_camera": numbers(view.T_world_view),
        "ego": {"T_world_body": numbers(vehicle.T_world_body), "T_world_ground": numbers(vehicle.T_world_ground), **scalars},
    }


def coco_annotation(image: int, each: TrueObject, instances: np.ndarray, number: int, labels: Labels) -> Entry:
    """Entry of a visible object of an image. instances: `[height, width]`, instance at each pixel."""
    assert each.seen is not None and each.seen.category is not None
    return {
        "id": number,
        "image_id": image,
        "category_id": CATEGORIES.index(each.seen.category) + 1,
        "bbox": corner_and_size(each.seen.box),
        "area": each.seen.pixels,
        "iscrowd": int(labels.ignores(each.seen)),
        "segmentation": run_lengths(instances == each.instance),
        "name": each.name,
        "instance": each.instance,
        "visible": each.seen.visible,
        "inside": each.seen.inside,
        "bbox_whole": corner_and_size(each.seen.whole),
        "T_world_object": numbers(each.boxed.T_world_object),
        "size_m": [*each.boxed.size_m],
    }


AROUND: Final = 0.25  # of the box's width and height, to each side


def light_on(each: TrueObject, instances: np.ndarray, lux: np.ndarray, luminance: np.ndarray) -> Entry:
    """Mean illuminance in lx and luminance in cd/m^2 of an object's visible pixels, that of its background, and their Weber contrast.

    The background is the median of the other pixels of the object's box, enlarged by AROUND; None where there are none. The contrast is
    None where the background is dark.
    """
    assert each.seen is not None
    left, top, width, height = corner_and_size(each.seen.box)
    columns, rows = (
        slice(max(math.floor(first - AROUND * size), 0), math.ceil(first + size + AROUND * size))
        for first, size in ((left, width), (top, height))
    )
    own, seen = instances[rows, columns] == each.instance, luminance[rows, columns]
    mean, behind = float(seen[own].mean()), None if own.all() else float(np.median(seen[~own]))
    contrast = (mean - behind) / behind if behind else None
    return {"lux": float(lux[rows, columns][own].mean()), "luminance_cd_m2": mean, "background_cd_m2": behind, "contrast": contrast}


def run_lengths(mask: np.ndarray) -> Entry:
    """COCO's run lengths of a mask `[height, width]` bool: down the columns, beginning with the run outside the mask."""
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
    return T.flatten().tolist()


KITTI: Final = ("car", "truck", "pedestrian", "cyclist")  # classes that KITTI has as well; all others are Misc
SEEN: Final = (0.9, 0.5)  # visible shares from which on an object counts as fully visible, and as partly


def kitti_calibration(view: View) -> str:
    """Text of a camera's calibration file. view: from the vehicle's body, which stands for the frame of KITTI's laser scanner."""
    P = [view.fx, 0.0, view.cx, 0.0, 0.0, view.fy, view.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    rows: dict[str, Iterable[float]] = {
        **{f"P{k}": P for k in range(4)},
        "R0_rect": np.eye(3).ravel(),
        "Tr_velo_to_cam": numbers(inverse(view.T_world_view)[:3]),
        "Tr_imu_to_velo": np.eye(3, 4).ravel(),
    }
    return "".join(f"{name}: {' '.join(f'{value:.12e}' for value in values)}\n" for name, values in rows.items())


def kitti_line(each: TrueObject, view: View, labels: Labels) -> str:
    """KITTI's line of a visible object, DontCare for one that is ignored."""
    assert each.seen is not None and each.seen.category is not None
    if labels.ignores(each.seen):
        return f"DontCare -1 -1 -10 {' '.join(f'{value:.2f}' for value in each.seen.box)} -1 -1 -1 -1000 -1000 -1000 -10\n"
    T_camera_world, T = inverse(view.T_world_view), each.boxed.T_world_object
    x, y, z = transform(T_camera_world, T[:3, 3:])[:, 0].tolist()
    ahead = (T_camera_world[:3, :3] @ T[:3, 0]).tolist()
    rotation_y = math.atan2(-ahead[2], ahead[0])
    alpha = math.remainder(rotation_y - math.atan2(x, z), 2 * math.pi)
    occluded = sum(each.seen.visible < share for share in SEEN)
    length, width, height = each.boxed.size_m
    values = [alpha, *each.seen.box, height, width, length, x, y, z, rotation_y]
    name = each.seen.category.capitalize() if each.seen.category in KITTI else "Misc"
    return f"{name} {1 - each.seen.inside:.2f} {occluded} {' '.join(f'{value:.2f}' for value in values)}\n"


def yolo_line(each: TrueObject, view: View) -> str:
    """YOLO's line of a visible object: class, and centre and size of the box as shares of the image."""
    assert each.seen is not None and each.seen.category is not None
    left, top, width, height = corner_and_size(each.seen.box)
    values = ((left + width / 2) / view.width, (top + height / 2) / view.height, width / view.width, height / view.height)
    return f"{CATEGORIES.index(each.seen.category)} {' '.join(f'{value:.6f}' for value in values)}\n"
