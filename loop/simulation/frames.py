"""Recorded frames: a plant's exposures and arrivals, bit for bit, in files that execute no code when read; and the plant that replays them.

A table has a row for each exposure and a last row for the end. Each frame is a grey PNG of 8 bits, or 16 for a camera of more than 8. Each
light is a NumPy archive, which several exposures may share.
"""

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pyarrow as pa
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand, Warp
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RecordedPlantParams
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.remote_messages import read_objects
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import CameraParams
from luxloop.perception.egomotion import VALUES, Sample
from luxloop.world.arrays import Arrays, read_npz, read_parquet
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import atomic_write, content, reading, regular
from luxloop.world.headlight.lamp import Commands, ModuleCommand
from luxloop.world.images import decode
from luxloop.world.params import PLAIN

FOLDER: Final = "frames"
TABLE: Final = f"{FOLDER}/exposures.parquet"
PATTERNS: Final = {FOLDER: ("frame_*.png", "twin_*.png", "light_*.npz", Path(TABLE).name)}  # names of the files of frames
AGAIN: Final = "record the run again with --frames"
QUICK: Final = (cv2.IMWRITE_PNG_COMPRESSION, 1)  # higher levels do not compress noise further
Row = dict[str, Any]

# name: (type, unit, description)
COLUMNS: dict[str, tuple[pa.DataType, str, str]] = {
    "number": (pa.int64(), "1", "number of the exposure; the last row is not an exposure, but the state of the plant at the end"),
    "time_s": (pa.float64(), "s", "when it began"),
    "duration_s": (pa.float64(), "s", "its commanded duration"),
    "light": (pa.int64(), "1", "number of the file with its light"),
    "taken_s": (pa.float64(), "s", "when its frame was taken; empty until the frame arrives"),
    "arrived_s": (pa.float64(), "s", "when the frame arrived"),
    "came_with": (pa.int64(), "1", "number of the exposure by whose end the frame had arrived, or was reported lost"),
    "lost": (pa.bool_(), "", "whether the frame is lost, so that it has no file"),
    "samples": (
        pa.string(),
        "",
        "[sensor, measured_s, arrived_s, values] of each `Sample` that arrived since the previous exposure, as JSON",
    ),
    "objects": (pa.string(), "", "the `TrackedObject`s that the plant told of, as JSON; empty where it told nothing"),
}


def schema_of(columns: Mapping[str, tuple[pa.DataType, str, str]]) -> pa.Schema:
    """Schema of a table, whose metadata tell unit and description."""
    return pa.schema(pa.field(name, kind, metadata={"unit": unit, "description": text}) for name, (kind, unit, text) in columns.items())


SCHEMA = schema_of(COLUMNS)


def image_file(directory: Path, number: int) -> Path:
    """Path of the frame of an exposure."""
    return directory / FOLDER / f"frame_{number:08d}.png"


def twin_file(directory: Path, number: int) -> Path:
    """Path of the simulated frame of a rig's exposure."""
    return directory / FOLDER / f"twin_{number:08d}.png"


def light_file(directory: Path, number: int) -> Path:
    """Path of a light's archive."""
    return directory / FOLDER / f"light_{number:08d}.npz"


def write_image(file: Path, image: Tensor, bits: int) -> None:
    """Write a frame of digital numbers `[height, width]` of this bit depth. Raises LuxloopError for other values or a write error."""
    numbers = image.clamp(0, 2**bits - 1).round()
    if not numbers.equal(image):
        raise LuxloopError(
            f"{file}: cannot be stored, as the frame has values other than digital numbers of 0 to {2**bits - 1}; check the plant with "
            "luxloop.check_plant"
        )
    coded = cv2.imencode(".png", numbers.cpu().numpy().astype(np.uint8 if bits <= 8 else np.uint16), QUICK)[1]
    atomic_write(file, coded.tobytes())


