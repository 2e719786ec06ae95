"""Sources of runs, and what a client may open and change: values, but no code and no files without `--allow-code`."""

import re
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from luxloop.loop.studio.messages import Compare, Open
from luxloop.world.errors import LuxloopError

if TYPE_CHECKING:
    from luxloop.loop.recording.replay import Recording
    from luxloop.loop.scenario.model import Scenario

RUNS = Path("runs")  # the folder in which recordings are made and found
MOST = 200  # newest recordings in the choices
FILES = ("file", "folder", "image", "model", "weights")  # keys that may name a file


@dataclass(frozen=True)
class Source:
    """Source of a run: a scenario by name or path with overrides, or the folder of a recording."""

    name: str
    overrides: tuple[str, ...] = ()
    recording: Path | None = None
    apart: tuple[str, ...] = ()  # overrides that the run beside it lacks

    @property
    def all(self) -> tuple[str, ...]:
        """All overrides."""
        return (*self.overrides, *self.apart)

    @property
    def label(self) -> str:
        """Label for the page."""
        return " ".join(self.apart) or self.name or str(self.recording)

    @property
    def file(self) -> Path | None:
        """File of a user's own scenario."""
        from luxloop.loop.scenario.shipped import find, scenario_files

        return None if self.recording or self.name in scenario_files() else find(self.name)

    def load(self, allow_code: bool) -> tuple["Scenario", "Recording | None"]:
        """Scenario, and the recording that it comes from. Raises LuxloopError."""
        from luxloop.loop.recording import replay
        from luxloop.loop.scenario.model import load, validate
        from luxloop.loop.scenario.overrides import overridden

        if self.recording is None:
            return load(self.name, self.all, allow_code=allow_code), None
        recording = replay.load(self.recording)
        steps = {"steps": max(recording.table.num_rows, 1)}
        scenario = validate(overridden(recording.scenario.model_dump(mode="json"), [steps, *self.all]), str(self.recording))
        if not allow_code:
            replay.refuse_recorded_code(self.recording, scenario, recording.edits)
        return scenario, recording


@dataclass
class ScenarioFile:
    """File of a scenario, watched for changes; path: None without a file. scenario: as last loaded."""

    path: Path | None = None
    scenario: "Scenario | None" = None

    def __post_init__(self) -> None:
        self._stamp = self._now()

    def poll(self) -> bool:
        """Whether the file has changed since the last poll."""
        before, self._stamp = self._stamp, self._now()
        return self._stamp is not None and self._stamp != before

    def _now(self) -> tuple[int, int] | None:
        try:
            stat = None if self.path is None else self.path.stat()
        except OSError:  # while an editor replaces it
            return None
        return stat and (stat.st_mtime_ns, stat.st_size)


def open_source(message: Open | Compare, given: Sequence[Source], recordings: Collection[str], allow_code: bool) -> Source:
    """Source named by a client: a shipped scenario, a listed recording, or a source given to the server.

    Raises LuxloopError for others.
    """
    from luxloop.loop.scenario.shipped import scenario_files

    name = message.name if isinstance(message, Open) else ""
    recording = None if message.recording is None else Path(message.recording)
    known = any((each.name, each.recording) == (name, recording) for each in given)
    if not (allow_code or known or (message.recording in recordings if recording else name in scenario_files())):
        raise LuxloopError(
            f"{recording or name!r}: is neither a shipped scenario, nor a recording in runs, nor what luxloop studio was started with; "
            "start it with that or with --allow-code"
        )
    return Source(name, tuple(message.overrides or ()), recording)


def refuse_foreign(overrides: Sequence[str]) -> None:
    """Raise LuxloopError if an override names an unshipped file, a Python module or a plant."""
    from luxloop.loop.scenario import data
    from luxloop.loop.scenario.overrides import is_file, tables, texts
    from luxloop.loop.scenario.shipped import shipped_files
    from luxloop.world.lamps.presets import SUMMARIES
    from luxloop.world.plugin import PATTERN

    ours = {*shipped_files("symbols"), *shipped_files("utilisations"), *data.registry(), *SUMMARIES}
    for override in overrides:
        if is_file(override):
            raise LuxloopError(f"{override}: the page cannot name a file; give its keys, or start luxloop studio with --allow-code")
        for key, text in texts(tables(override)):
            if key.startswith("plant"):
                raise LuxloopError(f"{override}: a plant cannot be chosen from the page; start luxloop studio with --allow-code")
            if re.fullmatch(PATTERN, text):
                raise LuxloopError(f"{override}: names a module of Python; start luxloop studio with --allow-code for that")
            if key.rpartition(".")[2] in FILES and text not in ours:
                raise LuxloopError(f"{override}: names a file that is not shipped; start luxloop studio with --allow-code for that")


def choices() -> dict[str, Any]:
    """Choices of a client, as the protocol has them."""
    from luxloop.loop.scenario.listing import listing
    from luxloop.loop.scenario.shipped import shipped_files
    from luxloop.world.lamps.presets import SUMMARIES
    from luxloop.world.regulation.tables import sets

    of = {kind: [{key: each[key] for key in ("name", "description")} for each in listing(kind)] for kind in ("scenarios", "controllers")}
    names = {
        "rules": [name for name, each in sets().items() if each.beam != "projection"],
        "symbols": list(shipped_files("symbols")),
        "lamps": list(SUMMARIES),
    }
    return {**of, **names, "recordings": recordings()}


def recordings() -> list[dict[str, str]]:
    """Recordings in `runs`, the newest first, with descriptions; unreadable ones are left out."""
    from luxloop.loop.recording.manifest import MANIFEST, TRAJECTORY

    written_s = {each.parent: each.stat().st_mtime for each in RUNS.glob(f"*/{MANIFEST}") if (each.parent / TRAJECTORY).is_file()}
    newest = sorted(written_s, key=lambda folder: -written_s[folder])[:MOST]
    found = ((folder, _description(folder / TRAJECTORY, written_s[folder])) for folder in newest)
    return [{"name": folder.as_posix(), "description": text} for folder, text in found if text]


@cache
def _description(trajectory: Path, written_s: float) -> str:
    import pyarrow.parquet as pq

    from luxloop.loop.recording.manifest import Manifest

    try:
        name, steps = Manifest.read(trajectory.parent).scenario["name"], pq.read_metadata(trajectory).num_rows
    except (LuxloopError, OSError, KeyError, ValueError):
        return ""
    return f"{name}, {steps} steps, {time.strftime('%Y-%m-%d %H:%M', time.localtime(written_s))}"
