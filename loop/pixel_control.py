"""Pixel controllers by name: what a scenario turns primitives into utilisations with."""

from torch import Tensor

from controllers.jpo import Jpo
from controllers.ssc import PixelController, Ssc
from loop.scenario import WorldScenario
from world.errors import LuxloopError
from world.headlight import Headlight
from world.plugin import load


def pixel_controller(scenario: WorldScenario, headlight: Headlight, default: Tensor | None = None) -> PixelController:
    """The pixel controller that a scenario names, for one headlight; default: `[n_p]`, the base pattern (dark).

    One of the user's own, "package.module:Name", is made by its `Name.prepare(headlight)`.
    Raises LuxloopError where there is no such class, or it cannot be made.
    """
    match scenario.pixel_controller:
        case "ssc":
            return Ssc.prepare(headlight, scenario.ssc, default)
        case "jpo":
            return Jpo(Ssc.prepare(headlight, scenario.ssc, default), scenario.jpo)
        case name:
            own = _own(name, headlight)
            return own if default is None else own.over(default)


def _own(name: str, headlight: Headlight) -> PixelController:
    found = load(name, "pixel_controller")
    made = found.prepare(headlight) if hasattr(found, "prepare") else found
    lacking = [part for part in ("prepare", "headlight", "default", "utilisation", "over") if not hasattr(made, part)]
    if lacking:
        raise LuxloopError(f"pixel_controller: {name} has no {lacking[0]!r}; write one as docs/python.md has it")
    controller: PixelController = made
    return controller
