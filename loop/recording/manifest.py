"""The manifest of a recording: scenario, machine, versions and input files of a run, written before its first step."""

import datetime
import hashlib
import json
import os
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal

import pyarrow as pa
import pyarrow.parquet as pq
import torch
from pydantic import Field, ValidationError

from luxloop.loop.recording.sources import sources_of
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RecordedPlantParams
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.frames import TABLE
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, content, files_at, installed_version, reading, regular, whole
from luxloop.world.lamps.description import lamp_files
from luxloop.world.lamps.utilisations import sequence_files
from luxloop.world.params import Params
from luxloop.world.plugin import own_names
from luxloop.world.roads.scan import OpenCrgRoad
from luxloop.world.traffic.objects import MeshParams
from luxloop.world.validation import parsed_json, sentences

MANIFEST = "manifest.json"
TRAJECTORY, SUMMARY, REPORT, VIDEO, EDITS = "trajectory.parquet", "summary.json", "report.png", "video.mp4", "edits.json"
RIG = "rig.json"  # of a run on a rig: rig file, and statistics of frames
TWIN, TWIN_PICTURE = "twin.parquet", "twin.png"  # comparison of a rig's frames with simulated ones
BEAM = "beam.png"  # the last light that was digitised live
PIXELS = "pixels.csv"  # gains of the lamps' pixels
PAGES = (REPORT, "report.pdf", "report.svg")  # formats of the report
FILES = (TRAJECTORY, SUMMARY, *PAGES, VIDEO, EDITS, RIG, TWIN, TWIN_PICTURE, BEAM, PIXELS, MANIFEST)
FORMAT_VERSION: Final = 1
PACKAGES = ("luxloop", "torch", "numpy", "scipy", "kornia", "opencv-contrib-python-headless", "pyrender", "trimesh", "embreex", "pyarrow")


class InputFile(Params):
    """An input file of a run."""

    file: str = Field(description="path")
    sha256: str = Field(description="digest of the content, hexadecimal")


class Manifest(Params):
    """Description of a run, written before its first step."""

    format: Literal["luxloop recording"] = Field("luxloop recording", description="tells recordings from other directories")
    format_version: Literal[1] = Field(FORMAT_VERSION, description="version of the recording's files")
    status: Literal["running", "complete", "interrupted", "failed"] = Field(
        "running", description="if still running after the end, the process was killed"
    )
    scenario: dict[str, Any] = Field(description="the scenario with all defaults and --set options")
    scenario_sha256: str = Field(description="digest of the scenario as JSON with sorted keys")
    seed: int = Field(description="seed of all noise")
    inputs: dict[str, InputFile] = Field(description="files beside the scenario, by the key that names them")
    renderer: str = Field(description="source of the G-buffer")
    device: str = Field(description="torch device")
    threads: int = Field(description="threads of torch")
    versions: dict[str, str] = Field(description="of python and packages")
    platform: str = Field(description="operating system and machine")
    started_utc: str = Field(description="start time, ISO 8601")

    @classmethod
    def of(cls, scenario: Scenario, renderer: str, device: torch.device) -> "Manifest":
        """The manifest of a run that starts now. renderer: name of the face source. Raises LuxloopError where an input file is missing."""
        return cls(
            scenario=scenario.model_dump(mode="json"),
            scenario_sha256=scenario.digest,
            seed=scenario.seed,
            inputs={key: InputFile(file=str(file), sha256=sha256(file)) for key, file in input_files(scenario)},
            renderer=renderer,
            device=str(device),
            threads=torch.get_num_threads(),
            versions={"python": platform.python_version(), **{name: installed_version(name) for name in PACKAGES}},
            platform=platform.platform(),
            started_utc=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        )

    @classmethod
    def read(cls, directory: Path) -> "Manifest":
        """The manifest of a recording. Raises LuxloopError where there is none that this luxloop understands."""
        file = directory / MANIFEST
        if not os.path.isfile(file):
            kind = f"holds no recording ({MANIFEST} is missing)" if os.path.isdir(directory) else "is not a directory"
            raise LuxloopError(f"{directory}: {kind}; give a directory that `luxloop run` wrote")
        with reading(file, "damaged, not valid JSON", "record the run again"):
            stored = parsed_json(content(file))
        if not isinstance(stored, dict) or stored.get("format") != cls.model_fields["format"].default:
            raise LuxloopError(f"{file}: not the manifest of a recording; give a directory that `luxloop run` wrote")
        if stored.get("format_version") != FORMAT_VERSION:
            raise LuxloopError(
                f"{file}: format_version: {stored.get('format_version')!r} is not understood, this luxloop reads {FORMAT_VERSION}; "
                "use the luxloop that wrote it"
            )
        try:
            return cls.model_validate(stored)
        except ValidationError as error:
            raise LuxloopError(f"{file}: damaged, {sentences(error, cls, '`luxloop run` writes it')[0]}; record the run again") from error

    def write(self, directory: Path) -> None:
        """Write the manifest to a recording's directory, whole or not at all."""
        write_json(directory / MANIFEST, self.model_dump(mode="json"))

    def finish(self, status: str, directory: Path) -> "Manifest":
        """Write and return the manifest with another status. Raises LuxloopError where it cannot be written."""
        manifest = self.model_copy(update={"status": status})
        manifest.write(directory)
        return manifest

    def fail(self, directory: Path) -> None:
        """Set the status in the manifest's file to failed, in place, since a full disk has no room for another file."""
        here = f'"status": "{self.status}"'.encode()
        with (directory / MANIFEST).open("r+b") as stream:
            stream.seek(stream.read().index(here))
            stream.write(b'"status": "failed"'.ljust(len(here)))

    def changes(self, now: "Manifest") -> Iterator[str]:
        """Changes since the recording, a sentence each. now: manifest of the same scenario today."""
        text = json.dumps(self.scenario, sort_keys=True)
        if hashlib.sha256(text.encode()).hexdigest() != self.scenario_sha256:
            yield "the scenario in the manifest was edited after the recording"
        for key, file in now.inputs.items():
            if key in self.inputs and self.inputs[key].sha256 != file.sha256:
                yield f"{key}: {file.file} has changed since the recording (its SHA-256 differs)"
        for key in ("renderer", "device"):
            if getattr(self, key) != getattr(now, key):
                yield f"{key}: recorded with {getattr(self, key)}, replayed with {getattr(now, key)}"
        for name, version in now.versions.items():
            if self.versions.get(name) != version:
                yield f"{name}: recorded with version {self.versions.get(name)}, replayed with {version}"