def read_image(file: Path, camera: CameraParams, like: Tensor) -> Tensor:
    """Digital numbers `[height, width]` in the dtype and on the device of like. Raises LuxloopError for a frame of another camera."""
    with reading(file, "damaged, or no frame of a recording", AGAIN):
        image = decode(content(file), str(file))
        bits = 8 if camera.bits <= 8 else 16
        if image is None or image.dtype != f"uint{bits}" or image.ndim != 2:
            raise ValueError(f"no grey PNG of {bits} bits")
        if image.shape != (camera.height_px, camera.width_px):
            size = f"{image.shape[1]} x {image.shape[0]}"
            raise LuxloopError(
                f"{file}: has {size} px, but the camera {camera.width_px} x {camera.height_px}; run it with the scenario recorded"
            )
        if (most := image.max()) >= 2**camera.bits:
            raise LuxloopError(f"{file}: has numbers up to {most}, but camera.bits = {camera.bits}; run it with the scenario recorded")
        return torch.from_numpy(image.astype(np.int32)).to(like)


def light_arrays(exposure: Exposure) -> Arrays:
    """Lights, commands and projections of an exposure as arrays by name."""
    arrays: dict[str, Tensor | None] = {}
    if exposure.commands:
        arrays["commands"] = torch.tensor([astuple(each) for each in exposure.commands], dtype=torch.float64)
    for k, light in enumerate(exposure.lights):
        band = None if light.band is None else torch.tensor([light.band.start, light.band.stop], dtype=torch.float64)
        arrays |= {f"u_{k}": light.u, f"band_{k}": band}
    for name, projection in exposure.projections.items():
        of_it = {"pose": projection.pose, "z": projection.z, "shape": projection.shape, "aim": projection.aim}
        of_it |= {f"raw_{k}": u for k, u in enumerate(projection.raw or ())}
        if (warp := projection.warp) is not None:
            of_it |= {"source": warp.source, "dimming": warp.dimming, "size_m": torch.tensor(warp.size_m, dtype=torch.float64)}
        arrays |= {f"{name}.{key}": value for key, value in of_it.items()}
    return {name: each.detach().cpu().numpy() for name, each in arrays.items() if each is not None}


def read_light(
    file: Path, pixels: Sequence[int], device: torch.device
) -> tuple[tuple[Utilisation, ...], dict[str, ProjectionCommand], Commands]:
    """Lights, projections by symbol, and commands. pixels: number in each module. device: of lights and projections.

    Raises LuxloopError for a damaged file or the light of other modules.
    """
    with reading(file, "damaged, or no light of a recording", AGAIN):
        arrays = read_npz(regular(file))
        if [arrays[f"u_{k}"].shape for k in range(len(arrays)) if f"u_{k}" in arrays] != [(n,) for n in pixels]:
            raise LuxloopError(f"{file}: holds the light of other modules than those that draw here; run it with the scenario recorded")
        lights = []
        for k, n in enumerate(pixels):
            u, band = _tensor(arrays, f"u_{k}", device, (n,)), _optional(arrays, f"band_{k}", device, (2,))
            if u.min() < 0 or u.max() > 1 or (band is not None and not 0 <= band[0] <= band[1] <= n):
                raise ValueError(f"u_{k} is no utilisation")
            lights.append(Utilisation(u, None if band is None else slice(int(band[0]), int(band[1]))))
        turns = _optional(arrays, "commands", torch.device("cpu"), (len(pixels), 3))
        commands = () if turns is None else tuple(ModuleCommand(*each) for each in turns.tolist())
        if not all(0 <= each.intensity <= 1 for each in commands):
            raise ValueError("commands hold an intensity that is no share")
        names = [key.removesuffix(".pose") for key in arrays if key.endswith(".pose")]
        if strange := [name for name in names if not re.fullmatch(PLAIN, name)]:
            raise ValueError(f"{strange[0]!r} is no name of a symbol")
        return tuple(lights), {name: _projection(arrays, name, pixels, device) for name in names}, commands


def sample_values(samples: Sequence[Sample]) -> str:
    """Samples of the vehicle's sensors as JSON for a row."""
    return json.dumps([[each.sensor, each.measured_s, each.arrived_s, each.values.tolist()] for each in samples])


def read_samples(row: Mapping[str, Any], like: Tensor) -> tuple[Sample, ...]:
    """Samples of a row in the dtype and on the device of like. Raises ValueError, TypeError or KeyError for invalid samples."""
    samples = tuple(Sample(sensor, at_s, by_s, like.new_tensor(values)) for sensor, at_s, by_s, values in json.loads(row["samples"]))
    for each in samples:
        if each.values.shape != (VALUES[each.sensor] or len(each.values),) or not each.values.isfinite().all():
            raise ValueError(f"a sample of {each.sensor} has no such values")
        if not math.isfinite(each.measured_s) or not math.isfinite(each.arrived_s):
            raise ValueError(f"a sample of {each.sensor} has no times")
    return samples


