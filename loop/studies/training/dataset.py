"""`luxloop dataset`: labelled scenes from seeds, with keys that a file sets, chooses or draws from ranges; and the joined labels of all
scenes.
"""

import json
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from luxloop.loop.recording.labels import (
    CALIB,
    CATEGORIES,
    COCO,
    FOLDER,
    IMAGE_2,
    IMAGES,
    LABEL_2,
    Labels,
    Layout,
    coco_categories,
    coco_document,
)
from luxloop.loop.recording.manifest import digests
from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.run import run as run_scenario
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import overridden, resolve_paths
from luxloop.loop.studies.campaign import job_scenario
from luxloop.loop.studies.jobs import Job, identity_of, local, run
from luxloop.loop.studies.ranges import Range, parse, with_values
from luxloop.loop.studies.training.scenes import tables
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import PARTS, atomic_write, content, link, output_folder, part_of, reading, writing
from luxloop.world.params import Params
from luxloop.world.plugin import refuse_code
from luxloop.world.validation import parsed_json, read_toml, validate_model

DRAWING = 3  # generator key of a scene's random choices


class DatasetParams(Params):
    """A data set: layout of labels, and the common and random keys of its scenes."""

    labels: Layout = Field("coco", description="layout of the labels")
    masks: bool = Field(False, description="whether to write masks of instances and parts")
    depth: bool = Field(False, description="whether to write the depth of each pixel")
    lux: bool = Field(False, description="whether to write the headlamps' illuminance of each pixel")
    seed: int = Field(0, ge=0, lt=2**31, description="seed of the first scene; further scenes have the following seeds")
    steps: int = Field(1, ge=1, le=1000, description="frames per scene")
    rate_hz: float = Field(1.0, ge=0.1, le=1000, description="frame rate")
    set: dict[str, Any] = Field({}, description="keys of all scenes, written as in a scenario file")
    variants: dict[str, dict[str, Any]] = Field(
        {}, description="named tables of further keys, one of which is drawn for each scene; left out: one variant without changes"
    )
    vary: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        (), description="keys with ranges, from which a number is drawn for each scene: key=low:high, or key=low:high:log"
    )


@dataclass(frozen=True)
class DatasetScene:
    """A scene of a data set. variant: its name, empty without variants. drawn: random numbers from ranges, by key."""

    seed: int
    variant: str
    drawn: Mapping[str, float | int]
    scenario: Scenario

    @property
    def name(self) -> str:
        return f"{self.seed:06d}"


Dataset = tuple[Labels, list[DatasetScene]]


def read(file: Path, number: int, *, allow_code: bool = False) -> Dataset:
    """Labels and first scenes of a data set. allow_code: whether Python modules that its file names may run.

    Raises LuxloopError with the file, the key and the remedy.
    """
    data = read_toml(file)
    with locate(str(file)):
        params = validate_model(DatasetParams, data, "docs/data.md has an example")
        for each in (params.set, *params.variants.values()):
            resolve_paths(each, file.parent)
        first = tuple(_scenario(params, params.seed, variant) for variant in params.variants or [""])
        if not allow_code:
            for scenario in first:
                refuse_code(scenario, scenario.source)
        ranges = tuple(parse(each, first, "vary") for each in params.vary)
        labels = Labels(params.labels, params.masks, params.depth, params.lux)
        return labels, [_scene(params, ranges, params.seed + k) for k in range(number)]


def _scene(params: DatasetParams, ranges: tuple[Range, ...], seed: int) -> DatasetScene:
    rng, names = np.random.default_rng([seed, DRAWING]), [*params.variants] or [""]
    variant = names[int(rng.integers(len(names)))]
    drawn = {each.key: each.draw(rng) for each in ranges}
    scenario = _scenario(params, seed, variant)
    return DatasetScene(seed, variant, drawn, with_values(scenario, drawn) if drawn else scenario)


def _scenario(params: DatasetParams, seed: int, variant: str) -> Scenario:
    name = f"scene {seed}"
    own = {"name": name, "steps": params.steps, "rate_hz": params.rate_hz, "seed": seed, "lighting": {}}
    data = validate({**own, **tables(seed)}, name).model_dump(mode="json")
    with locate(f"variants.{variant}" if variant else "set"):
        return validate(overridden(data, [params.set, params.variants[variant] if variant else {}]), name)


