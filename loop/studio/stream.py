"""Messages for one client: its requested contents, each part only after a change."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

from luxloop.loop.studio.messages import PICTURES, Request, View
from luxloop.loop.studio.runs import Run
from luxloop.loop.studio.session import SessionState
from luxloop.loop.studio.shared import Blocks
from luxloop.loop.studio.snapshot import Snapshot
from luxloop.world.headlight import Headlight
from luxloop.world.messages import encode, pack, raw

REST = 4  # rest after messages as a multiple of the time to make them, which takes a fifth of a thread
LONGEST_REST_S = 0.2
MOST_ROWS = 10_000  # in a message
FORGOTTEN = "light and pictures of this step are no longer kept: those of the step shown last are drawn; start anew to see them"
PASSED = "roads and objects of this step that were left long ago are no longer kept"
HALF_PEAK = 1024.0  # peak of a module in units of its half floats, far below their overflow


class Stream:
    """Messages of a session for a client. Used by one thread at a time, but not always the same.

    id: of the newest step. rests_s: by `time.perf_counter`, when the next step of a playing run is due.
    """

    def __init__(self) -> None:
        self._number, self.id, self.rests_s = -1, 0, 0.0
        self._sent, self._blocks = list[RunStream](), Blocks()

    def close(self) -> None:
        """Release the shared memory."""
        self._blocks.close()

    def messages(self, state: SessionState, request: Request) -> Iterator[bytes]:
        """Messages that update the client. While the session plays, rows and steps come at intervals, so that making them takes a small
        share of the time, and a step that lacks wanted contents is skipped, since the next one has them.
        """
        made, spent_s, last = self._newer(state, request), 0.0, self.id
        while True:
            began_s = time.thread_time()  # excludes the time of other threads
            data = next(made, None)
            spent_s += time.thread_time() - began_s
            if data is None:
                break
            yield data
        if self.id != last:
            self.rests_s = time.perf_counter() + min(REST * spent_s, LONGEST_REST_S)

    def _newer(self, state: SessionState, request: Request) -> Iterator[bytes]:
        follows = state.playing and request.at is None
        resting = follows and time.perf_counter() < self.rests_s
        if state.number != self._number and state.scenario is not None:
            self._number = state.number
            self._sent = [RunStream(number, run, self._blocks) for number, run in enumerate(state.runs)]
            yield pack(state.scenario)
        for sent in self._sent:
            rows, done = sent.run.rows, len(sent.run.rows)
            yield from sent.edits()  # first, since they bring the rows' columns
            if resting or (follows and sent.id and not request.wanted <= sent.run.snapshots[-1].views):
                continue
            yield from sent.rows(rows, done)
            run, step = request.at or (sent.number, len(sent.run.snapshots) - 1)
            if run == sent.number and sent.id <= request.shown:
                for data in sent.step(step, request, self.id + 1):
                    self.id = sent.id
                    yield data


class RunStream:
    """Contents of one run that a client has. id: of its newest sent step. blocks: the client's shared memory."""

    def __init__(self, number: int, run: Run, blocks: Blocks) -> None:
        self.number, self.run, self._blocks = number, run, blocks
        self.id = 0
        self._rows, self._rows_of, self._edits, self._meshes = 0, run.rows, 0, set[int]()
        self._step: tuple[Snapshot | None, bool, frozenset[View]] = None, False, frozenset()
        self._pictured: int | None = None  # step of the last sent camera picture
        modules = len(run.simulation.modules)
        self._lights: list[tuple[Headlight, torch.Tensor] | None] = [None] * modules  # as last shown
        self._utilisations: list[torch.Tensor | None] = [None] * modules

    def edits(self) -> Iterator[bytes]:
        """Edits that the client lacks; the newest one has the current model and facts."""
        fresh = self.run.client_edits[self._edits :]
        self._edits += len(fresh)
        for left, edit in zip(range(len(fresh) - 1, -1, -1), fresh, strict=True):
            model = None if left else self.run.simulation.scenario.model_dump(mode="json")
            facts = None if left else self.run.facts()
            yield pack({"type": "edit", "run": self.number, **edit.model_dump(mode="json"), "model": model, "facts": facts})

    def rows(self, rows: list[np.ndarray], done: int) -> Iterator[bytes]:
        """Values of the steps that the client lacks."""
        if rows is not self._rows_of:  # replaced at the end of a repetition
            self._rows, self._rows_of = 0, rows
        while fresh := rows[self._rows : min(self._rows + MOST_ROWS, done)]:
            head = {"type": "rows", "run": self.number, "first": self._rows}
            self._rows += len(fresh)
            values = np.full((len(fresh), max(map(len, fresh))), np.nan, np.float32)
            for k, each in enumerate(fresh):
                values[k, : len(each)] = each
            yield pack(head, {"rows": encode(values)})

    def step(self, number: int, request: Request, id_: int) -> Iterator[bytes]:
        """A step, preceded by the meshes that the client lacks; nothing if the client has all of it."""
        scrubbed, wanted, snapshot = request.at is not None, request.wanted, self.run.at(number)
        before, was_scrubbed, had = self._step
        if before is snapshot and was_scrubbed == scrubbed and wanted <= had:
            return
        self.id, self._step = id_, (snapshot, scrubbed, wanted)
        head = snapshot.head
        there, meshes = {each["mesh"] for each in head["bodies"]}, self.run.meshes.of
        if made := {number: mesh for number in sorted(there - self._meshes) if (mesh := meshes.get(number)) is not None}:
            self._meshes.update(made)
            arrays = {name: encode(each) for _, of_mesh in made.values() for name, each in of_mesh.items()}
            yield pack({"type": "meshes", "run": self.number, "meshes": [head for head, _ in made.values()]}, arrays)
        notes = head["notes"] + ([PASSED] if there - self._meshes else [])
        bodies = [each for each in head["bodies"] if each["mesh"] in self._meshes]
        seen = self.run.with_pictures(snapshot, wanted) if scrubbed or was_scrubbed or before is None else snapshot
        yield self._pack({"id": id_, "scrub": scrubbed, **head, "bodies": bodies, "notes": notes}, snapshot, seen, request)

    def _pack(self, head: dict[str, Any], snapshot: Snapshot, seen: Snapshot, request: Request) -> bytes:
        """Message of a step, with arrays copied for a slow client. seen: snapshot whose pictures are shown."""
        wanted, notes = request.wanted, head["notes"]
        plain, windows, scales = dict[str, np.ndarray](), dict[str, Any](), []
        for k, peak_cd in enumerate(self.run.peaks_cd):
            scales.append(max(peak_cd, 1e-6) / HALF_PEAK)
            if not snapshot.lights:
                continue
            u = snapshot.lights[k]
            if "light" in wanted and (lit := self._lit(k, u, scales[k])) is not None:
                windows[str(k)], plain[f"light.{k}"] = lit
            if "matrix" in wanted and u is not self._utilisations[k]:
                self._utilisations[k] = u
                light = self.run.simulation.modules[k].headlight
                share = (255 * u.clamp(0, 1)).round().byte().view(light.pixel_rows, light.pixel_cols)
                plain[f"u.{k}"] = share.numpy()
        names = {PICTURES[view] for view in wanted & PICTURES.keys()}
        pictures = {name: picture for name, picture in seen.pictures.items() if name in names}
        if names:
            self._pictured = seen.step if pictures else self._pictured
            if self._pictured not in (None, snapshot.step):
                notes = [*notes, f"the camera's picture is that of step {self._pictured}"]
        if not snapshot.lights and snapshot.step < len(self.run.snapshots):
            notes = [*notes, FORGOTTEN]
        exact = pictures | {name: array for name, array in snapshot.exact.items() if name.partition(".")[0] in wanted}
        modules = [{**each, "scale_cd": scale} for each, scale in zip(head["modules"], scales, strict=True)]
        more = {"notes": notes, "light_windows": windows, "modules": modules, "views": sorted(snapshot.views)}
        head = {"type": "step", "run": self.number, **head, **more}
        if request.shared and (shared := self._blocks.put(self.number, head["id"], {**plain, **exact})) is not None:
            return pack({**head, "shared": shared})
        sent = {name: encode(array) for name, array in plain.items()} | {name: raw(array) for name, array in exact.items()}
        return pack(head, sent)

    def _lit(self, k: int, u: torch.Tensor, scale_cd: float) -> tuple[list[int], np.ndarray] | None:
        """Window (first row, end row, first column, end column) of a module's light texture that changed pixels light, and its light in
        units of scale_cd; None without a change.
        """
        light = self.run.shining[k].headlight
        before, self._lights[k] = self._lights[k], (light, u)
        rows, cols = slice(0, light.rows), slice(0, light.cols)
        if before is not None and before[0] is light:  # not another lamp by an edit
            if u is before[1] or u.equal(before[1]):
                return None
            differ = (u != before[1]).view(light.pixel_rows, light.pixel_cols)
            (top, bottom), (left, right) = (_ends(differ.any(axis)) for axis in (1, 0))
            rows, cols = light.rows_of(slice(top * light.pixel_cols, bottom * light.pixel_cols)), light.cols_of(slice(left, right))
        texture = light.light_rows(u.to(light.matrix.values), rows)[:, cols]
        return [rows.start, rows.stop, cols.start, cols.stop], (texture / scale_cd).half().cpu().numpy()


def _ends(true: torch.Tensor) -> tuple[int, int]:
    """First index and end of the true values."""
    found = torch.nonzero(true)[:, 0]
    return int(found[0]), int(found[-1]) + 1
