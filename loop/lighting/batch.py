"""Rollouts of many gain sets at once: one world and one camera crop for all, and differentiable from gains to errors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from controllers.symbol.laws.lifting import Lifting
from controllers.symbol.laws.thesis_pid import ThesisPid, ThesisPidParams
from controllers.symbol.sensing.projection import ProjectionCommand
from controllers.symbol.sensing.protocol import Observation, Shown
from controllers.symbol.sensing.symbol_sensor import Measurement
from loop.lighting.simulation import Simulation
from loop.scenario.model import only
from loop.scenario.plant import SimulatedPlantParams
from perception.camera import expose
from perception.extraction import Crop, Loss, symbol_image
from perception.noise import FrameNoise
from world.errors import LuxloopError, did_you_mean
from world.light.illumination import Transport, added_light

Lights = tuple[Utilisation, ...]

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


@dataclass(frozen=True)
class Rollout:
    """poses: `[B, steps, 4]` that were shown (x, y in m, roll, pitch in rad). errors: `[B, steps, 4]`, how far the symbol was seen to be
    off in the same units, 0 where it was lost. seen: `[B, steps]` bool, whether it was not."""

    poses: Tensor
    errors: Tensor
    seen: Tensor


def check(simulation: Simulation, keys: Any) -> None:
    """Raises LuxloopError where a scenario cannot be rolled out in batches, or has no such gains."""
    scenario, controller = simulation.scenario, simulation.symbol.params
    if not isinstance(controller, ThesisPidParams):
        raise LuxloopError(f"{scenario.name}: batched rollouts are for controller.name = thesis_pid, not {controller.name}")
    for key in keys:
        if _gain(key) not in GAINS:
            before = key.removesuffix(_gain(key))
            raise LuxloopError(f"{key}: has no gradient; {did_you_mean(key, [before + gain for gain in GAINS])}")
    if controller.warp or controller.supervisor:
        raise LuxloopError(f"{scenario.name}: batched rollouts have no stages; leave out controller.warp and controller.supervisor")
    if scenario.metered:
        others = "other functions, the detector and objects' categories"
        raise LuxloopError(f"{scenario.name}: batched rollouts support only a single symbol; take {others} out, or tune without --gradient")
    if scenario.lighting.painted:
        raise LuxloopError(
            f"{scenario.name}: lighting.painted: batched rollouts show no painted pixels; leave it out, or tune without --gradient"
        )
    if timed := [key for key in ("start_s", "stop_s", "indicated") if getattr(scenario.symbol, key) is not None]:
        key = f"functions.{only(scenario.controlled)}.{timed[0]}"
        raise LuxloopError(
            f"{scenario.name}: {key}: batched rollouts show the symbol in all steps; leave it out, or tune without --gradient"
        )
    changing = ("oncoming", "ambient", "noise", "drops")
    if found := [name for name in changing if getattr(scenario.disturbances, name)]:
        raise LuxloopError(
            f"{scenario.name}: batched rollouts do not support disturbances.{found[0]}; leave it out, or tune without --gradient"
        )
    if not isinstance(scenario.plant, SimulatedPlantParams):
        raise LuxloopError(
            f"{scenario.name}: batched rollouts need the simulated plant, not {scenario.plant.kind}; tune without --gradient"
        )
    world, camera = simulation.world, scenario.camera
    still = [scenario.vehicle is None, not world.moving, camera.drop_probability == 0, camera.latency_spread_steps == 0]
    if not (all(still) and all(isinstance(each, Transport) for each in world.lit(0.0).transports)):
        raise LuxloopError(
            f"{scenario.name}: batched rollouts are for scenes in which nothing moves, no frame is lost and all are equally late; "
            "tune without --gradient"
        )


def _gain(key: str) -> str:
    """A key of the controller without the name of its function."""
    return key[max(key.find("controller."), 0) :]


def rollouts(simulation: Simulation, values: dict[str, Tensor], *, quantise: bool = True) -> Rollout:
    """Run a standing scenario with thesis_pid for B sets of gains. values: `[B]` by keys of GAINS, in their units.

    The noise of all is that of a single run. quantise: false leaves digital numbers unrounded, for gradients; take edges = "soft" with it.
    """
    check(simulation, values)
    return loops(simulation, values, lambda poses, step: look(simulation, poses, step, quantise=quantise))


def loops(simulation: Simulation, values: dict[str, Tensor], look: Callable[[Tensor, int], Measurement]) -> Rollout:
    """The same around anything that looks at poses `[B, 4]` that are shown at a step."""
    assert isinstance(simulation.symbol.controller, Lifting)  # of which a batch needs nothing: nothing is searched for
    controller = with_values(simulation.symbol.controller.inner, values)
    (batch,) = {len(value) for value in values.values()}
    start = simulation.symbol.start().controller.inner.pid.output
    state = controller.start(start.expand(batch, -1).to(next(iter(values.values()))))
    late, looks, rows = simulation.scenario.camera.latency_steps, [], []
    for step in range(simulation.scenario.steps):
        pose = controller.projection(state, None).pose
        looks.append(look(pose, step))
        seen = looks[step - late] if step >= late else simulation.symbol.sensor.lost(pose, Loss.NO_FRAME)
        state = controller.step(state, Observation(seen, None, Shown(ProjectionCommand(pose), ())))
        usable = (seen.code == Loss.SEEN) & seen.pose_error.isfinite().all(-1)
        rows.append((pose, torch.where(usable[:, None], seen.pose_error, 0.0), usable))
    return Rollout(*(torch.stack(column, 1) for column in zip(*rows, strict=True)))


def with_values(controller: Any, values: dict[str, Tensor]) -> ThesisPid:
    """thesis_pid with gains `[B, 4]`."""
    gains = controller.gains
    for key, value in values.items():
        name, loops, unit = GAINS[_gain(key)]
        columns = list(getattr(gains, name).to(value).expand(len(value), 4).unbind(-1))
        for loop in loops:
            columns[loop] = unit * value
        gains = replace(gains, **{name: torch.stack(columns, -1)})
    made: ThesisPid = replace(controller, gains=gains)
    return made


def look(simulation: Simulation, poses: Tensor, step: int, *, quantise: bool = True) -> Measurement:
    """What the camera sees of poses `[B, 4]` at a step, exposed only where their light can be."""
    symbol, view, camera = simulation.symbol, simulation.world.lit(0.0), simulation.scenario.camera
    sensor, crop = symbol.sensor, symbol.footprint(ProjectionCommand(poses))
    if crop.v_stop - crop.v_start < 2 or crop.u_stop - crop.u_start < 2:
        return sensor.lost(poses, Loss.NOTHING)
    # One by one: the few rays and pixels that each pose touches are quicker than all of a batch.
    lights, resting, seed = [symbol.projector.light(pose) for pose in poses], _resting(simulation, step), simulation.scenario.seed
    shown = [_among(resting, symbol.drawn_by, light) for light in lights]
    on, off = (
        expose(light, camera, noise.part(crop.slices, light), quantise=quantise)
        for light, noise in (
            (_luminance(view.transports, shown, view.base, crop), FrameNoise.of(seed, step, 0)),
            (_luminance(view.transports, [resting], view.base, crop)[0], FrameNoise.of(seed, step, 1)),
        )
    )
    model = sensor.model
    flat = _luminance(model.transports, lights, -model.beams, crop)
    return sensor.compare(on, off, symbol_image(flat, model.limit[crop.slices], model.params), crop)


def _resting(simulation: Simulation, step: int) -> Lights:
    """The base beams of all modules at a step."""
    planner = simulation.planner
    plan = planner.composed(simulation.situation(step / simulation.scenario.rate_hz), planner.start(), {})
    beams = [module.base(plan) for module in simulation.modules]
    return tuple(Utilisation(beam, None if bool(beam.any()) else slice(0, 0)) for beam in beams)


def _among(resting: Lights, numbers: Sequence[int], light: Lights) -> Lights:
    """Lights of all modules, of which those with these numbers show a light in place of their base beams."""
    drawn = dict(zip(numbers, light, strict=True))
    return tuple(drawn.get(k, each) for k, each in enumerate(resting))


def _luminance(transports: Any, lights: list[Lights], base: Tensor, crop: Crop) -> Tensor:
    """Luminance `[B, h, w]` in cd/m^2 at a crop, of lights on top of a base `[height, width]`."""
    width = base.shape[-1]
    parts = [each.within(crop.v_start * width, crop.v_stop * width) for each in transports]
    rows, columns = crop.slices
    return torch.stack([added_light(parts, light, base[rows])[:, columns] for light in lights])