def facts(scene: DatasetScene) -> dict[str, Any]:
    """Facts of a scene in a data set."""
    return {"seed": scene.seed, "variant": scene.variant, "drawn": dict(scene.drawn)}


FILES = ("file_name", "light", "instances", "parts", "depth", "lux")  # files of an image, some of which may be missing
SCENES, TRAINING, ALL_COCO, ALL_IMAGES = "scenes", "training", "coco.json", "images.json"


@dataclass(frozen=True)
class Counts:
    """Contents of a data set. file: joined labels. objects: number of labelled objects by class."""

    file: Path
    scenes: int
    frames: int
    objects: Counter[str]


def join(out: Path, layout: Layout, scenes: Mapping[str, Mapping[str, Any]]) -> Counts:
    """Join the labels of scenes. scenes: facts of each, by the folder below `out`.

    Raises LuxloopError if labels cannot be read, or files cannot be written.
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
    atomic_write(file, coco_document({**head, "scenes": said}, lists))
    return Counts(file, len(scenes), len(images), objects)


def _image(image: Mapping[str, Any], number: int, scene: int, folder: str) -> dict[str, Any]:
    files = {key: f"{folder}/{image[key]}" for key in FILES if key in image}
    return {**image, **files, "id": number, "scene": scene}


def _kitti(out: Path, scenes: Mapping[str, Mapping[str, Any]]) -> Counter[str]:
    """Link all scenes' files, numbered in the order of the images, into common folders; returns the number of objects by type."""
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
    """Temporary folder that replaces `folder` at the end; a failure leaves nothing behind."""
    try:
        with writing(folder, "check the folder and the room left"):
            yield part
            shutil.rmtree(folder, ignore_errors=True)
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


JOBS = "scenes.jsonl"
MADE_FROM = "made_from.txt"  # in a scene's folder: the identity of the job that made it


def make(scenario: Mapping[str, Any], inputs: dict[str, str], labels: Mapping[str, Any], folder: str, identity: str) -> dict[str, Any]:
    """Job: run a scene with labels into a folder, which appears once it is complete.

    inputs: digests of its files. identity: of the job. Raises LuxloopError if the scene cannot run, its files differ on this machine, or
    the folder cannot be written.
    """
    ready, given = job_scenario(scenario, inputs), dict(labels)
    with _whole_folder(Path(folder), part_of(Path(folder))) as part:
        run_scenario(ready, part, device="cpu", video=False, report=False, labels=given.pop("layout"), **given)
        (part / MADE_FROM).write_text(identity)
    return {}


def make_dataset(dataset: Dataset, out: Path, processes: int | None) -> tuple[Counts, dict[str, str]]:
    """Make the scenes that the folder lacks, and join the labels of all; returns contents, and reasons of failures by scene.

    Raises as `luxloop.loop.studies.jobs.run` and `luxloop.world.files.output_folder`, and LuxloopError if the folder holds something else.
    """
    (labels, scenes), version = dataset, digest_of_code()
    jobs = [_job(each, labels, out / SCENES / each.name, version) for each in scenes]
    with output_folder(out):
        _begin(out, jobs)
        results = run(make, jobs, out / JOBS, version=version, executor=local(processes), title="scenes", is_there=_is_there)
        made = [each for each in scenes if each.name not in results.failures]
        counts = join(out, labels.layout, {f"{SCENES}/{each.name}": facts(each) for each in made})
    return counts, results.failures


def _begin(out: Path, jobs: Sequence[Job]) -> None:
    """Make the folders; remove remains of killed workers, and joined labels of scenes that are made again."""
    with writing(out):
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


def _job(scene: DatasetScene, labels: Labels, folder: Path, version: str) -> Job:
    of_it = {"scenario": scene.scenario.model_dump(mode="json"), "inputs": digests(scene.scenario), "labels": asdict(labels)}
    return Job(scene.name, of_it, {"folder": str(folder), "identity": identity_of(make, of_it, version)})


def _is_there(job: Job) -> bool:
    """Whether a scene's folder holds the result of this job, and not of another file or version."""
    file = Path(job.place["folder"]) / MADE_FROM
    return file.is_file() and file.read_bytes() == job.place["identity"].encode()
