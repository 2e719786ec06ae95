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
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from luxloop.loop.recording.labels import (
    CATEGORIES,
    COCO,
    FOLDER,
    IMAGE_FILES,
    IMAGES,
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
from luxloop.world.files import PARTS, atomic_write, content, installed_version, link, output_folder, part_of, reading, writing
from luxloop.world.params import Params
from luxloop.world.plugin import refuse_code
from luxloop.world.validation import parsed_json, read_toml, validate_model

DRAWING = 3  # generator key of a scene's random choices
Split = Literal["train", "val", "test"]


class SplitParams(Params):
    """Shares of the scenes that are for validation and test; the others are for training."""

    val: float = Field(0.0, ge=0, le=0.9, description="share of the scenes for validation")
    test: float = Field(0.0, ge=0, le=0.9, description="share of the scenes for the test")

    @model_validator(mode="after")
    def _leave_some(self) -> Self:
        if self.val + self.test >= 1:
            raise ValueError("val and test leave no scene for training; give shares with a sum below 1")
        return self


class IgnoreParams(Params):
    """Objects that count neither for nor against a detector."""

    visible: float = Field(0.0, ge=0, le=1, description="visible share below which an object is ignored")
    height_px: float = Field(0.0, ge=0, le=10000, description="height below which an object is ignored, px")


class LicenceParams(Params):
    """Licence of a data set."""

    name: str = Field(description="name of the licence")
    url: str = Field("", description="where it can be read")


class DatasetParams(Params):
    """A data set: layout of labels, and the common and random keys of its scenes."""

    labels: Layout = Field("coco", description="layout of the labels")
    masks: bool = Field(False, description="whether to write masks of instances and parts")
    depth: bool = Field(False, description="whether to write the depth of each pixel")
    lux: bool = Field(False, description="whether to write the headlamps' illuminance of each pixel")
    video: bool = Field(False, description="whether to write a video of each scene")
    split: SplitParams = Field(SplitParams(), description="shares of the scenes for validation and test")
    ignore: IgnoreParams = Field(IgnoreParams(), description="objects that count neither for nor against a detector")
    info: dict[str, str] = Field({}, description="texts about the data set, such as description and contributor")
    licence: LicenceParams | None = Field(None, description="licence of the data set")
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
    """A scene of a data set.

    split: its part of the data set. variant: its name, empty without variants. drawn: random numbers from ranges, by key.
    """

    seed: int
    split: Split
    variant: str
    drawn: Mapping[str, float | int]
    scenario: Scenario

    @property
    def name(self) -> str:
        return f"{self.seed:06d}"


@dataclass(frozen=True)
class Dataset:
    """A data set to make. parts: of its split, "train" alone where it is not split. about: `info` and `licenses` of its COCO files."""

    labels: Labels
    video: bool
    parts: tuple[Split, ...]
    about: Mapping[str, Any]
    scenes: Sequence[DatasetScene]


def read(file: Path, number: int, *, allow_code: bool = False) -> Dataset:
    """A data set with its first scenes. allow_code: whether Python modules that its file names may run.

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
        if params.labels == "yolo" and not params.split.val:
            raise LuxloopError('labels: "yolo" needs scenes for validation; give split = { val = 0.2 } as well')
        files = params.masks, params.depth, params.lux
        labels = Labels(params.labels, *files, params.ignore.visible, params.ignore.height_px)
        parts = tuple(each for each in get_args(Split) if each == "train" or getattr(params.split, each) > 0)
        licences = [{"id": 1, **params.licence.model_dump()}] if params.licence else []
        about = {"info": {"version": f"luxloop {installed_version('luxloop')}", **params.info}, "licenses": licences}
        scenes = [_scene(params, ranges, params.seed + k) for k in range(number)]
        return Dataset(labels, params.video, parts, about, scenes)


def _scene(params: DatasetParams, ranges: tuple[Range, ...], seed: int) -> DatasetScene:
    rng, names = np.random.default_rng([seed, DRAWING]), [*params.variants] or [""]
    variant = names[int(rng.integers(len(names)))]
    drawn = {each.key: each.draw(rng) for each in ranges}
    scenario = _scenario(params, seed, variant)
    share = (seed - params.seed + 0.5) * (5**0.5 - 1) / 2 % 1  # golden ratio: each part has its share of any number of first scenes
    split: Split = "test" if share < params.split.test else "val" if share < params.split.test + params.split.val else "train"
    return DatasetScene(seed, split, variant, drawn, with_values(scenario, drawn) if drawn else scenario)


def _scenario(params: DatasetParams, seed: int, variant: str) -> Scenario:
    name = f"scene {seed}"
    own = {"name": name, "steps": params.steps, "rate_hz": params.rate_hz, "seed": seed, "lighting": {}}
    data = validate({**own, **tables(seed)}, name).model_dump(mode="json")
    with locate(f"variants.{variant}" if variant else "set"):
        return validate(overridden(data, [params.set, params.variants[variant] if variant else {}]), name)


def facts(scene: DatasetScene) -> dict[str, Any]:
    """Facts of a scene in a data set."""
    return {"seed": scene.seed, "split": scene.split, "variant": scene.variant, "drawn": dict(scene.drawn)}


FILES = ("file_name", "light", "instances", "parts", "depth", "lux")  # files of an image, some of which may be missing
SCENES = "scenes"
JOINED: dict[Layout, str] = {"coco": "coco", "kitti": "images", "yolo": "images"}  # names of joined labels


@dataclass(frozen=True)
class Counts:
    """Contents of a data set. files: joined labels. objects: number of labelled objects by class."""

    files: tuple[Path, ...]
    scenes: int
    frames: int
    objects: Counter[str]


def join(out: Path, dataset: Dataset, scenes: Sequence[DatasetScene]) -> Counts:
    """Join the labels of scenes. Raises LuxloopError if labels cannot be read, or files cannot be written."""
    layout, name = dataset.labels.layout, JOINED[dataset.labels.layout]
    by_file = {f"{name}.json": scenes}
    if layout == "coco" and len(dataset.parts) > 1:
        by_file = {f"{name}_{part}.json": [each for each in scenes if each.split == part] for part in dataset.parts}
    files, frames, objects = [out / file for file in by_file], 0, Counter[str]()
    for file, each in zip(files, by_file.values(), strict=True):
        said, lists, found = _join(out, layout, each)
        atomic_write(file, coco_document({**dataset.about, "categories": coco_categories(), "scenes": said}, lists))
        frames, objects = frames + len(lists["images"]), objects + found
    if layout != "coco":
        objects = _link_images(out, dataset, scenes)
    return Counts(tuple(files), len(scenes), frames, objects)


def _join(out: Path, layout: Layout, scenes: Sequence[DatasetScene]) -> tuple[list[dict[str, Any]], dict[str, list[str]], Counter[str]]:
    """Facts of scenes, their images and annotations coded as JSON, and the number of objects by class."""
    said, images, annotations, objects = [], list[str](), list[str](), Counter[str]()
    for number, scene in enumerate(scenes):
        folder = f"{SCENES}/{scene.name}"
        source = out / folder / (COCO if layout == "coco" else IMAGES)
        with reading(source, "no labels of a scene", f"remove {out / folder}, so that the scene is made again"):
            document = parsed_json(content(source))
            said.append({"folder": folder, **facts(scene), **{key: document[key] for key in ("camera", "instances", "parts")}})
            first = {each["id"]: len(images) + k for k, each in enumerate(document["images"])}
            images += [json.dumps(_image(each, first[each["id"]], number, folder)) for each in document["images"]]
            for each in document.get("annotations", ()):
                annotations.append(json.dumps({**each, "id": len(annotations) + 1, "image_id": first[each["image_id"]]}))
                objects[CATEGORIES[each["category_id"] - 1]] += 1
    return said, {"images": images, **({"annotations": annotations} if layout == "coco" else {})}, objects


def _image(image: Mapping[str, Any], number: int, scene: int, folder: str) -> dict[str, Any]:
    files = {key: f"{folder}/{image[key]}" for key in FILES if key in image}
    return {**image, **files, "id": number, "scene": scene}


def _link_images(out: Path, dataset: Dataset, scenes: Sequence[DatasetScene]) -> Counter[str]:
    """Link all images and their files, numbered in the order of the images, into a folder named like the layout, as its programs read it;
    returns the number of objects by class.
    """
    layout, objects, number = dataset.labels.layout, Counter[str](), 0
    kinds, numbers = IMAGE_FILES[layout], dict[Split, str](dict.fromkeys(dataset.parts, ""))
    image, text, *_ = kinds
    with _whole_folder(out / layout, part_of(out / SCENES / layout)) as whole:
        places = {
            (part, name): whole / (f"training/{name}" if layout == "kitti" else f"{name}/{part}") for part in numbers for name in kinds
        }
        for each in places.values():
            each.mkdir(parents=True, exist_ok=True)
        for scene in scenes:
            source = out / SCENES / scene.name / FOLDER
            for stem in sorted(each.stem for each in (source / image).iterdir()):
                for name, suffix in kinds.items():
                    link(source / name / f"{stem}.{suffix}", places[scene.split, name] / f"{number:06d}.{suffix}")
                first = (line.split()[0] for line in (source / text / f"{stem}.txt").read_text().splitlines())
                objects.update(first if layout == "kitti" else (CATEGORIES[int(each)] for each in first))
                numbers[scene.split] += f"{number:06d}\n"
                number += 1
        if layout == "kitti":
            (whole / "ImageSets").mkdir()
            for part, listed in numbers.items():
                (whole / "ImageSets" / f"{part}.txt").write_text(listed)
        else:
            names = "".join(f"  {k}: {name}\n" for k, name in enumerate(CATEGORIES))
            (whole / "data.yaml").write_text("".join(f"{part}: images/{part}\n" for part in numbers) + f"names:\n{names}")
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


def make(
    scenario: Mapping[str, Any], inputs: dict[str, str], labels: Mapping[str, Any], video: bool, folder: str, identity: str
) -> dict[str, Any]:
    """Job: run a scene with labels into a folder, which appears once it is complete.

    inputs: digests of its files. identity: of the job. Raises LuxloopError if the scene cannot run, its files differ on this machine, or
    the folder cannot be written.
    """
    ready = job_scenario(scenario, inputs)
    with _whole_folder(Path(folder), part_of(Path(folder))) as part:
        run_scenario(ready, part, device="cpu", video=video, report=False, labels=Labels(**labels))
        (part / MADE_FROM).write_text(identity)
    return {}


def make_dataset(dataset: Dataset, out: Path, processes: int | None) -> tuple[Counts, dict[str, str]]:
    """Make the scenes that the folder lacks, and join the labels of all; returns contents, and reasons of failures by scene.

    Raises as `luxloop.loop.studies.jobs.run` and `luxloop.world.files.output_folder`, and LuxloopError if the folder holds something else.
    """
    version = digest_of_code()
    jobs = [_job(each, dataset, out / SCENES / each.name, version) for each in dataset.scenes]
    with output_folder(out):
        _begin(out)
        results = run(make, jobs, out / JOBS, version=version, executor=local(processes), title="scenes", is_there=_is_there)
        counts = join(out, dataset, [each for each in dataset.scenes if each.name not in results.failures])
    return counts, results.failures


def _begin(out: Path) -> None:
    """Make the folders; remove remains of killed workers, and joined labels."""
    with writing(out):
        if any(out.iterdir()) and not (out / JOBS).exists():
            raise LuxloopError(f"{out}: holds files that are no data set of luxloop; give an empty or a new folder with --out")
        (out / JOBS).touch()
        (out / SCENES).mkdir(exist_ok=True)
        for part in (out / SCENES).glob(PARTS):
            shutil.rmtree(part, ignore_errors=True)
        for file in out.glob("*.json"):
            file.unlink()
        for layout in get_args(Layout):
            shutil.rmtree(out / layout, ignore_errors=True)


def _job(scene: DatasetScene, dataset: Dataset, folder: Path, version: str) -> Job:
    of_it = {
        "scenario": scene.scenario.model_dump(mode="json"),
        "inputs": digests(scene.scenario),
        "labels": asdict(dataset.labels),
        "video": dataset.video,
    }
    return Job(scene.name, of_it, {"folder": str(folder), "identity": identity_of(make, of_it, version)})


def _is_there(job: Job) -> bool:
    """Whether a scene's folder holds the result of this job, and not of another file or version."""
    file = Path(job.place["folder"]) / MADE_FROM
    return file.is_file() and file.read_bytes() == job.place["identity"].encode()
