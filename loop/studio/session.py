"""What is run for the studio's clients: one thread that prepares, steps and answers, to which OpenGL belongs."""

import queue
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from loop.studio.arrays import Arrays
from loop.studio.messages import VIEWS, AskBeam, AskSchema, AskSummary, Button, Compare, Message, Open, Paint, Set, Speed, View
from world.errors import LuxloopError

if TYPE_CHECKING:
    from loop.scenario.model import Scenario
    from loop.studio.runs import Run

PATIENCE_S: Final = 5.0  # with a step, when all shall end
LOOK: Final = "look"
MOST_WAITING: Final = 2  # messages behind a step that is still done
SMOOTH: Final = 0.2  # share of a step in the mean of its time

Reply = Callable[[dict[str, Any]], None]


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

    def with_values(self, overrides: Sequence[str]) -> "Source":
        """The same with other values, in place of earlier ones of the same keys."""
        keys = {each.partition("=")[0].strip() for each in overrides}
        left = tuple(each for each in self.overrides if each.partition("=")[0].strip() not in keys)
        return replace(self, overrides=(*left, *overrides))


@dataclass(frozen=True, eq=False)
class Published:
    """What all clients may see. number: another one where runs were made anew. scenario: head of the message. real_time: as a multiple."""

    number: int = 0
    scenario: dict[str, Any] | None = None
    runs: tuple["Run", ...] = ()
    playing: bool = False
    speed: float | None = None
    step_ms: float | None = None
    real_time: float | None = None
    failed: str | None = None
    progress: str | None = "starting"


@dataclass(frozen=True, eq=False)
class Asked:
    """A client's message, and where its answer goes. arrays: of its body."""

    message: Message
    reply: Reply
    arrays: Arrays = field(default_factory=dict)


