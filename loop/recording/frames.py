"""Frames of a run: what its plant was shown and what that handed over, kept in the recording's folder."""

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.frames import (
    FOLDER,
    SCHEMA,
    TABLE,
    Row,
    image_file,
    light_arrays,
    light_file,
    read_exposures,
    read_image,
    sample_values,
    write_image,
    write_light,
)
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.recorded import inside
from luxloop.loop.simulation.remote_messages import object_values
from luxloop.loop.simulation.result import Reception
from luxloop.world.arrays import Arrays
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole


class FrameRecorder:
    """Keeps frames, light and sensor samples of a run in a directory; `add` what was shown in a step, `write` the table now and then."""

    def __init__(self, directory: Path, bits: int) -> None:
        """bits: of a digital number."""
        self._directory, self._bits = directory, bits
        self._rows: dict[int, Row] = {}
        self._lights: dict[int, Arrays] = {}  # the two used last, with the symbol and without it, which exposures may share
        self._following = 0  # number of the next light

    def begin(self) -> None:
        """Make the folder. Raises OSError where that cannot be."""
        (self._directory / FOLDER).mkdir(exist_ok=True)

    def add(self, reception: Reception) -> None:
        """Write light and frames. Raises LuxloopError where that cannot be, or a frame is none of digital numbers."""
        for exposure, before, after in zip(reception.exposures, reception.arrivals, reception.arrivals[1:], strict=False):
            self._note(exposure.number, before)
            self._rows[exposure.number] |= {"time_s": exposure.start_s, "duration_s": exposure.duration_s, "light": self._light(exposure)}
            self._note(exposure.number + 1, after)
            for frame in after.frames:
                if frame.number <= exposure.number and frame.number in self._rows:
                    self._frame(frame, exposure.number)

    def light_of(self, number: int) -> int:
        """The number of the light of an exposure that was added."""
        found: int = self._rows[number]["light"]
        return found

    def write(self) -> None:
        """Write the table, whole or not at all. Raises LuxloopError where that cannot be."""
        with whole(self._directory / TABLE) as part:
            pq.write_table(pa.Table.from_pylist([self._rows[number] for number in sorted(self._rows)], SCHEMA), part)

    def _note(self, number: int, arrivals: Arrivals) -> None:
        told = {"samples": sample_values(arrivals.samples), "objects": object_values(arrivals.objects)}
        self._rows[number] = {"number": number, "time_s": arrivals.time_s} | told

    def _frame(self, frame: Frame, came_with: int) -> None:
        times = {key: None if math.isnan(value) else value for key, value in (("taken_s", frame.taken_s), ("arrived_s", frame.arrived_s))}
        self._rows[frame.number] |= {**times, "came_with": came_with, "lost": frame.image is None}
        if frame.image is not None:
            write_image(image_file(self._directory, frame.number), frame.image, self._bits)
        if frame.shown is not None:
            self._rows[frame.number]["light"] = self._light(frame.shown)

    def _light(self, exposure: Exposure) -> int:
        """The number of its light, which is written where it is a new one."""
        arrays = light_arrays(exposure)
        number = next((known for known, light in self._lights.items() if _same(light, arrays)), self._following)
        if number == self._following:
            write_light(light_file(self._directory, number), arrays)
            self._following += 1
        self._lights = dict([*((known, light) for known, light in self._lights.items() if known != number)][-1:]) | {number: arrays}
        return number


def _same(light: Arrays, other: Arrays) -> bool:
    return light.keys() == other.keys() and all(np.array_equal(light[name], other[name]) for name in light)


Lights = tuple[Utilisation, ...]


class ShadowTally:
    """Compares the lights of exposures with those that were shown in their place; `add` what was shown in a step."""

    def __init__(self) -> None:
        self._asked = dict[int, Lights]()
        self._shares = list[float]()

    def add(self, reception: Reception) -> None:
        """Take exposures, and the frames that have come."""
        self._asked |= {each.number: each.lights for each in reception.exposures}
        for frame in reception.frames:
            lights = self._asked.pop(frame.number, None)
            if lights is not None and frame.shown is not None:
                self._shares.append(elsewhere(lights, frame.shown.lights))

    def summary(self) -> dict[str, Any]:
        """`exposures`: number compared. `differ`: number of those with other light. `elsewhere`: mean of `elsewhere` over all, None without
        any.
        """
        count = len(self._shares)
        return {
            "exposures": count,
            "differ": sum(share > 0 for share in self._shares),
            "elsewhere": sum(self._shares) / count if count else None,
        }


def elsewhere(asked: Lights, shown: Lights) -> float:
    """Sum over all pixels of the difference of utilisations, relative to the sum of both: 0 for the same light, 1 where none overlaps."""
    pairs = list(zip(asked, shown, strict=True))
    both = sum(float((a.u + b.u).sum()) for a, b in pairs)
    return sum(float((a.u - b.u).abs().sum()) for a, b in pairs) / both if both else 0.0


class KeptFrames:
    """Those of a folder, in which there may be none."""

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        """scenario: that was recorded. Raises LuxloopError where the table of frames is damaged."""
        self._folder, self._camera, per_step = folder, scenario.camera, len(scenario.shares)
        self._numbers = defaultdict[int, dict[str, int]](dict)
        for each in read_exposures(inside(folder / TABLE, folder)) if (folder / TABLE).is_file() else ():
            if each["came_with"] is not None and not each["lost"]:
                self._numbers[each["came_with"] // per_step]["off" if each["number"] % per_step else "on"] = each["number"]

    def at(self, step: int) -> dict[str, Tensor]:
        """Digital numbers `[height, width]` of the newest frames `on` and `off` that came in a step; without those that are damaged."""
        found = {}
        for name, number in self._numbers.get(step, {}).items():
            try:
                found[name] = read_image(inside(image_file(self._folder, number), self._folder), self._camera, torch.empty(0))
            except LuxloopError:
                continue
        return found
