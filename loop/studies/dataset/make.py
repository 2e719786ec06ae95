"""`luxloop dataset`: make the scenes that are missing, each whole or not at all, and join their labels."""

import json
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from luxloop.loop.recording.label_recorder import CATEGORIES, coco_categories, coco_document
from luxloop.loop.recording.labels import CALIB, COCO, FOLDER, IMAGE_2, IMAGES, LABEL_2, Labels, Layout
from luxloop.loop.recording.manifest import digests
from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.run import run as run_scenario
from luxloop.loop.studies.campaign import job_scenario
from luxloop.loop.studies.dataset.scenes import Dataset, DatasetScene, facts
from luxloop.loop.studies.jobs.executors import local
from luxloop.loop.studies.jobs.runner import Job, identity_of, run
from luxloop.world.errors import LuxloopError
from luxloop.world.files import PARTS, content, link, output_folder, part_of, reading, whole
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
    for number, (name, of_scene) in enumerate(scenes.items()):
        source = out / name / (COCO if layout == "coco" else IMAGES)
        with reading(source, "no labels of a scene", f"remove {out / name}, so that the scene is made again"):
            document = parsed_json(content(source))
            said.append({"folder": name, **of_scene, **{key: document[key] for key in ("camera", "instances", "parts")}})
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


def _image(image: Mapping[str, Any], number: int, scene: int, folder: str) -> dict[str, Any]:
    files = {key: f"{folder}/{image[key]}" for key in FILES if key in image}
    return {**image, **files, "id": number, "scene": scene}


def _kitti(out: Path, scenes: Mapping[str, Mapping[str, Any]]) -> Counter[str]:
    """Folders of all scenes' files, numbered on in the order of the images; returns the number of objects by type."""
    objects, number = Counter[str](), 0
    with _whole_folder(out / TRAINING, part_of(out / SCENES / TRAINING)) as part:
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
def _whole_folder(folder: Path, part: Path) -> Iterator[Path]:
    """A temporary folder, which replaces `folder` at the end; on failure nothing is left behind."""
    try:
        yield part
        shutil.rmtree(folder, ignore_errors=True)
        part.rename(folder)
    except OSError as error:
        raise LuxloopError(f"{folder}: cannot be written ({error.strerror}); check the folder and the room left") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


JOBS: Final = "scenes.jsonl"
MADE_FROM: Final = "made_from.txt"  # in a scene's folder: the identity of the job that made it


def make(scenario: Mapping[str, Any], inputs: dict[str, str], labels: Mapping[str, Any], folder: str, identity: str) -> dict[str, Any]:
    """A job: run a scene with labels into a folder, which appears when it is complete. inputs: digests of its files. identity: of the job.

    Raises LuxloopError if the scene cannot run, its files differ on this machine, or the folder cannot be written.
    """
    ready, given = job_scenario(scenario, inputs), dict(labels)
    with _whole_folder(Path(folder), part_of(Path(folder))) as part:
        run_scenario(ready, part, device="cpu", video=False, report=False, labels=given.pop("layout"), **given)
        (part / MADE_FROM).write_text(identity)
    return {}


def make_dataset(dataset: Dataset, out: Path, processes: int | None) -> tuple[Counts, dict[str, str]]:
    """Make the scenes that the folder does not have yet, and join the labels of all; returns numbers, and reasons of failures by scene.

    Raises what `luxloop.loop.studies.jobs.runner.run` and `luxloop.world.files.output_folder` raise, and LuxloopError where the folder
    holds something else.
    """
    executor, version = local(processes), digest_of_code()
    jobs = [_job(each, dataset.labels, out / SCENES / each.name, version) for each in dataset.scenes]
    with output_folder(out):
        _begin(out, jobs)
        results = run(make, jobs, out / JOBS, version=version, executor=executor, title="scenes", is_there=_is_there)
        made = [each for each in dataset.scenes if each.name not in results.failures]
        counts = join(out, dataset.labels.layout, {f"{SCENES}/{each.name}": facts(each) for each in made})
    return counts, results.failures


def _begin(out: Path, jobs: Sequence[Job]) -> None:
    """Make the folders, and remove what workers left that were killed, and joined labels of scenes that are made again."""
    try:
        if any(out.iterdir()) and not (out / JOBS).exists():
            raise LuxloopError(f"{out}: holds files that are no data set of luxloop; give an empty or a new folder with --out")
        (out / JOBS).touch()
        (out / SCENES).mkdir(exist_ok=True)
        for part in (out / SCENES).glob(PARTS):
            shutil.rmtree(part, ignore_errors=True)
        if any(Path(job.place["folder"]).exists() and not _is_there(job) for job in jobs):
            for name in (ALL_COCO, ALL_IMAGES):
                (out / name).unlink(missing_ok=True)
            if (out / TRAINING).exists():
                shutil.rmtree(out / TRAINING)
    except OSError as error:
        raise LuxloopError(f"{out}: cannot be written ({error.strerror}); give another folder with --out") from error


def _job(scene: DatasetScene, labels: Labels, folder: Path, version: str) -> Job:
    of_it = {"scenario": scene.scenario.model_dump(mode="json"), "inputs": digests(scene.scenario), "labels": asdict(labels)}
    return Job(scene.name, of_it, {"folder": str(folder), "identity": identity_of(make, of_it, version)})


def _is_there(job: Job) -> bool:
    """Whether the scene's folder holds what the job makes, rather than nothing or what another file or version had made."""
    file = Path(job.place["folder"]) / MADE_FROM
    return file.is_file() and file.read_bytes() == job.place["identity"].encode()
