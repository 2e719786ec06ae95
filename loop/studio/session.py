"""What is run for the studio's clients: one thread that prepares, steps and answers, to which OpenGL belongs."""

import queue
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final, Literal

from luxloop.loop.studio.history import History
from luxloop.loop.studio.messages import (
    VIEWS,
    AskBeam,
    AskSchema,
    AskSummary,
    Button,
    Compare,
    Drive,
    Message,
    Open,
    Paint,
    Place,
    Record,
    Set,
    Speed,
    View,
    Wish,
)
from luxloop.loop.studio.sources import RUNS, Source, file_of, loaded, named
from luxloop.loop.studio.watched import WatchedFile
from luxloop.world.errors import LuxloopError
from luxloop.world.messages import Arrays

if TYPE_CHECKING:
    from luxloop.loop.scenario.model import Scenario
    from luxloop.loop.studio.runs import Run

PATIENCE_S, REPORT_S = 5.0, 60.0  # with a step, and with the report of a recording, when all shall end
LOOK: Final = "look"
LOOK_AT_FILE_S: Final = 0.5  # between two looks at the scenario's file
MOST_WAITING: Final = 2  # messages behind a step that is still done
SMOOTH: Final = 0.2  # share of a step in the mean of its time

Reply = Callable[[dict[str, Any]], None]


@dataclass(frozen=True, eq=False)
class Published:
    """What all clients may see. number: another one where runs were made anew. choices, scenario: heads of messages. real_time: as a
    multiple.
    """

    number: int = 0
    choices: dict[str, Any] | None = None
    scenario: dict[str, Any] | None = None
    runs: tuple["Run", ...] = ()
    playing: bool = False
    speed: float | None = None
    step_ms: float | None = None
    real_time: float | None = None
    failed: str | None = None
    progress: str | None = "starting"
    recording: str | None = None  # folder below runs

    @property
    def steps(self) -> list[int]:
        """How many steps are done of each run."""
        return [len(run.snapshots) for run in self.runs]

    @property
    def edits(self) -> list[int]:
        """The number of edits of each run that clients are sent."""
        return [len(run.told) for run in self.runs]


