"""What runs are made from, and which of it a client may open."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from luxloop.loop.studio.messages import Compare, Open
from luxloop.world.errors import LuxloopError

if TYPE_CHECKING:
    from luxloop.loop.recording.replay import Recording
    from luxloop.loop.scenario.model import Scenario


RUNS: Final = Path("runs")  # the folder in which recordings are made and found


@dataclass(frozen=True)
class Source:
    """What a run is made from: a scenario by name or path, with other values of keys, or the folder of a recording."""

    name: str
    overrides: tuple[str, ...] = ()
    recording: Path | None = None
    apart: tuple[str, ...] = ()  # values by which it differs from the run beside it

    @property
    def all(self) -> tuple[str, ...]:
        """All other values of keys."""
        return (*self.overrides, *self.apart)

    @property
    def label(self) -> str:
        """For the page."""
        return " ".join(self.apart) or self.name or str(self.recording)


def named(asked: Open | Compare, given: Sequence[Source], recordings: Collection[str], allow_code: bool) -> Source:
    """What a client names: a shipped scenario, a recording in the list that clients get, or what the server was started with.

    Raises LuxloopError for all else.
    """
    from luxloop.loop.scenario.shipped import scenario_files

    name = asked.name if isinstance(asked, Open) else ""
    recording = None if asked.recording is None else Path(asked.recording)
    known = any((each.name, each.recording) == (name, recording) for each in given)
    if not (allow_code or known or (asked.recording in recordings if recording else name in scenario_files())):
        raise LuxloopError(
            f"{recording or name!r}: is neither a shipped scenario, nor a recording in runs, nor what luxloop studio was started with; "
            "start it with that or with --allow-code"
        )
    return Source(name, tuple(asked.overrides or ()), recording)


def file_of(source: Source) -> Path | None:
    """The file of a scenario of somebody's own."""
    from luxloop.loop.scenario.shipped import find, scenario_files

    return None if source.recording or source.name in scenario_files() else find(source.name)


def loaded(source: Source, allow_code: bool) -> tuple["Scenario", "Recording | None"]:
    """The scenario of a source, and the recording that it comes from. Raises LuxloopError."""
    from luxloop.loop.recording import replay
    from luxloop.loop.scenario.model import load, validate
    from luxloop.loop.scenario.overrides import overridden

    if source.recording is None:
        return load(source.name, source.all, allow_code=allow_code), None
    recording = replay.load(source.recording)
    as_far = {"steps": max(recording.table.num_rows, 1)}
    data = overridden(recording.scenario.model_dump(mode="json"), [as_far, *source.all])
    scenario = validate(data, str(source.recording))
    if not allow_code:
        replay.refuse_foreign(source.recording, scenario, recording.edits)
    return scenario, recording