def write_json(file: Path, value: Any) -> None:
    """Write JSON, whole or not at all; a number that is not finite is a ValueError. Raises LuxloopError where it cannot be written."""
    atomic_write(file, json.dumps(value, indent=2, allow_nan=False) + "\n")


def input_files(scenario: Scenario) -> Iterator[tuple[str, Path]]:
    """Input files of a run, each after the key that names it: symbols, roads, meshes, lamps with the files of their descriptions,
    detectors, and the user's own modules with the modules that they import.
    """
    if isinstance(scenario.plant, RecordedPlantParams):
        yield "plant.folder", Path(scenario.plant.folder) / TABLE
    for name, function in scenario.functions.items():
        if (image := getattr(function, "image", None)) is not None:
            path = find_file(image, "symbols")
            for file in files_at(path) if os.path.isdir(path) else (path,):
                yield f"functions.{name}.image {file.name}", file
        believed = getattr(getattr(function, "controller", None), "road", None)
        if isinstance(believed, OpenCrgRoad):
            yield f"functions.{name}.controller.road.file", Path(data.locate(believed.file))
    for i, raw in enumerate(scenario.lighting.raw):
        for file in sequence_files(find_file(raw.file, "utilisations")):
            yield f"lighting.raw[{i}].file {file.name}", file
    for key in ("file", "weights"):
        if (given := getattr(scenario.detector, key, None)) is not None:
            yield f"detector.{key}", Path(given)
    if isinstance(scenario.road, OpenCrgRoad):
        yield "road.file", Path(data.locate(scenario.road.file))
    for file in lamp_files(scenario.headlight.model):
        yield f"headlight.model {os.path.relpath(file, Path(scenario.headlight.model).parent)}", file
    for _, part in own_names(scenario):
        yield from ((f"module {name}", file) for name, file in sources_of(part.module, part.folder).items())
    for i, item in enumerate(scenario.objects):
        if isinstance(item, MeshParams):
            yield f"objects[{i}].file", item.file


def digests(scenario: Scenario) -> dict[str, str]:
    """SHA-256 of each of `input_files`, by the key that names it. Raises LuxloopError where one is missing."""
    return {key: sha256(file) for key, file in input_files(scenario)}


def sha256(file: Path) -> str:
    """SHA-256 of a file, hexadecimal. Raises LuxloopError where it cannot be read."""
    with reading(file), regular(file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def table_of(rows: list[dict[str, Any]], schema: pa.Schema) -> pa.Table:
    """Rows as a table; NaN and missing values become null."""
    columns = [pa.array([r.get(field.name) for r in rows], field.type, from_pandas=True) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def write_table(file: Path, table: pa.Table) -> None:
    """Write Parquet, whole or not at all. Raises LuxloopError where it cannot be written."""
    with whole(file) as part:
        pq.write_table(table, part, use_dictionary=False)