def read_exposures(file: Path) -> list[Row]:
    """Rows of a table of exposures, including the last row for the end. Raises LuxloopError if it is missing, damaged or empty."""
    with reading(file, "damaged, or no table of exposures", AGAIN):
        rows: list[Row] = read_parquet(file).select(SCHEMA.names).cast(SCHEMA).to_pylist()
        if len(rows) < 2 or [row["number"] for row in rows] != list(range(len(rows))):
            raise ValueError("no exposures that are numbered from 0")
        for row in rows[:-1]:
            came = [row[key] is not None for key in ("came_with", "lost")]
            if any(row[key] is None for key in ("duration_s", "light")) or len(set(came)) > 1 or row["light"] < 0:
                raise ValueError(f"exposure {row['number']} is not complete")
            if row["lost"] is False and (row["taken_s"] is None or row["arrived_s"] is None):
                raise ValueError(f"the frame of exposure {row['number']} has no times")
        for row in rows:
            if row["time_s"] is None or row["samples"] is None:
                raise ValueError(f"time or samples of exposure {row['number']} are not complete")
            read_samples(row, torch.empty(0))
            read_objects(row["objects"])
        return rows


def _tensor(arrays: Arrays, name: str, device: torch.device, shape: tuple[int, ...]) -> Tensor:
    """An array as a tensor. Raises ValueError for another shape or dtype or values not finite, KeyError for a missing array."""
    array = arrays[name]
    if array.shape != shape or array.dtype not in (np.float32, np.float64) or not np.isfinite(array).all():
        raise ValueError(f"{name} is no finite float {list(shape)}, but {array.dtype} {list(array.shape)}")
    return torch.from_numpy(array).to(device)


def _optional(arrays: Arrays, name: str, device: torch.device, shape: tuple[int, ...]) -> Tensor | None:
    return _tensor(arrays, name, device, shape) if name in arrays else None


def _projection(arrays: Arrays, name: str, pixels: Sequence[int], device: torch.device) -> ProjectionCommand:
    own = {key.removeprefix(f"{name}."): value for key, value in arrays.items() if key.startswith(f"{name}.")}
    raw = [_tensor(own, key, device, own[key].shape) for k in range(len(pixels)) if (key := f"raw_{k}") in own]
    if any(u.shape not in [(n,) for n in pixels] for u in raw):
        raise ValueError(f"the utilisations of {name} are of none of the modules")
    z, shape, aim = (_optional(own, key, device, size) for key, size in (("z", ()), ("shape", (4,)), ("aim", (2,))))
    return ProjectionCommand(_tensor(own, "pose", device, (4,)), z, _warp(own, len(pixels), device), tuple(raw) or None, shape, aim)


def _warp(arrays: Arrays, modules: int, device: torch.device) -> Warp | None:
    if "source" not in arrays:
        return None
    m, _, *cells = arrays["source"].shape
    if m not in (1, modules) or len(cells) != 2:
        raise ValueError(f"source is no [modules, 2, rows, columns], but {list(arrays['source'].shape)}")
    along, across = _tensor(arrays, "size_m", device, (2,)).tolist()
    return Warp(_tensor(arrays, "source", device, (m, 2, *cells)), _tensor(arrays, "dimming", device, (m, *cells)), (along, across))


