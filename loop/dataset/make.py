"""`luxloop dataset`: make the scenes that are missing, each whole or not at all, and join their labels."""

import os
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from loop.dataset.drawn import Dataset, facts
from loop.dataset.joined import SCENES, Counts, join
from loop.jobs.executors import local
from loop.jobs.runner import Job, run
from loop.recording.digest import digest_of_code
from loop.recording.manifest import digests
from loop.run import run as run_scenario
from loop.studies.campaign import checked
from world.files import PARTS
from world.folders import output_folder

JOBS: Final = "scenes.jsonl"


def make(scenario: Mapping[str, Any], inputs: dict[str, str], labels: Mapping[str, Any], folder: str) -> dict[str, Any]:
    """A job: run a scene with labels into a folder, which appears when it is complete. inputs: digests of its files.

    Raises LuxloopError if the scene cannot run, its files differ on this machine, or the folder cannot be written.
    """
    ready, given = checked(scenario, inputs), dict(labels)
    target = Path(folder)
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        run_scenario(ready, part, device="cpu", video=False, report=False, labels=given.pop("layout"), **given)
        shutil.rmtree(target, ignore_errors=True)
        part.rename(target)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return {}


def make_dataset(dataset: Dataset, out: Path, processes: int | None) -> tuple[Counts, dict[str, str]]:
    """Make the scenes that the folder does not have yet, and join the labels of all; returns numbers, and reasons of failures by scene.

    Raises what `loop.jobs.runner.run` and `world.folders.output_folder` raise, and LuxloopError where a scene is gone that was made.
    """
    executor = local(processes)
    with output_folder(out):
        (out / SCENES).mkdir(exist_ok=True)
        for part in (out / SCENES).glob(PARTS):  # of workers that were killed
            shutil.rmtree(part, ignore_errors=True)
        jobs = [
            Job(
                each.name,
                {
                    "scenario": each.scenario.model_dump(mode="json"),
                    "inputs": digests(each.scenario),
                    "labels": asdict(dataset.labels),
                    "folder": str(out / SCENES / each.name),
                },
            )
            for each in dataset.scenes
        ]
        results = run(make, jobs, out / JOBS, version=digest_of_code(), executor=executor, title="scenes")
        made = [each for each in dataset.scenes if each.name not in results.failures]
        counts = join(out, dataset.labels.layout, {f"{SCENES}/{each.name}": facts(each) for each in made})
    return counts, results.failures
