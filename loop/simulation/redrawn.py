"""Light of a step with other primitives: symbols in open loop, without covering functions, of masks alone, or without painted pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from torch import Tensor

from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.frames import inverse

TAKEN = 0.01  # smallest share of a symbol's light that counts as covered
Pair = tuple[tuple[Utilisation, ...], tuple[Utilisation, ...]]


def open_loop_lights(simulation: Simulation, result: StepResult, name: str) -> Pair:
    """Lights of a step with one closed-loop symbol in open loop, and without that symbol."""
    target = ProjectionCommand(simulation.controlled[name].projector.target)
    return _pair(simulation, result, name, _primitives(simulation, result, {name: target}))


def lights_without_paint(simulation: Simulation, result: StepResult) -> tuple[Utilisation, ...]:
    """Lights of a step without painted pictures."""
    if not simulation.planner.painted:
        return tuple(map(Utilisation, result.lights))
    lighting = simulation.planner.lighting.model_copy(update={"painted": ()})
    bare = replace(simulation, planner=replace(simulation.planner, lighting=lighting))
    return bare.lights_of(result, _primitives(simulation, result, {}))


def mask_limits(simulation: Simulation, result: StepResult) -> tuple[Tensor, ...]:
    """Largest utilisation `[n_p]` of each module that masks and their soft zones leave in a step."""
    plan = simulation.planner.compose(result.now, result.planning.functions, _primitives(simulation, result, {}))
    return tuple(module.mask_limit(plan) for module in simulation.lamps.aim(result.now))


def covering(simulation: Simulation, result: StepResult, name: str) -> tuple[str, ...]:
    """Names of the functions that, each alone with a closed-loop symbol, take light from the symbol in a step."""
    drawn = _primitives(simulation, result, {})

    def own(*others: str) -> float:
        on, off = _pair(simulation, result, name, {each: drawn[each] for each in (name, *others)})
        return sum(float((on[k].u - off[k].u).abs().sum()) for k in simulation.controlled[name].drawn_by)

    least = (1 - TAKEN) * own()
    return tuple(other for other in drawn if other != name and own(other) < least)


def _primitives(simulation: Simulation, result: StepResult, others: dict[str, ProjectionCommand]) -> dict[str, Sequence[Primitives]]:
    """Primitives of a step's functions, with other projections for some symbols."""
    T_ground_body = result.sense.view.T_world_view @ inverse(simulation.view.T_world_view)
    projections = {**result.planning.projections} | others
    commands = {name: simulation.controlled[name].command(each, T_ground_body) for name, each in projections.items()}
    return {**simulation.planner.draw(result.now, result.planning.functions), **commands}


def _pair(simulation: Simulation, result: StepResult, name: str, drawn: Mapping[str, Sequence[Primitives]]) -> Pair:
    without = {other: each for other, each in drawn.items() if other != name}
    return simulation.lights_of(result, drawn), simulation.lights_of(result, without)
