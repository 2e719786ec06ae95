"""One file of labels for all scenes of a data set, or one set of folders in the layout of KITTI."""

import json
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from luxloop.loop.recording.label_recorder import CATEGORIES, coco_categories, coco_document
from luxloop.loop.recording.labels import CALIB, COCO, FOLDER, IMAGE_2, IMAGES, LABEL_2, Layout
from luxloop.world.errors import LuxloopError
from luxloop.world.files import content, link, part_of, reading, whole
from luxloop.world.validation import parsed_json

FILES: Final = ("file_name", "light", "instances", "parts", "depth", "lux")  # of an image, which may not have all
SCENES, TRAINING, ALL_COCO, ALL_IMAGES = "scenes", "training", "coco.json", "images.json"


@dataclass(frozen=True)
class Counts:
    """What a data set holds. file: what to begin with. objects: that are labelled, by class."""

    file: Path
    scenes: int
    frames: int
    objects: Counter[str]


def join(out: Path, layout: Layout, scenes: Mapping[str, Mapping[str, Any]]) -> Counts:
    """Join the labels of scenes, which lie in folders of `out` by these names, with what is said of each.

    Raises LuxloopError where the labels of a scene cannot be read, and where files cannot be written.
    """
    said, images, annotations, objects = [], list[str](), list[str](), Counter[str]()
    for number, (name, facts) in enumerate(scenes.items()):
        source = out / name / (COCO if layout == "coco" else IMAGES)
        with reading(source, "no labels of a scene", f"remove {out / name}, so that the scene is made again"):
            document = parsed_json(content(source))
            said.append({"folder": name, **facts, **{key: document[key] for key in ("camera", "instances", "parts")}})
            first = {each["id"]: len(images) + k for k, each in enumerate(document["images"])}
            images += [json.dumps(_image(each, first[each["id"]], number, name)) for each in document["images"]]
            for each in document.get("annotations", ()):
                annotations.append(json.dumps({**each, "id": len(annotations) + 1, "image_id": first[each["image_id"]]}))
                objects[CATEGORIES[each["category_id"] - 1]] += 1
    if layout == "kitti":
        objects = _kitti(out, scenes)
        file, head, lists = out / ALL_IMAGES, {}, {"images": images}
    else:
        file, head, lists = out / ALL_COCO, {"categories": coco_categories()}, {"images": images, "annotations": annotations}
    with whole(file) as part:
        part.write_text(coco_document({**head, "scenes": said}, lists), "utf-8")
    return Counts(file, len(scenes), len(images), objects)


def unjoin(out: Path) -> None:
    """Remove the joined labels. Raises OSError where that cannot be."""
    for name in (ALL_COCO, ALL_IMAGES):
        (out / name).unlink(missing_ok=True)
    if (out / TRAINING).exists():
        shutil.rmtree(out / TRAINING)


def _image(image: Mapping[str, Any], number: int, scene: int, folder: str) -> dict[str, Any]:
    files = {key: f"{folder}/{image[key]}" for key in FILES if key in image}
    return {**image, **files, "id": number, "scene": scene}


def _kitti(out: Path, scenes: Mapping[str, Mapping[str, Any]]) -> Counter[str]:
    """Folders of all scenes' files, numbered on in the order of the images; returns the number of objects by type."""
    objects, number = Counter[str](), 0
    with _whole_folder(out / TRAINING) as part:
        for name in (IMAGE_2, LABEL_2, CALIB):
            (part / Path(name).relative_to(FOLDER)).mkdir(parents=True)
        for scene in scenes:
            for image in sorted((out / scene / IMAGE_2).glob("*.png")):
                for name, suffix in ((IMAGE_2, "png"), (LABEL_2, "txt"), (CALIB, "txt")):
                    source = out / scene / name / f"{image.stem}.{suffix}"
                    link(source, part / Path(name).relative_to(FOLDER) / f"{number:06d}.{suffix}")
                labels = (out / scene / LABEL_2 / f"{image.stem}.txt").read_text()
                objects.update(line.split()[0] for line in labels.splitlines())
                number += 1
    return objects


@contextmanager
def _whole_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder among the scenes, which replaces `folder` at the end; on failure nothing is left behind."""
    part = part_of(folder.parent / SCENES / folder.name)
    try:
        yield part
        shutil.rmtree(folder, ignore_errors=True)
        part.rename(folder)
    except OSError as error:
        raise LuxloopError(f"{folder}: cannot be written ({error.strerror}); check the folder and the room left") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
