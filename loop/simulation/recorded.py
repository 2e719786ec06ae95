"""A recording as a plant: it replays recorded frames, regardless of the commanded light."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RecordedPlantParams
from luxloop.loop.simulation.frames import TABLE, Row, image_file, light_file, read_exposures, read_image, read_light, read_samples
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.remote_messages import read_objects
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError, locate


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
        lights = [read_light(inside(light_file(folder, row["light"]), folder), pixels, like.device) for row in rows[:per_step]]
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
