"""A recording that a run repeats: values of all its steps, its stored frames, and its edits."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from luxloop.loop.recording.frames import frame_numbers, read_frames
from luxloop.loop.recording.replay import Recording
from luxloop.loop.scenario.edits import Edit
from luxloop.loop.studio.snapshot import Pictures, Snapshot, coded_frame, plain

KEPT = 16  # cached steps with frames
AHEAD = "recorded: the curves and, where they were kept, the frames; light and poses follow when this step has been run again"


class Playback:
    """A recording's steps that are not yet repeated. edits: pending ones."""

    def __init__(self, folder: Path, recording: Recording) -> None:
        """Raises LuxloopError if the table of frames is damaged."""
        self.edits = deque(recording.edits)
        self._folder, self._table, self._scenario = folder, recording.table, recording.scenario
        self._numbers, self._seen = frame_numbers(folder, recording.scenario), dict[int, Snapshot]()

    def columns(self, known: Sequence[pa.Field]) -> list[pa.Field]:
        """Columns of numbers: those of the simulation, and those added by edits."""
        names = {each.name for each in known}
        return [*known, *(each for each in self._table.schema if each.name not in names and not pa.types.is_string(each.type))]

    def rows(self, columns: Sequence[pa.Field]) -> list[np.ndarray]:
        """Values of all steps; NaN if missing."""
        lacks, there = np.full(self._table.num_rows, np.nan, np.float32), set(self._table.column_names)
        return list(np.stack([_numbers(self._table[each.name]) if each.name in there else lacks for each in columns], 1))

    def due(self, step: int) -> Edit | None:
        """Next edit up to this step, else None."""
        return self.edits.popleft() if self.edits and self.edits[0].step <= step else None

    def pictures(self, step: int) -> Pictures:
        """Stored frames of a step."""
        camera = self._scenario.camera
        frames = read_frames(self._folder, camera, self._numbers.get(step, {}))
        return {f"camera.{name}": coded_frame(frame, 2**camera.bits - 1) for name, frame in frames.items()}

    def snapshot(self, step: int, last: Snapshot) -> Snapshot:
        """Snapshot of a recorded step. last: snapshot of the last repeated step, for its poses."""
        if step not in self._seen:
            head = {**last.head, "step": step, "time_s": step / self._scenario.rate_hz, "marks": [], "notes": [AHEAD]}
            kept = [*self._seen.items()][1 - KEPT :]
            self._seen = dict([*kept, (step, replace(last, step=step, plain=plain(head), lights=(), pictures=self.pictures(step)))])
        return self._seen[step]


def _numbers(column: pa.ChunkedArray) -> np.ndarray:
    values: np.ndarray = pc.cast(column, pa.float64()).to_numpy().astype(np.float32)
    return values
