"""Frames of a run in the recording's folder: light of each exposure, camera images and sensor samples."""

import math
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch import Tensor

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.frames import (
    FOLDER,
    SCHEMA,
    TABLE,
    Row,
    image_file,
    inside,
    light_arrays,
    light_file,
    read_exposures,
    read_image,
    sample_values,
    write_image,
)
from luxloop.loop.simulation.lamps import Lights
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.remote_messages import object_values
from luxloop.loop.simulation.result import Reception
from luxloop.perception.camera import CameraParams
from luxloop.world.arrays import Arrays, write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole


class FrameRecorder:
    """Records frames, light and sensor samples of a run in a directory: `add` after each step, `write` for the table."""

    def __init__(self, directory: Path, bits: int) -> None:
        """bits: of the camera's digital numbers."""
        self._directory, self._bits = directory, bits
        self._rows: dict[int, Row] = {}
        self._lights: dict[int, Arrays] = {}  # the last two, with the symbol and without it, which exposures may share
        self._following = 0  # number of the next light

    def begin(self) -> None:
        """Make the folder. Raises OSError where it cannot be made."""
        (self._directory / FOLDER).mkdir(exist_ok=True)

    def add(self, reception: Reception) -> None:
        """Write light and frames. Raises LuxloopError where a file cannot be written, or a frame has values that are no digital numbers."""
        for exposure, before, after in zip(reception.exposures, reception.arrivals, reception.arrivals[1:], strict=False):
            self._note(exposure.number, before)
            self._rows[exposure.number] |= {"time_s": exposure.start_s, "duration_s": exposure.duration_s, "light": self._light(exposure)}
            self._note(exposure.number + 1, after)
            for frame in after.frames:
                if frame.number <= exposure.number and frame.number in self._rows:
                    self._frame(frame, exposure.number)

    def light_of(self, number: int) -> int:
        """Number of an exposure's light."""
        return int(self._rows[number]["light"])

    def write(self) -> None:
        """Write the table, whole or not at all. Raises LuxloopError where it cannot be written."""
        with whole(self._directory / TABLE) as part:
            pq.write_table(pa.Table.from_pylist([self._rows[number] for number in sorted(self._rows)], SCHEMA), part)

    def _note(self, number: int, arrivals: Arrivals) -> None:
        samples, objects = sample_values(arrivals.samples), object_values(arrivals.objects)
        self._rows[number] = {"number": number, "time_s": arrivals.time_s, "samples": samples, "objects": objects}

    def _frame(self, frame: Frame, came_with: int) -> None:
        times = {key: None if math.isnan(value := getattr(frame, key)) else value for key in ("taken_s", "arrived_s")}
        self._rows[frame.number] |= {**times, "came_with": came_with, "lost": frame.image is None}
        if frame.image is not None:
            write_image(image_file(self._directory, frame.number), frame.image, self._bits)
        if frame.shown is not None:
            self._rows[frame.number]["light"] = self._light(frame.shown)

    def _light(self, exposure: Exposure) -> int:
        """Number of an exposure's light; a new light is written."""
        arrays = light_arrays(exposure)
        same = (
            known
            for known, light in self._lights.items()
            if light.keys() == arrays.keys() and all(np.array_equal(light[name], arrays[name]) for name in light)
        )
        number = next(same, self._following)
        if number == self._following:
            write_npz(light_file(self._directory, number), arrays.items())
            self._following += 1
        self._lights = dict([*((known, light) for known, light in self._lights.items() if known != number)][-1:]) | {number: arrays}
        return number


def elsewhere(own: Lights, shown: Lights) -> float:
    """Difference of two lights: sum of the absolute differences of utilisations, relative to the sum of both lights; 0 for equal lights, 1
    without overlap.
    """
    pairs = list(zip(own, shown, strict=True))
    both = sum(float((a.u + b.u).sum()) for a, b in pairs)
    return sum(float((a.u - b.u).abs().sum()) for a, b in pairs) / both if both else 0.0


def frame_numbers(folder: Path, scenario: Scenario) -> Mapping[int, Mapping[str, int]]:
    """Numbers of the newest frames `on` and `off` that arrived in a step, by step; empty for a recording without frames.

    scenario: of the recording. Raises LuxloopError where the table of frames is damaged.
    """
    per_step, found = len(scenario.shares), defaultdict[int, dict[str, int]](dict)
    for each in read_exposures(inside(folder / TABLE, folder)) if (folder / TABLE).is_file() else ():
        if each["came_with"] is not None and not each["lost"]:
            found[each["came_with"] // per_step]["off" if each["number"] % per_step else "on"] = each["number"]
    return found


def read_frames(folder: Path, camera: CameraParams, numbers: Mapping[str, int]) -> dict[str, Tensor]:
    """Digital numbers `[height, width]` of frames by name; damaged frames are left out. numbers: of the exposures."""
    found = {}
    for name, number in numbers.items():
        with suppress(LuxloopError):
            found[name] = read_image(inside(image_file(folder, number), folder), camera, torch.empty(0))
    return found