class Session:
    """Runs a source, and a second one beside it, as clients ask.

    published: replaced whole; any thread may read it. wanted: what somebody looks at; any thread may replace it.
    """

    def __init__(self, sources: tuple[Source, ...], changed: Callable[[], None], *, allow_code: bool = False, device: str = "auto") -> None:
        """sources: one, or two that step beside each other. changed: called after each change, from the session's thread."""
        self.published = Published()
        self.wanted: frozenset[View] = frozenset(VIEWS)
        self._sources = self._given = sources
        self._changed, self._allow_code, self._device = changed, allow_code, device
        self._asked: queue.SimpleQueue[Asked | Literal["look"] | None] = queue.SimpleQueue()
        self._next_s = 0.0
        self._thread = threading.Thread(target=self._work, name="simulation", daemon=True)

    def start(self) -> None:
        """Begin to prepare."""
        self._thread.start()

    def ask(self, message: Message, reply: Reply, arrays: Arrays | None = None) -> None:
        """Do as a client asks, in turn; reply: gets heads of answers, from the session's thread. arrays: of the message's body."""
        self._asked.put(Asked(message, reply, arrays or {}))

    def look(self, wanted: frozenset[View]) -> None:
        """What somebody looks at; where that is more than before, a step that rests is looked at anew."""
        more, self.wanted = wanted - self.wanted, wanted
        if more:
            self._asked.put(LOOK)

    def stop(self) -> None:
        """End the thread after the step that it is at; one that prepares something for long ends with the process."""
        self._asked.put(None)
        self._thread.join(PATIENCE_S)

    def _work(self) -> None:
        self._attempt(lambda: self._prepare(self._sources), None)
        while True:
            waits_s = max(self._next_s - time.perf_counter(), 0.0) if self.published.playing else None
            try:
                asked = self._asked.get(timeout=waits_s) if waits_s is None or waits_s > 0 else self._asked.get_nowait()
            except queue.Empty:
                self._attempt(self._step, None)
                continue
            if asked is None:
                return
            if asked == LOOK:
                self._attempt(self._look_again, None)
            else:
                self._attempt(partial(self._do, asked), asked)

    def _attempt(self, what: Callable[[], None], asked: Asked | None) -> None:
        """Errors become a sentence: the answer to who asked, and of what nobody asked the state of the session."""
        try:
            what()
            return
        except LuxloopError as error:
            text = str(error)
        except Exception as error:
            traceback.print_exc()
            text = f"{type(error).__name__}: {error}; the terminal of luxloop studio shows where"
        if asked is not None:
            asked.reply({"type": "error", "text": text, "about": asked.message.type})
            if self.published.progress is not None:
                self._publish(progress=None)
        else:
            self._publish(playing=False, failed=text, progress=None)

    def _publish(self, **values: Any) -> None:
        self.published = replace(self.published, **values)
        self._changed()

    def _do(self, asked: Asked) -> None:
        match asked.message:
            case Button(type="play"):
                if not self.published.runs:
                    raise LuxloopError("play: nothing is prepared; open a scenario first")
                if all(run.over for run in self.published.runs):
                    self._prepare(self._sources)
                self._next_s = time.perf_counter()
                self._publish(playing=True, failed=None)
            case Button(type="pause"):
                self._publish(playing=False)
                self._look_again()
            case Button(type="step"):
                self._publish(playing=False)
                if self._asked.qsize() <= MOST_WAITING:  # a key that is held down
                    self._step()
            case Button(type="reset"):
                self._publish(playing=False)
                self._prepare(self._sources)
            case Speed(factor=factor):
                self._next_s = time.perf_counter()
                self._publish(speed=factor)
            case Open() as opened:
                self._prepare((self._source(opened),))
            case Set(overrides=overrides):
                self._refuse(overrides)
                self._edit(overrides)
            case Paint() as paint:
                from loop.studio.painting import painted

                self._edit((painted(self._run(0).simulation, paint, asked.arrays),))
            case Compare(overrides=None, recording=None):
                self._prepare(self._sources[:1])
            case Compare() as compared:
                overrides = compared.overrides or ()
                self._refuse(overrides)
                first = self._sources[0]
                other = replace(first, apart=overrides) if compared.recording is None else self._source(compared)
                self._prepare((first, other))
            case AskSummary(run=number):
                asked.reply({"type": "summary", "run": number, "summary": self._run(number).summary()})
            case AskSchema():
                asked.reply({"type": "schema", "schema": _schema()})
            case AskBeam() as beam:
                asked.reply({**beam.model_dump(), "points": self._run(beam.run).beam(beam.rule, beam.side, beam.step)})

    def _look_again(self) -> None:
        if self.published.playing:
            return
        for run in self.published.runs:
            run.look_again(self.wanted)
        self._changed()

    def _run(self, number: int) -> "Run":
        runs = self.published.runs
        if number >= len(runs):
            raise LuxloopError(f"run {number}: there are {len(runs)} runs, numbered from 0")
        return runs[number]

    def _refuse(self, overrides: Sequence[str]) -> None:
        if not self._allow_code:
            from loop.studio.trust import refuse_foreign

            refuse_foreign(overrides)

    def _source(self, asked: Open | Compare) -> Source:
        """What a client names: shipped scenarios, and what the server was started with. Raises LuxloopError for all else."""
        from loop.scenario.shipped import shipped

        self._refuse(asked.overrides or ())
        name = asked.name if isinstance(asked, Open) else ""
        recording = None if asked.recording is None else Path(asked.recording)
        given = any((each.name, each.recording) == (name, recording) for each in self._given)
        if not self._allow_code and not given and (recording or name not in shipped()):
            raise LuxloopError(
                f"{recording or name!r}: is neither a shipped scenario nor what luxloop studio was started with; start it with that or "
                "with --allow-code"
            )
        return Source(name, tuple(asked.overrides or ()), recording)

    def _step(self) -> None:
        published, wanted = self.published, self.wanted
        runs = [run for run in published.runs if not run.over]
        began_s = time.perf_counter()
        for run in runs:
            run.step(wanted, still=not published.playing)
        if not runs:
            self._publish(playing=False)
            return
        period_s = 1 / runs[0].simulation.scenario.rate_hz
        ended_s = time.perf_counter()
        if published.speed is not None:  # behind its time it goes on at once, but makes up for no more than a step
            self._next_s = max(self._next_s, began_s - period_s / published.speed) + period_s / published.speed
        took_s = max(ended_s, self._next_s) - began_s if published.playing and published.speed else ended_s - began_s
        before, now = published.real_time, period_s / took_s
        real_time = now if before is None else (1 - SMOOTH) * before + SMOOTH * now
        over = all(run.over for run in published.runs)
        step_ms = sum(run.step_ms for run in runs)
        self._publish(playing=published.playing and not over, step_ms=step_ms, real_time=real_time)

    def _edit(self, overrides: tuple[str, ...]) -> None:
        """Other values of keys: from the next step on where world and lamps stay as they are, else in runs that start anew."""
        from loop.replay.edited import is_live

        sources = tuple(each.with_values(overrides) for each in self._sources)
        scenarios, runs = [self._loaded(each) for each in sources], self.published.runs
        if not runs or not all(is_live(run.simulation.scenario, each) for run, each in zip(runs, scenarios, strict=True)):
            self._prepare(sources)
            return
        made = [run.edited(scenario) for run, scenario in zip(runs, scenarios, strict=True)]  # all of them, or none where one cannot be
        for run, after in zip(runs, made, strict=True):
            run.edit(after, overrides)
        self._sources = sources
        self._publish(failed=None)

    def _prepare(self, sources: tuple[Source, ...]) -> None:
        """Make runs of sources in place of those there are; where one cannot be made, they stay. Raises LuxloopError."""
        self._publish(progress="importing PyTorch and the renderer")
        import torch

        from loop.run import prepare
        from loop.studio.runs import Run

        torch.set_num_threads(1)  # a step's operations are too small for two
        runs = list[Run]()
        for source in sources:
            scenario = self._loaded(source)
            self._publish(progress=f"preparing {scenario.name}")
            same = (run.simulation for run in self.published.runs if run.simulation.scenario == scenario)
            simulation = next(same, None) or prepare(scenario, self._device)
            self._publish(progress=f"first step of {scenario.name}")
            runs.append(Run(simulation, " ".join(source.apart) or source.name or str(source.recording), source.all))
        first = runs[0].simulation.scenario
        head = {
            "type": "scenario",
            **{key: getattr(first, key) for key in ("name", "source", "steps", "rate_hz", "seed")},
            "runs": [run.facts() for run in runs],
            "model": first.model_dump(mode="json"),
            "choices": _choices(),
        }
        self._sources, number = sources, self.published.number + 1
        self._publish(number=number, scenario=head, runs=tuple(runs), progress=None, failed=None, step_ms=None, real_time=None)

    def _loaded(self, source: Source) -> "Scenario":
        from loop.replay import replay
        from loop.scenario.model import load, validate
        from loop.scenario.overrides import overridden
        from world.plugin import refuse_code

        if source.recording is None:
            return load(source.name, source.all, allow_code=self._allow_code)
        recording = replay.load(source.recording)
        as_far = {"steps": max(recording.table.num_rows, 1)}
        data = overridden(recording.scenario.model_dump(mode="json"), [as_far, *source.all])
        scenario = validate(data, str(source.recording))
        if not self._allow_code:
            refuse_code(scenario, scenario.source)
        return scenario


@cache
def _schema() -> dict[str, Any]:
    from loop.scenario.model import Scenario

    return Scenario.model_json_schema()


def _choices() -> dict[str, Any]:
    from loop.terminal.listing import listing
    from world.regulation.tables import sets

    of = {kind: [{key: each[key] for key in ("name", "description")} for each in listing(kind)] for kind in ("scenarios", "controllers")}
    return {**of, "rules": list(sets())}