@dataclass(frozen=True, eq=False)
class RecordedPlant:
    """Replays frames without the truth. State: number of the next exposure.

    rows: of the exposures, with a last row for the end. per_step: exposures in a control step. pixels: number in each module. like:
    tensor with the dtype and device of frames.
    """

    folder: Path
    rows: tuple[Row, ...]
    per_step: int
    camera: CameraParams
    pixels: tuple[int, ...]
    like: Tensor

    def start(self) -> tuple[int, Arrivals]:
        """State and recorded arrivals before the first exposure."""
        return 0, self._arrivals(0)

    def show(self, state: int, exposure: Exposure) -> tuple[int, Arrivals]:
        """State and recorded arrivals after an exposure. Raises LuxloopError for a missing or damaged file, and after the last exposure."""
        if state + 1 >= len(self.rows):
            raise LuxloopError(f"{self.folder}: ends after {state // self.per_step} steps; lower steps")
        return state + 1, self._arrivals(state + 1, tuple(self._frame(row) for row in self.rows if row["came_with"] == state))

    def _arrivals(self, number: int, frames: tuple[Frame, ...] = ()) -> Arrivals:
        row = self.rows[number]
        return Arrivals(row["time_s"], frames, read_samples(row, self.like), read_objects(row["objects"]))

    def _frame(self, row: Mapping[str, Any]) -> Frame:
        number = row["number"]
        light = read_light(inside(light_file(self.folder, row["light"]), self.folder), self.pixels, self.like.device)
        shown = Exposure(number, row["time_s"], row["duration_s"], *light)
        if row["lost"]:
            return Frame(number, float("nan"), float("nan"), None, shown)
        image = read_image(inside(image_file(self.folder, number), self.folder), self.camera, self.like)
        return Frame(number, row["taken_s"], row["arrived_s"], image, shown)


def recorded_plant(scenario: Scenario, params: RecordedPlantParams, modules: Sequence[LampModule]) -> RecordedPlant:
    """The recording named by a scenario. Raises LuxloopError if frames are missing or too few, or symbols or exposure
    durations differ.
    """
    folder, per_step, rows = Path(params.folder), len(scenario.shares), recorded_rows(Path(params.folder))
    pixels, like = tuple(module.headlight.n_pixels for module in modules), modules[0].headlight.matrix.values
    if len(rows) > per_step:
        lights = [read_light(inside(light_file(folder, row["light"]), folder), pixels, like.device) for row in (rows[0], rows[-2])]
        if scenario.symbols and not (held := lights[0][1].keys() - lights[-1][1].keys()) & set(scenario.symbols):
            shown = ", ".join(sorted(held)) or "none"
            raise LuxloopError(
                f"plant.folder: {folder} shows none of the symbols that are held here, {', '.join(scenario.symbols)}, but {shown}; "
                "run it with the scenario that was recorded"
            )
        given_s, shown_s = rows[0]["duration_s"], scenario.shares[0] / scenario.rate_hz
        if not math.isclose(given_s, shown_s):
            raise LuxloopError(
                f"plant.folder: {folder} has exposures of {1e3 * given_s:.4g} ms, but those of this scenario take {1e3 * shown_s:.4g} ms; "
                "run it with the scenario that was recorded"
            )
    steps = (len(rows) - 1) // per_step
    if scenario.steps > steps:
        raise LuxloopError(f"plant.folder: {folder} holds {steps} steps, but steps = {scenario.steps}; give --steps {steps} at most")
    return RecordedPlant(folder, rows, per_step, scenario.camera, pixels, like)


def recorded_rows(folder: Path) -> tuple[Row, ...]:
    """Rows of a recording's exposures, with a last row for the end. Raises LuxloopError if there are none."""
    table = inside(folder / TABLE, folder)
    if not os.path.isfile(table):
        lacks = "holds no frames" if os.path.isdir(folder) else "does not exist, or is no folder"
        raise LuxloopError(
            f"plant.folder: {folder} {lacks}; record frames with `luxloop run --frames` (a plant of your own: --set plant.kind=NAME)"
        )
    return tuple(read_exposures(table))


def to_the_end(scenario: Scenario) -> Scenario:
    """The scenario, limited to the steps of its recording. Raises LuxloopError as `recorded_rows`."""
    if not isinstance(scenario.plant, RecordedPlantParams):
        return scenario
    with locate(scenario.source):
        steps = (len(recorded_rows(Path(scenario.plant.folder))) - 1) // len(scenario.shares)
    return scenario.model_copy(update={"steps": max(min(scenario.steps, steps), 1)})


def inside(file: Path, folder: Path) -> Path:
    """A recording's file. Raises LuxloopError for a link to another file."""
    if file.resolve() != folder.resolve() / file.relative_to(folder):
        raise LuxloopError(f"{file}: is a link, but a recording holds its own files; copy what it links to in its place")
    return file
