"""Pixel controllers by name: what a scenario turns primitives into utilisations with."""

from typing import cast

from luxloop.controllers.pixels.jpo import Jpo
from luxloop.controllers.pixels.ssc import PixelController, Ssc
from luxloop.loop.scenario.model import Scenario
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.plugin import Guard, Name, load, running


def pixel_controller(scenario: Scenario, headlight: Headlight) -> PixelController:
    """The pixel controller that a scenario names, for one headlight, over a dark base pattern.

    One of the user's own, "package.module:Name", is made by its `Name.prepare(headlight)`.
    Raises LuxloopError where there is no such class, or it cannot be made.
    """
    match scenario.pixel_controller:
        case "ssc":
            return Ssc.prepare(headlight, scenario.ssc)
        case "jpo":
            return Jpo.prepare(headlight, scenario.jpo, mrpc=scenario.ssc)
        case name:
            return _own(Name(name), headlight)


def _own(name: Name, headlight: Headlight) -> PixelController:
    key = "pixel_controller"
    made_by = load(name, key, ("prepare", "utilisation", "over"))
    with running(name, key, "prepare"):
        made = made_by.prepare(headlight)
    if lacking := [part for part in ("headlight", "default", "utilisation", "over") if not hasattr(made, part)]:
        raise LuxloopError(f"{key}: {name} has no {lacking[0]!r}; write one as in docs/python.md")
    return cast(PixelController, Guard(made, name, key))
