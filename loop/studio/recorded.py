"""A recording that a run repeats: values of all its steps, the frames that it kept, and its edits."""

from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch

from loop.plant.frames import TABLE, image_file, read_exposures, read_image
from loop.plant.recorded import inside
from loop.replay.replay import Recording
from loop.scenario.edits import Edit
from loop.studio.snapshot import Pictures, Snapshot, coded_frame
from world.errors import LuxloopError

KEPT: Final = 16  # steps whose frames were read last
AHEAD: Final = "recorded: the curves and, where they were kept, the frames; light and poses follow when this step has been run again"


class Recorded:
    """What a recording knows of steps that are not yet run again. edits: those to come."""

    def __init__(self, folder: Path, recording: Recording) -> None:
        self.edits = deque(recording.edits)
        self._folder, self._table, self._camera = folder, recording.table, recording.scenario.camera
        self._rate_hz, per_step = recording.scenario.rate_hz, len(recording.scenario.shares)
        self._frames = defaultdict[int, dict[str, int]](dict)  # by step, numbers of the frames that came in it
        self._seen = dict[int, Snapshot]()
        if (folder / TABLE).is_file():
            for each in read_exposures(inside(folder / TABLE, folder)):
                if each["came_with"] is not None and not each["lost"]:
                    name = "camera.off" if each["number"] % per_step else "camera.on"
                    self._frames[each["came_with"] // per_step][name] = each["number"]

    def columns(self, known: Sequence[pa.Field]) -> list[pa.Field]:
        """Columns of numbers: those of the simulation, and those that edits have added."""
        names = {each.name for each in known}
        return [*known, *(each for each in self._table.schema if each.name not in names and not pa.types.is_string(each.type))]

    def rows(self, columns: Sequence[pa.Field]) -> list[np.ndarray]:
        """Values of all steps; NaN where there is none."""
        lacks = np.full(self._table.num_rows, np.nan, np.float32)
        there = set(self._table.column_names)
        of_columns = [_numbers(self._table[each.name]) if each.name in there else lacks for each in columns]
        return list(np.stack(of_columns, 1))

    def due(self, step: int) -> Edit | None:
        """The next edit, where it holds from this step on or earlier."""
        return self.edits.popleft() if self.edits and self.edits[0].step <= step else None

    def snapshot(self, step: int, last: Snapshot) -> Snapshot:
        """What was kept of a step. last: the last one that was run again, whose poses it has."""
        if step not in self._seen:
            head = {**last.head, "step": step, "time_s": step / self._rate_hz, "marks": [], "notes": [AHEAD]}
            self._seen = dict([*self._seen.items()][1 - KEPT :]) | {
                step: replace(last, step=step, head=head, lights=(), pictures=self._pictures(step))
            }
        return self._seen[step]

    def _pictures(self, step: int) -> Pictures:
        most, pictures = 2**self._camera.bits - 1, Pictures()
        for name, number in self._frames.get(step, {}).items():
            try:
                frame = read_image(inside(image_file(self._folder, number), self._folder), self._camera, torch.empty(0))
            except LuxloopError:  # a damaged frame is none
                continue
            pictures[name] = coded_frame(frame, most)
        return pictures


def _numbers(column: pa.ChunkedArray) -> np.ndarray:
    values: np.ndarray = pc.cast(column, pa.float64()).to_numpy().astype(np.float32)
    return values
