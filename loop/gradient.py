"""Tuning by gradient: Adam through differentiable rollouts, from gains to squared errors, which stand for settling and residual."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from optuna.trial import create_trial
from torch import Tensor

from loop.batch import Rollout, check, rollouts
from loop.executors import Executor
from loop.figures import with_seed
from loop.progress import progress
from loop.ranges import Range
from loop.run import prepare
from loop.scenario import Scenario
from loop.simulation import Simulation
from loop.tune import Task, Tuned, mean_cost, opened
from perception.extraction import ExtractionParams
from world.errors import LuxloopError

RATE = 0.5  # of Adam, in logits of the ranges
FROM_ENDS = 0.02  # of a range: where values start that lie on its ends or beyond, and would have no slope there
NEAR = 0.02  # of the symbol's size, within which it counts as settled
NEAR_ANGLES = (math.radians(1.0), math.radians(0.5))  # of roll and pitch, the same
LOST = 10.0  # what a step without a symbol costs

Values = dict[str, float | int]


def tune_by_gradient(task: Task, out: Path, iterations: int, execute: Executor) -> Tuned:
    """Descend from the given values, and add the point of least squared errors to the study in a folder as a trial of its own.

    An iteration is one rollout of each scenario and seed. Raises what `loop.tune.tune` and `loop.batch.check` raise.
    """
    study, space = opened(task, out, execute)
    with progress("iterations", iterations) as advance:
        values = descend(task, iterations, advance)
    study.add_trial(create_trial(params=values, distributions=space, value=mean_cost(task, values, execute)))
    return Tuned(task, study.user_attrs["given_cost"], study)


def descend(task: Task, iterations: int, advance: Callable[[], None] = lambda: None) -> Values:
    """The values of least squared errors among those that Adam comes by, from the given ones on."""
    if whole := [each.key for each in task.ranges if each.whole]:
        raise LuxloopError(f"--key {whole[0]}: takes whole numbers, which have no gradient; leave it out, or tune without --gradient")
    simulations = list(_simulations(task))
    for simulation in simulations:
        check(simulation, [each.key for each in task.ranges])
    logits = torch.tensor([_logit(each, task.given[each.key]) for each in task.ranges], dtype=torch.float64, requires_grad=True)
    adam = torch.optim.Adam([logits], lr=RATE)
    best, least = logits.detach().clone(), math.inf
    for _ in range(iterations):
        adam.zero_grad()
        values = {each.key: _value(each, logit).float()[None] for each, logit in zip(task.ranges, logits, strict=True)}
        total = 0.0
        for simulation in simulations:  # one graph at a time
            error = squared_errors(rollouts(simulation, values, quantise=False), simulation.scenario).sum() / len(simulations)
            error.backward(retain_graph=True)  # type: ignore[no-untyped-call]
            total += error.item()
        if total < least:
            best, least = logits.detach().clone(), total
        adam.step()
        advance()
    return {each.key: _rounded(each, float(_value(each, logit))) for each, logit in zip(task.ranges, best, strict=True)}


def _rounded(each: Range, value: float) -> float:
    """To six digits that count, and not out of the range."""
    return min(max(float(f"{value:.6g}"), each.low), each.high)


def squared_errors(rollout: Rollout, scenario: Scenario) -> Tensor:
    """Mean over all steps of log(1 + squared error), `[B]`, errors counting in what settled symbols may have.

    The logarithm makes a step outside of that dear however far outside it is, so that the sum stands for the time to settle.
    """
    symbol = scenario.symbol
    near = rollout.errors.new_tensor([NEAR * symbol.length_m, NEAR * symbol.width_m, *NEAR_ANGLES])
    return ((rollout.errors / near).square().log1p().sum(-1) + LOST * ~rollout.seen).mean(-1)


def _simulations(task: Task) -> Iterator[Simulation]:
    """Of all runs, their symbols seen with soft edges."""
    for scenario in task.scenarios:
        if not isinstance(scenario.extraction, ExtractionParams):
            raise LuxloopError(f"{scenario.name}: extraction.kind: has no soft edges to descend on; leave it out, or tune without")
        soft = scenario.model_copy(update={"extraction": scenario.extraction.model_copy(update={"edges": "soft"})})
        ready = prepare(soft, task.device)
        yield from (with_seed(ready, scenario.seed + k) for k in range(task.seeds))


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
