"""Light of a step with other primitives: symbols in open loop, without covering functions, of masks alone, or without painted pictures."""

from dataclasses import replace

from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.loop.simulation.lamps import Lights
from luxloop.loop.simulation.result import StepResult, without
from luxloop.loop.simulation.simulation import Simulation

TAKEN = 0.01  # smallest share of a symbol's light that counts as covered


def open_loop_lights(simulation: Simulation, result: StepResult, name: str) -> tuple[Lights, Lights]:
    """Lights of a step with one closed-loop symbol in open loop, and without that symbol."""
    target = ProjectionCommand(simulation.controlled[name].projector.target)
    return simulation.evaluator.redraw(result, name, target), simulation.lights_of(result, without(result.planning.drawn, [name]))


def lights_without_paint(simulation: Simulation, result: StepResult) -> tuple[Utilisation, ...]:
    """Lights of a step without painted pictures."""
    if not simulation.planner.painted:
        return tuple(map(Utilisation, result.lights))
    lighting = simulation.planner.lighting.model_copy(update={"painted": ()})
    bare = replace(simulation, planner=replace(simulation.planner, lighting=lighting))
    return bare.lights_of(result, result.planning.drawn)


def mask_limits(simulation: Simulation, result: StepResult) -> tuple[Tensor, ...]:
    """Largest utilisation `[n_p]` of each module that masks and their soft zones leave in a step."""
    plan = simulation.planner.compose(result.now, result.planning.functions, result.planning.drawn)
    return tuple(module.mask_limit(plan) for module in simulation.lamps.aim(result.now))


def covering(simulation: Simulation, result: StepResult, name: str) -> tuple[str, ...]:
    """Names of the functions that, each alone with a closed-loop symbol, take light from the symbol in a step."""
    drawn = result.planning.drawn

    def own(*others: str) -> float:
        on, off = (simulation.lights_of(result, {each: drawn[each] for each in names}) for names in ((name, *others), others))
        return sum(float((on[k].u - off[k].u).abs().sum()) for k in simulation.controlled[name].drawn_by)

    least = (1 - TAKEN) * own()
    return tuple(other for other in drawn if other != name and own(other) < least)
