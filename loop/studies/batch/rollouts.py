"""A control law for B copies, and rollouts of many sets of gains at once, differentiable from gains to errors."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from operator import attrgetter
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.pid import PidGains
from luxloop.controllers.symbol.feedback import Feedback, ThesisPid, ThesisPidParams
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement, Observation, Projection, SymbolController
from luxloop.controllers.symbol.stages import RoadStage
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch import copies
from luxloop.loop.studies.batch.copies import Conditions, Copies, stack
from luxloop.perception.appearance import DEGREES
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.errors import LuxloopError, did_you_mean

Look = Callable[[ProjectionCommand, int], Measurement]  # measurement of B projections in a step

# Tunable keys of thesis_pid: field of the gains, loops, and the key's unit in the field's unit.
GAINS: dict[str, tuple[str, tuple[int, ...], float]] = {
    **{
        f"controller.{kind}.{key}": (field, tuple(i for i, each in enumerate(DEGREES) if each.unit == unit), 1.0)
        for kind, unit in (("position", "m"), ("rotation", "rad"))
        for key, field in (("kp", "kp"), ("ki", "ki"), ("kd", "kd"), ("tracking_steps", "tracking_time"))
    },
    **{f"controller.{each.name}_rate_{each.suffix}": ("rate_limit", (loop,), each.of_file(1.0)) for loop, each in enumerate(DEGREES)},
}


def check(simulation: Simulation, keys: Any) -> None:
    """Raise LuxloopError if a scenario cannot be rolled out in batches, or has no gains of these keys."""
    copies.check(simulation, "tune without --gradient")
    scenario, controller = simulation.scenario, simulation.symbol.params
    if not isinstance(controller, ThesisPidParams):
        raise LuxloopError(f"{scenario.name}: batches of gains are for controller.name = thesis_pid, not {controller.name}")
    for key in keys:
        if _gain(key) not in GAINS:
            before = key.removesuffix(_gain(key))
            raise LuxloopError(f"{key}: has no gradient; {did_you_mean(key, [before + gain for gain in GAINS])}")
    if other := next((key for key in ("warp", "supervisor", "gain_schedule") if getattr(controller, key)), None):
        raise LuxloopError(f"{scenario.name}: batches of gains are for fixed gains without stages; leave out controller.{other}")
    if scenario.camera.drop_probability or scenario.disturbances.drops or scenario.camera.latency_spread_steps:
        raise LuxloopError(
            f"{scenario.name}: batches of gains are for cameras of which no frame is lost and all are equally late; tune without --gradient"
        )


def _gain(key: str) -> str:
    """Key of the controller without the name of its function."""
    return key[max(key.find("controller."), 0) :]


def rollouts(simulation: Simulation, values: dict[str, Tensor], *, quantise: bool = True) -> Rollout:
    """Runs of a standing scenario with thesis_pid for B sets of gains. values: `[B]` by keys of GAINS, in their units.

    All have the noise of a single run. quantise: False leaves digital numbers unrounded, for gradients; use edges = "soft" with it. Raises
    LuxloopError as `check`.
    """
    check(simulation, values)
    many, seed, disturbances = Copies(simulation), simulation.scenario.seed, simulation.scenario.disturbances

    def look(projection: ProjectionCommand, step: int) -> Measurement:
        frames = [Conditions(seed, step, disturbances)] * len(projection.pose)
        return stack(many.measure(many.show(projection), frames, quantise=quantise))

    return rollouts_by(look, simulation, values)


def rollouts_by(look: Look, simulation: Simulation, values: dict[str, Tensor]) -> Rollout:
    """Runs as of `rollouts` with another measurement."""
    assert isinstance(simulation.symbol.controller, RoadStage)  # without search for another road
    law = with_gains(simulation.symbol.controller.inner, values)
    (batch,) = {len(value) for value in values.values()}
    start = simulation.symbol.start().controller.inner.pid.output.expand(batch, -1).to(next(iter(values.values())))
    rows = []
    for projection, seen in loops(law, simulation, start, look):
        usable = (seen.code == ExtractionStatus.SEEN) & seen.pose_error.isfinite().all(-1)
        rows.append((projection.pose, torch.where(usable[:, None], seen.pose_error, 0.0), usable))
    return Rollout(*(torch.stack(column, 1) for column in zip(*rows, strict=True)))


def loops(law: SymbolController, simulation: Simulation, start: Tensor, look: Look) -> Iterator[tuple[ProjectionCommand, Measurement]]:
    """Projections of B copies from start poses `[B, 4]` on in each step of a scenario, and the measurement that arrives in it."""
    state, late, looks = law.start(start), simulation.scenario.camera.latency_steps, list[Measurement]()
    for step in range(simulation.scenario.steps):
        projection = law.projection(state, None)
        looks.append(look(projection, step))
        lost = step < late
        seen = simulation.symbol.sensor.lost(projection.pose, ExtractionStatus.NO_FRAME) if lost else looks[step - late]
        state = law.step(state, Observation(seen, None, Projection(projection, ()), latency_steps=late))
        yield projection, seen


def with_gains(controller: Any, values: dict[str, Tensor]) -> ThesisPid:
    """thesis_pid with the gains `[B, 4]` in `values`, else its own."""
    gains = controller.gains
    for key, value in values.items():
        name, axes, unit = GAINS[_gain(key)]
        columns = list(getattr(gains, name).to(value).expand(len(value), 4).unbind(-1))
        for axis in axes:
            columns[axis] = unit * value
        gains = replace(gains, **{name: torch.stack(columns, -1)})
    law: ThesisPid = replace(controller, gains=gains)
    return law


def stack_laws(controllers: Sequence[SymbolController]) -> SymbolController:
    """One law from controllers of one kind, lifted or not, with the values of each in a row `[B, ...]`."""
    laws: list[Any] = [each.inner if isinstance(each, RoadStage) else each for each in controllers]
    first = laws[0]

    def rows(*names: str) -> dict[str, Any]:
        found = ([torch.as_tensor(attrgetter(name)(each), device=first.target.device) for each in laws] for name in names)
        return {name.split(".")[-1]: torch.stack(each) for name, each in zip(names, found, strict=True)}

    if isinstance(first, ThesisPid):
        later = tuple(map(_stack_gains, zip(*(law.later for law in laws), strict=True)))
        return replace(first, gains=_stack_gains([law.gains for law in laws]), later=later, **rows("losses_to_reset"))
    if isinstance(first, Feedback):
        return replace(first, **rows("low", "high", "gain", "losses_to_reset"))
    law: SymbolController = first
    return law


def _stack_gains(banks: Sequence[PidGains]) -> PidGains:
    stacked: Any = {
        each.name: torch.stack([getattr(bank, each.name) for bank in banks]) for each in fields(PidGains) if each.name != "form"
    }
    return replace(banks[0], **stacked)


def choose(chosen: Tensor, new: Any, old: Any) -> Any:
    """Rows of two values with tensors `[B, ...]`: of `new` where chosen `[B]` is True, else of `old`."""
    if isinstance(new, Tensor):
        return torch.where(chosen.view(-1, *[1] * (new.dim() - 1)), new, old)
    if not hasattr(new, "__dataclass_fields__"):
        return new
    return replace(new, **{each.name: choose(chosen, getattr(new, each.name), getattr(old, each.name)) for each in fields(new)})
