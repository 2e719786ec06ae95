"""Frames of a run: what its plant was shown and what that handed over, kept in the recording's folder."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from luxloop.loop.simulation.frames import (
    FOLDER,
    SCHEMA,
    TABLE,
    Row,
    image_file,
    light_arrays,
    light_file,
    sample_values,
    write_image,
    write_light,
)
from luxloop.loop.simulation.objects import object_values
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame, Showing
from luxloop.world.arrays import Arrays
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

    def add(self, showings: Sequence[Showing]) -> None:
        """Write light and frames. Raises LuxloopError where that cannot be, or a frame is none of digital numbers."""
        for showing in showings:
            exposure = showing.exposure
            self._note(exposure.number, showing.before)
            self._rows[exposure.number] |= {"time_s": exposure.start_s, "duration_s": exposure.duration_s, "light": self._light(exposure)}
            self._note(exposure.number + 1, showing.after)
            for frame in showing.after.frames:
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
