"""Gradient tuning: run, fit a surrogate of the symbol's errors, descend through predicted runs, and repeat."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import optuna
import torch
from optuna.trial import create_trial
from torch import Tensor

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.recording.summary import FINAL
from luxloop.loop.report.terminal import progress
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import only
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.rollouts import check, rollouts_by
from luxloop.loop.studies.jobs import Executor
from luxloop.loop.studies.ranges import Range
from luxloop.loop.studies.tune import (
    FAILURES,
    SETTLED,
    STUDY,
    TRACES,
    Task,
    Trace,
    Tuning,
    begin,
    failure_reasons,
    keeping,
    run_all,
    study_in,
    trial_count,
)
from luxloop.perception.extraction import ExtractionParams, ExtractionStatus
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import lock_file

NEAR = 0.02  # error of a settled symbol as a share of its size


def near(simulation: Simulation) -> Tensor:
    """Errors `[4]` in x, y (m), roll and pitch (rad) of a symbol at the limit of being settled (`luxloop.loop.recording.summary`).

    A rotation of the primitive by a share of the lamp's grazing angle at the road shears or stretches the symbol by that share.
    """
    symbol = simulation.scenario.symbol
    grazing = simulation.scenario.headlight.height_m / symbol.x_m
    return NEAR * torch.tensor([symbol.length_m, symbol.width_m, grazing, grazing], device=simulation.device)


@dataclass(frozen=True)
class Surrogate:
    """Surrogate of the symbol's errors.

    poses, offsets: `[n, 4]`, projected poses, and errors less these poses. Errors are divided by their plant gains, so that offsets vary
    only with the road. noise: `[4]`, standard deviation of the errors.
    """

    poses: Tensor
    offsets: Tensor
    noise: Tensor

    @classmethod
    def of(cls, runs: Sequence[Rollout], late: int) -> "Surrogate":
        """Surrogate of runs whose frames are `late` steps late; at least one run must have seen the symbol."""
        poses, offsets = [], []
        for each in runs:
            seen, shown = each.seen[0, late:], each.poses[0, : each.poses.shape[1] - late]
            poses.append(shown[seen])
            offsets.append((each.errors[0, late:] - shown)[seen])
        most = max(len(each) for each in offsets)  # runs with few measurements do not determine the noise
        noise = torch.stack([each[-FINAL:].std(0, correction=0) for each in offsets if len(each) >= min(most, FINAL)]).amin(0)
        return cls(torch.cat(poses), torch.cat(offsets), noise)

    def predict(self, simulation: Simulation, values: dict[str, Tensor], noise: Tensor) -> Rollout:
        """Predicted runs, differentiable in the gains, without rendering. values: gains `[B]` by key. noise: `[steps, B, 4]`, standard
        normal.
        """
        apart = near(simulation)

        def look(projection: ProjectionCommand, step: int) -> Measurement:
            poses = projection.pose
            squares = ((poses[:, None] - self.poses) / apart).square().sum(-1)
            weights = (squares + 1.0) ** -2
            offsets = (weights / weights.sum(-1, keepdim=True)) @ self.offsets
            return replace(
                simulation.symbol.sensor.lost(poses, ExtractionStatus.SEEN), pose_error=poses + offsets + self.noise * noise[step]
            )

        return rollouts_by(look, simulation, values)


STARTS, DRAWS = 24, 3  # parallel descents, and noise draws of each
STEPS, RATE = 120, 0.15  # of Adam, in logits of the ranges
FROM_ENDS = 0.02  # least distance of a start from the ends of a range, as a share, since the slope vanishes at the ends
FAR = 0.05  # weight of the distance to the target relative to the share of unsettled steps


@dataclass(frozen=True)
class Iteration:
    """One iteration of a study.

    values: by key, None if the scenarios differ. cost: mean. traces: of all runs in the order of `Task.runs`.
    """

    values: Mapping[str, float | int | None]
    cost: float
    traces: list[Trace]


def tune_by_gradient(task: Task, out: Path, iterations: int, execute: Executor) -> Tuning:
    """Continue a study in a folder up to a number of trials; the first has the given values, the others come from descents.

    Raises as `luxloop.loop.studies.tune.tune` and `luxloop.loop.studies.batch.rollouts.check`, and LuxloopError if a symbol is never seen.
    """
    if task.robust:
        raise LuxloopError("--gradient: predicts one plant, not the perturbed ones of --robust; leave out either")
    if whole := [each.key for each in task.ranges if each.whole]:
        raise LuxloopError(f"--key {whole[0]}: takes whole numbers, which have no gradient; leave it out, or tune without --gradient")
    simulations = []
    for scenario in task.scenarios:
        with locate(f"{scenario.name}: --gradient"):
            symbol = scenario.symbol
        if not isinstance(symbol.extraction, ExtractionParams):
            key = f"functions.{only(scenario.symbols)}.extraction.kind"
            raise LuxloopError(f"{scenario.name}: {key}: no error model for an own extraction; leave it out, or tune without --gradient")
        simulations.append(prepare(scenario, task.device))
        check(simulations[-1], [each.key for each in task.ranges])
    with study_in(out, task.digest) as study, keeping(out, lambda: f"{trial_count(study)} of {iterations} iterations"):
        shown = trial_count(study)
        with progress("iterations", iterations, min(shown, iterations)) as advance:
            while True:
                with lock_file(out / STUDY):  # processes take turns, since an iteration uses all earlier ones
                    space = begin(study, task, out, execute)
                    if trial_count(study) >= iterations:
                        break
                    values = descend(task, simulations, _before(task, study))
                    costs, traces, settled = run_all(task, task.runs(values), execute)
                    kept = {TRACES: traces, FAILURES: failure_reasons(traces), SETTLED: settled}
                    study.add_trial(create_trial(params=values, distributions=space, value=task.cost(costs), user_attrs=kept))
                done = trial_count(study)
                advance(done - shown)
                shown = done
    return Tuning(task, study.user_attrs["given_cost"], study)


def descend(task: Task, simulations: Sequence[Simulation], before: Sequence[Iteration]) -> dict[str, float]:
    """Values of least `loss`, by descents from the best earlier values and random ones around them."""
    scenes = [_surrogate(simulations, k, before) for k in range(len(simulations))]
    generator = torch.Generator().manual_seed(task.seed * 1000 + len(before))
    best = _logits(task, min(before, key=lambda iteration: iteration.cost).values)
    around = torch.randn(STARTS, len(best), generator=generator, dtype=best.dtype)
    around[0] = 0.0
    steps = max(scenario.steps for scenario in task.scenarios)
    noise = torch.randn(steps, DRAWS, 1, 4, generator=generator).expand(-1, -1, STARTS, -1).flatten(1, 2)
    logits = (best + around).requires_grad_()
    adam = torch.optim.Adam([logits], lr=RATE)
    least, found = math.inf, best
    for _ in range(STEPS):
        adam.zero_grad()
        values = {each.key: _value(each, logits[:, k]).float().repeat(DRAWS).to(task.device) for k, each in enumerate(task.ranges)}
        predicted = [scene.predict(each, values, noise.to(task.device)) for scene, each in zip(scenes, simulations, strict=True)]
        losses = torch.stack([loss(rollout, each) for rollout, each in zip(predicted, simulations, strict=True)])
        means = losses.view(-1, STARTS).mean(0)
        if means.min() < least:
            least, found = means.min().item(), logits[means.argmin()].detach().clone()
        means.sum().backward()  # type: ignore[no-untyped-call]
        adam.step()
    return _values(task, found)


def loss(rollout: Rollout, simulation: Simulation) -> Tensor:
    """Soft share of steps until the symbol has settled, `[B]`.

    It replaces settling and residual, whatever the objective.
    """
    squares = (rollout.errors / near(simulation)).square().amax(-1)
    ahead = squares.flip(-1).cummax(-1).values
    return (ahead.square() / (1 + ahead.square()) + FAR * ahead.log1p()).mean(-1)


def _before(task: Task, study: optuna.Study) -> list[Iteration]:
    """All iterations so far, the given values first."""
    trials = [trial for trial in study.get_trials(deepcopy=False) if TRACES in trial.user_attrs]
    later = [Iteration(trial.params, trial.value or 0.0, trial.user_attrs[TRACES]) for trial in trials]
    return [Iteration(task.start_values, study.user_attrs["given_cost"], study.user_attrs[TRACES]), *later]


def _surrogate(simulations: Sequence[Simulation], number: int, before: Sequence[Iteration]) -> Surrogate:
    """Surrogate of a scenario, by its number, from all its runs so far."""
    simulation = simulations[number]
    scenario = simulation.scenario
    traces = [trace for iteration in before for trace in iteration.traces[number :: len(simulations)]]
    whole = [trace for trace in traces if not isinstance(trace, str)]
    runs = [Rollout(*(torch.tensor(part, device=simulation.device)[None] for part in trace)) for trace in whole]
    if not any(run.seen.any() for run in runs):
        why = next(iter(failure_reasons(traces)), "its symbol is never seen")
        raise LuxloopError(f"{scenario.name}: {why}, so there is nothing to descend on; give other values, or tune without --gradient")
    return Surrogate.of(runs, scenario.camera.latency_steps)


def _values(task: Task, logits: Tensor) -> dict[str, float]:
    """Values rounded to six significant digits, within the ranges."""
    found = ((each, float(f"{_value(each, logit).item():.6g}")) for each, logit in zip(task.ranges, logits, strict=True))
    return {each.key: min(max(value, each.low), each.high) for each, value in found}


def _logits(task: Task, values: Mapping[str, float | int | None]) -> Tensor:
    return torch.tensor([_logit(each, values[each.key]) for each in task.ranges], dtype=torch.float64)


def _logit(each: Range, value: float | int | None) -> float:
    low, high = (math.log(end) if each.log else end for end in (each.low, each.high))
    at = (low + high) / 2 if value is None else math.log(value) if each.log and value > 0 else value
    share = min(max((at - low) / (high - low), FROM_ENDS), 1 - FROM_ENDS)
    return math.log(share / (1 - share))


def _value(each: Range, logit: Tensor) -> Tensor:
    share = torch.sigmoid(logit)
    if each.log:
        return (math.log(each.low) + share * math.log(each.high / each.low)).exp()
    return each.low + share * (each.high - each.low)
