"""Labels in the layout of COCO: images, categories and annotations, with masks as run lengths."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any, Final, get_args

import numpy as np
from torch import Tensor

from luxloop.loop.recording.labelled import LabelledImage
from luxloop.perception.ground_truth import Box
from luxloop.world.frames import View
from luxloop.world.traffic.tracked import Category

Entry = dict[str, Any]
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)  # numbered from 1 on


def document(head: Mapping[str, Any], lists: Mapping[str, Iterable[str]]) -> str:
    """A file's text. lists: their entries, coded already, each on a line of its own."""
    listed = (f',\n"{name}": [\n' + ",\n".join(entries) + "\n]" for name, entries in lists.items())
    return json.dumps(head)[:-1] + "".join(listed) + "}\n"


def categories() -> list[Entry]:
    """All classes that objects can have."""
    return [{"id": number, "name": name, "supercategory": "object"} for number, name in enumerate(CATEGORIES, 1)]


def camera(view: View) -> Entry:
    """Calibration of a camera. view: from the body of the vehicle."""
    of_it = {name: getattr(view, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return {**of_it, "T_body_camera": numbers(view.T_world_view)}


def image(labelled: LabelledImage, files: dict[str, str]) -> Entry:
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


def annotations(labelled: LabelledImage, first: int) -> Iterator[Entry]:
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
