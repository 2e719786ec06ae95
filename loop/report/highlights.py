"""Parts of a run that report.png needs beside the table, collected during the run."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.situation import ScheduleParams
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.appearance import appearance, image_axes
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.tracking import TrackerParams
from luxloop.world.texels import Window

MOMENTS = 4  # steps whose pictures the page shows
PAST_SYMBOLS = 12


class Highlights:
    """A few steps of a run, and the histories of its symbols under control."""

    def __init__(self, simulation: Simulation) -> None:
        self._moments: dict[int, Evaluation] = {}  # the first, some between, and the last so far
        self._scheduled: tuple[Simulation, Evaluation] | None = None  # the step amid the schedules of most functions
        self.symbols = list[SymbolHistory]()
        self.edit(simulation)

    def edit(self, simulation: Simulation) -> None:
        """Continue with an edited simulation, which may have other symbols and another number of steps."""
        self._simulation, scenario = simulation, simulation.scenario
        tracker, steps = scenario.tracker, scenario.steps
        # the last step without light on tracks
        frames = scenario.camera.latency_steps + tracker.confirm_frames if scenario.detector and isinstance(tracker, TrackerParams) else 1
        first = min(frames, steps) - 1
        self._busiest = busiest_step(scenario)
        self._kept = {first + k * (steps - 1 - first) // (MOMENTS - 1) for k in range(MOMENTS)}
        known = {each.name for each in self.symbols}
        self.symbols += [SymbolHistory(name, simulation.scenario.steps) for name in simulation.controlled if name not in known]

    @property
    def moments(self) -> list[Evaluation]:
        """Steps that the page shows, the last step of the run at the end."""
        return list(self._moments.values())[-MOMENTS:]

    @property
    def busiest(self) -> tuple[Simulation, Evaluation]:
        """The step that shows the functions at work, and its simulation: by their schedule, or the last moment that draws most."""
        if self._scheduled is not None:
            return self._scheduled
        drawn = max(self.moments, key=lambda each: (0 if each.plan.primitives is None else len(each.plan.primitives), each.step))
        return self._simulation, drawn

    def add(self, result: Evaluation) -> None:
        """Add a step."""
        if result.step == self._busiest:
            self._scheduled = self._simulation, result
        self._moments = {step: each for step, each in self._moments.items() if step in self._kept} | {result.step: result}
        for each in self.symbols:
            each.add(result)


def busiest_step(scenario: Scenario) -> int | None:
    """The step amid the longest time in which most functions are scheduled; None where none has a schedule."""
    end_s = scenario.steps / scenario.rate_hz
    timed = [each for each in scenario.functions.values() if isinstance(each, ScheduleParams)]
    spans = [(each.start_s or 0.0, end_s if each.stop_s is None else min(each.stop_s, end_s)) for each in timed]
    edges = sorted({0.0, end_s, *(time for span in spans for time in span if 0 < time < end_s)})
    if len(edges) == 2:
        return None
    start, stop = max(pairwise(edges), key=lambda at: (sum(a <= at[0] and at[1] <= b for a, b in spans), at[1] - at[0]))
    return min(int((start + stop) / 2 * scenario.rate_hz), scenario.steps - 1)


class SymbolHistory:
    """History of a symbol: path of the centroid, a few past symbols, the last step that shows it, and poses that the plant showed in place
    of the commanded ones.
    """

    def __init__(self, name: str, steps: int) -> None:
        """steps: of the run. Past symbols are kept at growing intervals, since a symbol moves most at first."""
        self.name = name
        self._keep = set(np.geomspace(1, max(steps, 1), PAST_SYMBOLS).round().astype(int) - 1)
        self.path: list[list[float]] = []
        self.symbols: list[tuple[Window, NDArray[np.bool_]]] = []
        self.frame: Tensor | None = None  # the newest on frame
        self.last: Evaluation | None = None  # that shows the symbol
        self.shown: dict[float, Tensor] = {}  # poses that the plant showed, by time in s

    def add(self, result: Evaluation) -> None:
        """Add a step."""
        if (held := result.held.get(self.name)) is None:
            return
        seen = held.measurement
        centre = [math.nan, math.nan]
        if int(seen.code) == ExtractionStatus.SEEN:
            height, width = seen.symbol.shape
            axes = image_axes(height, width, seen.crop.u_start, seen.crop.v_start, seen.symbol)
            centre = appearance(seen.symbol, axes).centroids[0].tolist()
            if result.step in self._keep:
                self.symbols.append((seen.crop, (seen.symbol > 0.5).cpu().numpy()))
        self.path.append(centre)
        self.frame = self.frame if result.frames is None else result.frames[0]
        self.last = result
        shown = [frame.shown for frame in result.reception.frames if frame.shown is not None]
        self.shown |= {each.start_s: each.projections[self.name].pose for each in shown if self.name in each.projections}
