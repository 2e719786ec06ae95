"""A controller of the user's own, named in the scenario by `package.module:Name`."""

from typing import Any, cast

from pydantic import Field

from luxloop.controllers.symbol.laws.stages import StagedParams
from luxloop.controllers.symbol.sensing.protocol import SymbolController
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.world import plugin

KEY = "controller.name"
METHODS = ("start", "projection", "step")


class OwnParams(StagedParams):
    """`Name(sensor, **options)` of a module of the user's own makes the controller."""

    name: plugin.OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name, beside the sensor")


def own_controller(params: OwnParams, sensor: SymbolSensor) -> SymbolController:
    """Import and call it. Raises LuxloopError where there is none, it does not take what it is given, or lacks a method."""
    return cast(SymbolController, plugin.make(params.name, KEY, {"sensor": sensor}, params.options, METHODS))
