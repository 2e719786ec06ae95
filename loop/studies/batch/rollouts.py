"""Rollouts of many gain sets at once: one world and one camera crop for all, and differentiable from gains to errors."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from luxloop.controllers.symbol.feedback import ThesisPid, ThesisPidParams
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation, Projection
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.controllers.symbol.stages import Lifting
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch import copies
from luxloop.loop.studies.batch.copies import Copies
from luxloop.loop.studies.batch.looking import Taken
from luxloop.perception.extraction import ExtractionStatus
from luxloop.world.errors import LuxloopError, did_you_mean

# Keys of thesis_pid that are tensors in its law: the gains' field, which of the loops x, y, roll, pitch, and the key's unit in theirs.
GAINS: dict[str, tuple[str, tuple[int, ...], float]] = {
    **{
        f"controller.{kind}.{gain}": (gain, loops, 1.0)
        for kind, loops in (("position", (0, 1)), ("rotation", (2, 3)))
        for gain in ("kp", "ki", "kd")
    },
    **{f"controller.{kind}.tracking_steps": ("tracking_time", loops, 1.0) for kind, loops in (("position", (0, 1)), ("rotation", (2, 3)))},
    "controller.x_rate_m": ("rate_limit", (0,), 1.0),
    "controller.y_rate_m": ("rate_limit", (1,), 1.0),
    "controller.roll_rate_deg": ("rate_limit", (2,), math.pi / 180),
    "controller.pitch_rate_deg": ("rate_limit", (3,), math.pi / 180),
}


def check(simulation: Simulation, keys: Any) -> None:
    """Raises LuxloopError if a scenario cannot be rolled out in batches, or has no gains of these keys."""
    copies.check(simulation, "tune without --gradient")
    scenario, controller = simulation.scenario, simulation.symbol.params
    if not isinstance(controller, ThesisPidParams):
        raise LuxloopError(f"{scenario.name}: batches of gains are for controller.name = thesis_pid, not {controller.name}")
    for key in keys:
        if _gain(key) not in GAINS:
            before = key.removesuffix(_gain(key))
            raise LuxloopError(f"{key}: has no gradient; {did_you_mean(key, [before + gain for gain in GAINS])}")
    if controller.warp or controller.supervisor:
        raise LuxloopError(f"{scenario.name}: batches of gains have no stages; leave out controller.warp and controller.supervisor")
    if scenario.camera.drop_probability or scenario.disturbances.drops or scenario.camera.latency_spread_steps:
        raise LuxloopError(
            f"{scenario.name}: batches of gains are for cameras of which no frame is lost and all are equally late; tune without --gradient"
        )


def _gain(key: str) -> str:
    """A key of the controller without the name of its function."""
    return key[max(key.find("controller."), 0) :]


def rollouts(simulation: Simulation, values: dict[str, Tensor], *, quantise: bool = True) -> Rollout:
    """Run a standing scenario with thesis_pid for B sets of gains. values: `[B]` by keys of GAINS, in their units.

    All have the noise of a single run. quantise: False leaves digital numbers unrounded, for gradients; use edges = "soft" with it.
    Raises LuxloopError as `check`.
    """
    check(simulation, values)
    many, seed, disturbances = Copies(simulation), simulation.scenario.seed, simulation.scenario.disturbances
    return loops(
        simulation,
        values,
        lambda poses, step: many.measured(many.show(poses), [Taken(seed, step, disturbances)] * len(poses), quantise=quantise),
    )


def loops(simulation: Simulation, values: dict[str, Tensor], look: Callable[[Tensor, int], Measurement]) -> Rollout:
    """The same with another measurement: `look` measures poses `[B, 4]` that are shown in a step."""
    assert isinstance(simulation.symbol.controller, Lifting)  # of which a batch needs nothing: nothing is searched for
    controller = with_values(simulation.symbol.controller.inner, values)
    (batch,) = {len(value) for value in values.values()}
    start = simulation.symbol.start().controller.inner.pid.output
    state = controller.start(start.expand(batch, -1).to(next(iter(values.values()))))
    late, looks, rows = simulation.scenario.camera.latency_steps, [], []
    for step in range(simulation.scenario.steps):
        pose = controller.projection(state, None).pose
        looks.append(look(pose, step))
        seen = looks[step - late] if step >= late else simulation.symbol.sensor.lost(pose, ExtractionStatus.NO_FRAME)
        state = controller.step(state, Observation(seen, None, Projection(ProjectionCommand(pose), ())))
        usable = (seen.code == ExtractionStatus.SEEN) & seen.pose_error.isfinite().all(-1)
        rows.append((pose, torch.where(usable[:, None], seen.pose_error, 0.0), usable))
    return Rollout(*(torch.stack(column, 1) for column in zip(*rows, strict=True)))


def with_values(controller: Any, values: dict[str, Tensor]) -> ThesisPid:
    """thesis_pid with gains `[B, 4]`, of `values` where they have the key."""
    gains = controller.gains
    for key, value in values.items():
        name, loops, unit = GAINS[_gain(key)]
        columns = list(getattr(gains, name).to(value).expand(len(value), 4).unbind(-1))
        for loop in loops:
            columns[loop] = unit * value
        gains = replace(gains, **{name: torch.stack(columns, -1)})
    made: ThesisPid = replace(controller, gains=gains)
    return made
