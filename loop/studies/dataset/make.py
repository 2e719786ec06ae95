"""`luxloop dataset`: make the scenes that are missing, each whole or not at all, and join their labels."""

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from luxloop.loop.recording.labels import Labels
from luxloop.loop.recording.manifest import digests
from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.run import run as run_scenario
from luxloop.loop.studies.campaign import checked
from luxloop.loop.studies.dataset.drawn import Dataset, DrawnScene, facts
from luxloop.loop.studies.dataset.joined import SCENES, Counts, join, unjoin
from luxloop.loop.studies.jobs.executors import local
from luxloop.loop.studies.jobs.runner import Job, identity_of, run
from luxloop.world.errors import LuxloopError
from luxloop.world.files import PARTS, output_folder

JOBS: Final = "scenes.jsonl"
MADE_FROM: Final = "made_from.txt"  # in a scene's folder: the identity of the job that made it


def make(scenario: Mapping[str, Any], inputs: dict[str, str], labels: Mapping[str, Any], folder: str, identity: str) -> dict[str, Any]:
    """A job: run a scene with labels into a folder, which appears when it is complete. inputs: digests of its files. identity: of the job.

    Raises LuxloopError if the scene cannot run, its files differ on this machine, or the folder cannot be written.
    """
    ready, given = checked(scenario, inputs), dict(labels)
    target = Path(folder)
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        run_scenario(ready, part, device="cpu", video=False, report=False, labels=given.pop("layout"), **given)
        (part / MADE_FROM).write_text(identity)
        shutil.rmtree(target, ignore_errors=True)
        part.rename(target)
    finally:
        shutil.rmtree(part, ignore_errors=True)
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
            unjoin(out)
    except OSError as error:
        raise LuxloopError(f"{out}: cannot be written ({error.strerror}); give another folder with --out") from error


def _job(scene: DrawnScene, labels: Labels, folder: Path, version: str) -> Job:
    of_it = {"scenario": scene.scenario.model_dump(mode="json"), "inputs": digests(scene.scenario), "labels": asdict(labels)}
    return Job(scene.name, of_it, {"folder": str(folder), "identity": identity_of(make, of_it, version)})


def _is_there(job: Job) -> bool:
    """Whether the scene's folder holds what the job makes, rather than nothing or what another file or version had made."""
    file = Path(job.place["folder"]) / MADE_FROM
    return file.is_file() and file.read_bytes() == job.place["identity"].encode()
