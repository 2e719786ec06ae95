"""The studio's session: one thread, which owns OpenGL, prepares and steps runs, and answers clients."""

import math
import queue
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Literal

from luxloop.loop.studio.messages import (
    VIEWS,
    AskBeam,
    AskMeter,
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
from luxloop.loop.studio.sources import RUNS, ScenarioFile, Source, choices, open_source, refuse_foreign
from luxloop.world.errors import LuxloopError
from luxloop.world.messages import Arrays

if TYPE_CHECKING:
    from luxloop.loop.scenario.model import Scenario
    from luxloop.loop.studio.runs import Run

    Scenarios = tuple[Scenario, ...]  # of all runs

PATIENCE_S, REPORT_S = 5.0, 60.0  # time-outs at the end, of a step and of a recording's report
LOOK: Literal["look"] = "look"
LOOK_AT_FILE_S = 0.5  # interval of checks of the scenario's file
MOST_WAITING = 2  # waiting messages up to which a step is done
SMOOTH = 0.2  # weight of the newest step in the mean speed
TOGETHER_S = 1.0  # longest interval of edits of the same keys that are undone together, as of a drag
MOST_UNDO = 200  # edits

Way = Literal["undo", "redo"]
Reply = Callable[[dict[str, Any]], None]


@dataclass(frozen=True, eq=False)
class SessionState:
    """State for all clients.

    number: changes with new runs. choices, scenario: heads of messages. real_time: speed as a multiple of real time.
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
        """Number of steps of each run."""
        return [len(run.snapshots) for run in self.runs]

    @property
    def edits(self) -> list[int]:
        """Number of edits of each run that are sent to clients."""
        return [len(run.client_edits) for run in self.runs]


@dataclass(frozen=True)
class Steering:
    """A drive. steps: of the runs' scenarios before it."""

    steps: tuple[int, ...]
    throttle: float = 0.0
    steering: float = 0.0


@dataclass(frozen=True, eq=False)
class Task:
    """A client's message with its arrays, and the receiver of its answer."""

    message: Message
    reply: Reply
    arrays: Arrays = field(default_factory=dict)


class History:
    """Undo history: scenarios before each edit, and after each undone one."""

    def __init__(self) -> None:
        self._scenarios: dict[Way, list[Scenarios]] = {"undo": [], "redo": []}
        self._last: tuple[frozenset[str], float] = frozenset(), 0.0

    def add(self, before: "Scenarios", overrides: Sequence[str], stroke: int = 0) -> None:
        """Add an edit. before: scenarios before it. stroke: number, above 0, of the paint stroke to which it belongs."""
        keys = frozenset({f"stroke {stroke}"} if stroke else (each.partition("=")[0].strip() for each in overrides))
        now_s, together_s = time.monotonic(), math.inf if stroke else TOGETHER_S
        (same, then_s), self._last = self._last, (keys, now_s)
        if keys != same or now_s - then_s > together_s:
            self._scenarios["undo"] = [*self._scenarios["undo"], before][-MOST_UNDO:]
        self._scenarios["redo"] = []

    def newest(self, way: Way) -> "Scenarios":
        """Scenarios to return to. Raises LuxloopError if there are none."""
        if not self._scenarios[way]:
            raise LuxloopError(f"{way}: there is nothing to {way}")
        return self._scenarios[way][-1]

    def go(self, way: Way, before: "Scenarios") -> None:
        """Note an undo or redo. before: scenarios before it."""
        self._scenarios[way].pop()
        self._scenarios["redo" if way == "undo" else "undo"].append(before)
        self._last = frozenset(), 0.0


class Session:
    """Session of a run, and a second one beside it.

    state: replaced as a whole; any thread may read it. wanted: contents that clients show; any thread may replace it.
    """

    def __init__(self, sources: tuple[Source, ...], notify: Callable[[], None], *, allow_code: bool = False, device: str = "auto") -> None:
        """sources: one, or two that step together. notify: called after each change, from the session's thread."""
        self.state = SessionState()
        self.wanted: frozenset[View] = frozenset(VIEWS)
        self._sources = self._given = sources
        self._notify, self._allow_code, self._device = notify, allow_code, device
        self._tasks: queue.SimpleQueue[Task | Literal["look"] | None] = queue.SimpleQueue()
        self._next_s = 0.0
        self._history, self._file = History(), ScenarioFile()
        self._steering: Steering | None = None
        self._thread = threading.Thread(target=self._work, name="simulation", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def ask(self, message: Message, reply: Reply, arrays: Arrays | None = None) -> None:
        """Queue a client's message. reply: called with heads of answers, from the session's thread. arrays: of the message."""
        self._tasks.put(Task(message, reply, arrays or {}))

    @property
    def waiting(self) -> int:
        """Number of waiting messages."""
        return self._tasks.qsize()

    def look(self, wanted: frozenset[View]) -> None:
        """Set the contents that clients show; additional ones renew the picture of a pausing run."""
        more, self.wanted = wanted - self.wanted, wanted
        if more:
            self._tasks.put(LOOK)

    def stop(self) -> bool:
        """End the thread after the current step. Returns whether it has ended, which a long preparation prevents."""
        self._tasks.put(None)
        self._thread.join(PATIENCE_S if self.state.recording is None else REPORT_S)
        return not self._thread.is_alive()

    def _work(self) -> None:
        self._attempt(lambda: self._prepare(self._sources, (None,) * len(self._sources)))
        while True:
            if self._file.poll():
                self._attempt(self._reload)
            waits_s = max(self._next_s - time.perf_counter(), 0.0) if self.state.playing else LOOK_AT_FILE_S
            try:
                task = self._tasks.get(timeout=waits_s) if waits_s > 0 else self._tasks.get_nowait()
            except queue.Empty:
                if self.state.playing:
                    self._attempt(self._step)
                continue
            if task is None:
                for run in self.state.runs:
                    self._attempt(run.end_recording)
                return
            if task == LOOK:
                self._attempt(self._look_again)
            else:
                self._attempt(partial(self._do, task), task)

    def _attempt(self, what: Callable[[], None], task: Task | None = None) -> None:
        """Call a function; an error becomes a sentence for the client that asked, or in the session's state."""
        try:
            what()
            if task is not None and task.message.ask is not None:
                now = {key: getattr(self.state, key) for key in ("number", "playing", "steps", "edits")}
                task.reply({"type": "done", "ask": task.message.ask, "about": task.message.type, **now})
            return
        except LuxloopError as error:
            text = str(error)
        except Exception as error:
            traceback.print_exc()
            text = f"{type(error).__name__}: {error}; the terminal of luxloop studio shows where"
        if task is None:
            self._publish(playing=False, failed=text, progress=None)
            return
        task.reply({"type": "error", "text": text, "about": task.message.type, "ask": task.message.ask})
        if self.state.progress is not None:
            self._publish(progress=None)

    def _publish(self, **values: Any) -> None:
        self.state = replace(self.state, **values)
        self._notify()

    def _do(self, task: Task) -> None:  # noqa: C901 (a case a message)
        match task.message:
            case Button(type="play"):
                if not self.state.runs:
                    raise LuxloopError("play: nothing is prepared; open a scenario first")
                if all(run.over for run in self.state.runs):
                    self._start_anew()
                self._next_s = time.perf_counter()
                self._publish(playing=True, failed=None)
            case Button(type="pause"):
                self._publish(playing=False)
                self._look_again()
            case Button(type="step"):
                self._publish(playing=False)
                if task.message.ask is not None or self._tasks.qsize() <= MOST_WAITING:  # fewer steps for a key that is held down
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
                from luxloop.loop.scenario.text import scenario_text

                scenario = self._run(0).simulation.scenario
                task.reply({"type": "saved", "name": f"{scenario.name}.toml", "text": scenario_text(scenario)})
            case Record(folder=folder):
                self._record(folder)
            case Speed(factor=factor):
                self._next_s = time.perf_counter()
                self._publish(speed=factor)
            case Open() as message:
                self._prepare((self._source(message),), (None,))
            case Set(overrides=overrides):
                self._refuse(overrides)
                self._edit(overrides)
            case Drive(throttle=float(throttle), steering=float(steering)):
                self._steering = replace(self._steering or self._take_over(), throttle=throttle, steering=steering)
            case Drive():
                self._let_go()
            case Paint() | Place() | Wish() as message:
                self._paint(message, task)
            case Compare() as message:
                self._compare(message)
            case AskSummary(run=number):
                task.reply({"type": "summary", "run": number, "summary": self._run(number).summary()})
            case Button(type="schema"):
                task.reply({"type": "schema", "schema": _schema()})
            case AskBeam() as beam:
                task.reply({**beam.model_dump(exclude={"ask"}), "points": self._run(beam.run).beam(beam.rule, beam.side, beam.step)})
            case AskMeter() as ask:
                from luxloop.loop.studio.meter import readings

                task.reply(readings(self._run(ask.run), ask))

    def _paint(self, message: Paint | Place | Wish, task: Task) -> None:
        from luxloop.loop.studio import painting

        if isinstance(message, Wish):
            self._publish(progress="finding the pixels for the light wanted")
        answer, override = painting.ACTS[message.type](self._run(0), message, task.arrays)
        if override is not None:
            self._edit((override,), getattr(message, "stroke", 0))
        if answer is not None:
            task.reply(answer)

    def _look_again(self) -> None:
        if self.state.playing:
            return
        for run in self.state.runs:
            run.look_again(self.wanted)
        self._notify()

    def _run(self, number: int) -> "Run":
        runs = self.state.runs
        if number >= len(runs):
            raise LuxloopError(f"run {number}: there are {len(runs)} runs, numbered from 0")
        return runs[number]

    def _refuse(self, overrides: Sequence[str]) -> None:
        if not self._allow_code:
            refuse_foreign(overrides)

    def _source(self, message: Open | Compare) -> Source:
        """Source named by a client. Raises LuxloopError if it may not be opened."""
        self._refuse(message.overrides or ())
        recordings = {each["name"] for each in (self.state.choices or {}).get("recordings", ())}
        return open_source(message, self._given, recordings, self._allow_code)

    def _take_over(self) -> Steering:
        """Begin a drive from the next step on."""
        from luxloop.loop.scenario.driving import begin_drive

        before = self._scenarios()
        self._become(tuple(begin_drive(each, len(run.snapshots)) for each, run in zip(before, self.state.runs, strict=True)))
        return Steering(tuple(each.steps for each in before))

    def _let_go(self) -> None:
        """End a drive."""
        from luxloop.loop.scenario.driving import end_drive

        steering, self._steering = self._steering, None
        if steering is not None:
            runs = zip(self._scenarios(), self.state.runs, steering.steps, strict=True)
            scenarios, overrides = zip(*(end_drive(each, len(run.snapshots), steps) for each, run, steps in runs), strict=True)
            self._become(scenarios, overrides)

    def _drive(self, steering: Steering) -> None:
        """Extend the course of all runs for the next step."""
        from luxloop.loop.scenario.driving import continue_drive
        from luxloop.world.scene.driver import Controls

        controls = Controls(steering.throttle, steering.steering)
        for run in self.state.runs:
            scenario, overrides = continue_drive(run.simulation.scenario, len(run.snapshots), controls)
            run.edit(run.prepare_edit(scenario), overrides, driven=True)

    def _step(self) -> None:
        state = self.state
        if self._steering is not None:
            self._drive(self._steering)
        runs = [run for run in state.runs if not run.over]
        began_s = time.perf_counter()
        for run in runs:
            run.step(self.wanted)
        if not runs:
            self._publish(playing=False)
            return
        period_s = 1 / runs[0].simulation.scenario.rate_hz
        ended_s = time.perf_counter()
        if state.speed is not None:  # a late step starts at once; at most one step is made up
            self._next_s = max(self._next_s, began_s - period_s / state.speed) + period_s / state.speed
        took_s = max(ended_s, self._next_s) - began_s if state.playing and state.speed else ended_s - began_s
        before, now = state.real_time, period_s / took_s
        real_time = now if before is None else (1 - SMOOTH) * before + SMOOTH * now
        over = all(run.over for run in state.runs)
        self._publish(playing=state.playing and not over, step_ms=sum(run.step_ms for run in runs), real_time=real_time)
        if over:
            self._record(None)

    def _scenarios(self) -> "Scenarios":
        """Current scenarios of all runs. Raises LuxloopError without runs."""
        if not self.state.runs:
            raise LuxloopError("nothing is prepared; open a scenario first")
        return tuple(run.simulation.scenario for run in self.state.runs)

    def _edit(self, overrides: tuple[str, ...], stroke: int = 0) -> None:
        """Set keys in all runs. stroke: as of `History.add`. Raises LuxloopError if a value is invalid."""
        from luxloop.loop.scenario.edits import with_overrides

        before = self._scenarios()
        all_overrides = [(*overrides, *source.apart) for source in self._sources]
        self._become(tuple(with_overrides(*pair) for pair in zip(before, all_overrides, strict=True)), all_overrides)
        self._history.add(before, overrides, stroke)

    def _become(self, scenarios: "Scenarios", overrides: Sequence[tuple[str, ...]] | None = None) -> None:
        """Change to other scenarios: running runs continue if possible, else they restart.

        overrides: of each scenario from the current one; None for their differences.
        """
        from luxloop.loop.scenario.edits import acts, differences

        before = self._scenarios()
        when = {acts(*pair) for pair in zip(before, scenarios, strict=True)}
        if "restart" in when:
            self._prepare(self._sources, scenarios)
            return
        overrides = overrides or [differences(*pair) for pair in zip(before, scenarios, strict=True)]
        if "prepared" in when:
            self._publish(progress=f"preparing {' '.join(overrides[0])}"[:200])
        runs = self.state.runs
        after = [run.prepare_edit(scenario) for run, scenario in zip(runs, scenarios, strict=True)]  # before any run changes
        for run, simulation, each in zip(runs, after, overrides, strict=True):
            run.edit(simulation, each)
        self._publish(failed=None, progress=None)  # before the picture, which takes as long as a step
        self._look_again()

    def _reload(self) -> None:
        """Edit by the changes in the scenario's file."""
        from luxloop.loop.scenario.edits import differences, with_overrides

        before, after = self._file.scenario, self._sources[0].load(self._allow_code)[0]
        if before is not None and self.state.runs and (overrides := differences(before, after)):
            scenarios = self._scenarios()
            self._become(tuple(with_overrides(each, overrides) for each in scenarios), [overrides] * len(scenarios))
            self._history.add(scenarios, overrides)
        self._file.scenario = after

    def _own_scenarios(self) -> tuple["Scenario | None", ...]:
        """Current scenarios for restarted runs; None for repeated recordings."""
        return tuple(None if run.playback else run.simulation.scenario for run in self.state.runs) or (None,) * len(self._sources)

    def _start_anew(self) -> None:
        self._prepare(self._sources, self._own_scenarios())

    def _compare(self, message: Compare) -> None:
        """Restart with two runs, the first one with all edits; or with the first one alone."""
        from luxloop.loop.scenario.edits import with_overrides

        overrides, (first, *_), (scenario, *_) = message.overrides, self._sources, self._own_scenarios()
        self._refuse(overrides or ())
        if message.recording is not None:
            self._prepare((first, self._source(message)), (scenario, None))
        elif overrides is not None:
            self._prepare((first, replace(first, apart=overrides)), (scenario, scenario and with_overrides(scenario, overrides)))
        else:
            self._prepare((first,), (scenario,))

    def _record(self, folder: str | None) -> None:
        if folder is not None and any(each.recording and each.recording.resolve() == (RUNS / folder).resolve() for each in self._sources):
            raise LuxloopError(f"record: {RUNS / folder} is what is shown; give another name")
        if self.state.recording is not None:
            self._publish(progress="drawing the report of the recording")
            try:
                for run in self.state.runs:
                    run.end_recording()
            finally:
                self._publish(recording=None, progress=None)
        self._choose()
        if folder is not None:
            self._run(0).record(RUNS / folder)
            self._publish(recording=folder)

    def _choose(self) -> None:
        """Publish the choices if they have changed."""
        if (found := choices()) != self.state.choices:
            self._publish(choices=found)

    def _prepare(self, sources: tuple[Source, ...], scenarios: tuple["Scenario | None", ...]) -> None:
        """Replace the runs by runs of sources; on failure the old ones stay.

        scenarios: instead of the sources' own, None to load them from the current files. Raises LuxloopError.
        """
        self._publish(progress="importing PyTorch and the renderer")
        from luxloop.loop.studio.runs import head, start

        self._choose()
        anew = scenarios[0] is None
        how: dict[str, Any] = {"anew": anew, "device": self._device, "allow_code": self._allow_code}
        runs = start(zip(sources, scenarios, strict=True), self.state.runs, self.wanted, lambda text: self._publish(progress=text), **how)
        try:
            self._record(None)
        finally:  # also if a recording cannot be finished
            if anew or len(sources) != len(self._sources):
                self._history = History()
            if anew:
                self._file = ScenarioFile(sources[0].file, runs[0].simulation.scenario)
            self._steering, self._sources, number = None, sources, self.state.number + 1
            playing, self._next_s = self.state.playing or any(run.playback for run in runs), time.perf_counter()
            rest = {"playing": playing, "progress": None, "failed": None, "step_ms": None, "real_time": None}
            self._publish(number=number, scenario=head(runs, number), runs=tuple(runs), **rest)


@cache
def _schema() -> dict[str, Any]:
    from luxloop.loop.scenario.model import Scenario

    return Scenario.model_json_schema()