@dataclass(frozen=True)
class Driven:
    """Somebody drives. steps: those of the runs before that."""

    steps: tuple[int, ...]
    throttle: float = 0.0
    steering: float = 0.0


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
        self._history = History()
        self._file = WatchedFile()
        self._driven: Driven | None = None
        self._thread = threading.Thread(target=self._work, name="simulation", daemon=True)

    def start(self) -> None:
        """Begin to prepare."""
        self._thread.start()

    def ask(self, message: Message, reply: Reply, arrays: Arrays | None = None) -> None:
        """Do as a client asks, in turn; reply: gets heads of answers, from the session's thread. arrays: of the message's body."""
        self._asked.put(Asked(message, reply, arrays or {}))

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return self._asked.qsize()

    def look(self, wanted: frozenset[View]) -> None:
        """What somebody looks at; where that is more than before, a step that rests is looked at anew."""
        more, self.wanted = wanted - self.wanted, wanted
        if more:
            self._asked.put(LOOK)

    def stop(self) -> bool:
        """End the thread after the step that it is at. Returns whether it has ended: one that prepares something for long has not."""
        self._asked.put(None)
        self._thread.join(PATIENCE_S if self.published.recording is None else REPORT_S)
        return not self._thread.is_alive()

    def _work(self) -> None:
        self._attempt(lambda: self._prepare(self._sources, (None,) * len(self._sources)), None)
        while True:
            if self._file.changed():
                self._attempt(self._reload, None)
            waits_s = max(self._next_s - time.perf_counter(), 0.0) if self.published.playing else LOOK_AT_FILE_S
            try:
                asked = self._asked.get(timeout=waits_s) if waits_s > 0 else self._asked.get_nowait()
            except queue.Empty:
                if self.published.playing:
                    self._attempt(self._step, None)
                continue
            if asked is None:
                for run in self.published.runs:
                    self._attempt(run.end_recording, None)
                return
            if asked == LOOK:
                self._attempt(self._look_again, None)
            else:
                self._attempt(partial(self._do, asked), asked)

    def _attempt(self, what: Callable[[], None], asked: Asked | None) -> None:
        """Errors become a sentence: the answer to who asked, and of what nobody asked the state of the session."""
        try:
            what()
            if asked is not None and asked.message.ask is not None:
                now = {key: getattr(self.published, key) for key in ("number", "playing", "steps", "edits")}
                asked.reply({"type": "done", "ask": asked.message.ask, "about": asked.message.type, **now})
            return
        except LuxloopError as error:
            text = str(error)
        except Exception as error:
            traceback.print_exc()
            text = f"{type(error).__name__}: {error}; the terminal of luxloop studio shows where"
        if asked is not None:
            asked.reply({"type": "error", "text": text, "about": asked.message.type, "ask": asked.message.ask})
            if self.published.progress is not None:
                self._publish(progress=None)
        else:
            self._publish(playing=False, failed=text, progress=None)

    def _publish(self, **values: Any) -> None:
        self.published = replace(self.published, **values)
        self._changed()

    def _do(self, asked: Asked) -> None:  # noqa: C901 (a case a message)
        from luxloop.loop.scenario.text import scenario_text

        match asked.message:
            case Button(type="play"):
                if not self.published.runs:
                    raise LuxloopError("play: nothing is prepared; open a scenario first")
                if all(run.over for run in self.published.runs):
                    self._start_anew()
                self._next_s = time.perf_counter()
                self._publish(playing=True, failed=None)
            case Button(type="pause"):
                self._publish(playing=False)
                self._look_again()
            case Button(type="step"):
                self._publish(playing=False)
                if asked.message.ask is not None or self._asked.qsize() <= MOST_WAITING:  # a key that is held down
                    self._step()
            case Button(type="reset"):
                self._publish(playing=False)
                self._let_go()
                self._start_anew()
            case Button(type="undo" | "redo" as way):
                from luxloop.loop.scenario.driving import with_drive

                before = self._scenarios()
                self._become(tuple(with_drive(*pair) for pair in zip(self._history.newest(way), before, strict=True)))
                self._history.go(way, before)
            case Button(type="save"):
                scenario = self._run(0).simulation.scenario
                asked.reply({"type": "saved", "name": f"{scenario.name}.toml", "text": scenario_text(scenario)})
            case Record(folder=folder):
                self._record(folder)
            case Speed(factor=factor):
                self._next_s = time.perf_counter()
                self._publish(speed=factor)
            case Open() as opened:
                self._prepare((self._source(opened),), (None,))
            case Set(overrides=overrides):
                self._refuse(overrides)
                self._edit(overrides)
            case Paint() as paint:
                from luxloop.loop.studio.painting import painted

                self._edit((painted(self._run(0).simulation, paint, asked.arrays),), paint.stroke)
            case Drive(throttle=float(throttle), steering=float(steering)):
                self._driven = replace(self._driven or self._taken_over(), throttle=throttle, steering=steering)
            case Drive():
                self._let_go()
            case Place() | Wish() as asks:
                self._paint_light(asks, asked)
            case Compare(overrides=None, recording=None):
                self._prepare(self._sources[:1], (*self._kept(), None)[:1])
            case Compare() as compared:
                self._compare(compared)
            case AskSummary(run=number):
                asked.reply({"type": "summary", "run": number, "summary": self._run(number).summary()})
            case AskSchema():
                asked.reply({"type": "schema", "schema": _schema()})
            case AskBeam() as beam:
                asked.reply({**beam.model_dump(exclude={"ask"}), "points": self._run(beam.run).beam(beam.rule, beam.side, beam.step)})

    def _paint_light(self, asks: Place | Wish, asked: Asked) -> None:
        from luxloop.loop.studio.wishes import placed, wished

        if isinstance(asks, Wish):
            self._publish(progress="finding the pixels for the light wanted")
        head, override = placed(self._run(0), asks) if isinstance(asks, Place) else wished(self._run(0), asks, asked.arrays)
        if override is not None:
            self._edit((override,), asks.stroke if isinstance(asks, Place) else 0)
        asked.reply(head)

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
            from luxloop.loop.studio.trust import refuse_foreign

            refuse_foreign(overrides)

    def _source(self, asked: Open | Compare) -> Source:
        """What a client names. Raises LuxloopError for what it may not open."""
        self._refuse(asked.overrides or ())
        recordings = {each["name"] for each in (self.published.choices or {}).get("recordings", ())}
        return named(asked, self._given, recordings, self._allow_code)

    def _taken_over(self) -> Driven:
        """Somebody drives from the next step on."""
        from luxloop.loop.scenario.driving import begin_drive

        before = self._scenarios()
        self._become(tuple(begin_drive(each, len(run.snapshots)) for each, run in zip(before, self.published.runs, strict=True)))
        return Driven(tuple(each.steps for each in before))

    def _let_go(self) -> None:
        """Nobody drives any more."""
        from luxloop.loop.scenario.driving import end_drive

        driven, self._driven = self._driven, None
        if driven is not None:
            runs = zip(self._scenarios(), self.published.runs, driven.steps, strict=True)
            scenarios, told = zip(*(end_drive(each, len(run.snapshots), steps) for each, run, steps in runs), strict=True)
            self._become(scenarios, told)

    def _drive(self, driven: Driven) -> None:
        """The course goes on for the next step of all runs."""
        from luxloop.loop.scenario.driving import continue_drive
        from luxloop.world.scene.driver import Controls

        for run in self.published.runs:
            scenario, told = continue_drive(run.simulation.scenario, len(run.snapshots), Controls(driven.throttle, driven.steering))
            run.edit(run.edited(scenario), told, driven=True)

    def _step(self) -> None:
        published, wanted = self.published, self.wanted
        if self._driven is not None:
            self._drive(self._driven)
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
        if over:
            self._record(None)

    def _scenarios(self) -> tuple["Scenario", ...]:
        """As they are now, of all runs. Raises LuxloopError where there are none."""
        if not self.published.runs:
            raise LuxloopError("nothing is prepared; open a scenario first")
        return tuple(run.simulation.scenario for run in self.published.runs)

    def _edit(self, overrides: tuple[str, ...], stroke: int = 0) -> None:
        """Other values of keys in all runs. stroke: as of `History.add`. Raises LuxloopError where one cannot have them."""
        from luxloop.loop.scenario.edits import with_overrides

        before = self._scenarios()
        told = [(*overrides, *source.apart) for source in self._sources]
        self._become(tuple(with_overrides(*pair) for pair in zip(before, told, strict=True)), told)
        self._history.add(before, overrides, stroke)

    def _become(self, scenarios: tuple["Scenario", ...], overrides: Sequence[tuple[str, ...]] | None = None) -> None:
        """Other values of keys: while the runs go on, as far as that can be, else in runs that start anew. overrides: that make each of
        the one there is; None for what tells them apart.
        """
        from luxloop.loop.scenario.edits import acts, differences

        runs = self.published.runs
        before = self._scenarios()
        found = {acts(*pair) for pair in zip(before, scenarios, strict=True)}
        if "restart" in found:
            self._prepare(self._sources, scenarios)
            return
        told = overrides or [differences(*pair) for pair in zip(before, scenarios, strict=True)]
        if "prepared" in found:
            self._publish(progress=f"preparing {' '.join(told[0])}"[:200])
        made = [run.edited(scenario) for run, scenario in zip(runs, scenarios, strict=True)]  # all of them, or none where one cannot be
        for run, after, each in zip(runs, made, told, strict=True):
            run.edit(after, each)
        self._publish(failed=None, progress=None)  # before the picture, which takes a step's time
        self._look_again()

    def _reload(self) -> None:
        """What has changed in the file is an edit."""
        from luxloop.loop.scenario.edits import differences, with_overrides

        before, after = self._file.scenario, loaded(self._sources[0], self._allow_code)[0]
        if before is not None and self.published.runs and (told := differences(before, after)):
            scenarios = self._scenarios()
            self._become(tuple(with_overrides(each, told) for each in scenarios), [told] * len(scenarios))
            self._history.add(scenarios, told)
        self._file.scenario = after

    def _kept(self) -> tuple["Scenario | None", ...]:
        """Scenarios as they are now, for runs that start anew; None of recordings that are repeated."""
        return tuple(run.simulation.scenario if run.recorded is None else None for run in self.published.runs)

    def _start_anew(self) -> None:
        self._prepare(self._sources, self._kept() or (None,) * len(self._sources))

    def _compare(self, compared: Compare) -> None:
        """Two runs from their first step on, the first one with all edits."""
        from luxloop.loop.scenario.edits import with_overrides

        overrides, (first, *_), kept = compared.overrides or (), self._sources, (*self._kept(), None)[0]
        self._refuse(overrides)
        if compared.recording is not None:
            self._prepare((first, self._source(compared)), (kept, None))
        else:
            self._prepare((first, replace(first, apart=overrides)), (kept, kept and with_overrides(kept, overrides)))

    def _record(self, folder: str | None) -> None:
        if folder is not None and any(each.recording and each.recording.resolve() == (RUNS / folder).resolve() for each in self._sources):
            raise LuxloopError(f"record: {RUNS / folder} is what is shown; give another name")
        if self.published.recording is not None:
            self._publish(progress="drawing the report of the recording")
            try:
                for run in self.published.runs:
                    run.end_recording()
            finally:
                self._publish(recording=None, progress=None)
        self._choose()
        if folder is not None:
            self._run(0).record(RUNS / folder)
            self._publish(recording=folder)

    def _choose(self) -> None:
        """Tell what there is to choose from, where that has changed."""
        from luxloop.loop.studio.choices import choices

        if (found := choices()) != self.published.choices:
            self._publish(choices=found)

    def _prepare(self, sources: tuple[Source, ...], scenarios: tuple["Scenario | None", ...]) -> None:
        """Make runs of sources in place of those there are; where one cannot be made, they stay.

        scenarios: in place of the sources' own, None of one that is read, from its files as they are now. Raises LuxloopError.
        """
        self._publish(progress="importing PyTorch and the renderer")
        from luxloop.loop.studio.runs import Starting, head

        self._choose()
        read, runs = scenarios[0] is None, self.published.runs
        starting = Starting(self._device, self._allow_code, lambda text: self._publish(progress=text))
        made = starting.runs(sources, scenarios, runs, self.wanted, anew=read)
        try:
            self._record(None)
        finally:  # a recording that cannot be finished keeps no other run from its start
            if read or len(sources) != len(self._sources):
                self._history = History()
            if read:
                self._file = WatchedFile(file_of(sources[0]), made[0].simulation.scenario)
            self._driven, self._sources, number = None, sources, self.published.number + 1
            playing, self._next_s = self.published.playing or any(run.recorded for run in made), time.perf_counter()
            told = {"playing": playing, "progress": None, "failed": None, "step_ms": None, "real_time": None}
            self._publish(number=number, scenario=head(made, number), runs=tuple(made), **told)


@cache
def _schema() -> dict[str, Any]:
    from luxloop.loop.scenario.model import Scenario

    return Scenario.model_json_schema()
