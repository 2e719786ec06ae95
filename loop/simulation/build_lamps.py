"""The modules of the car's lamps that a scenario chooses: where they are mounted, how they are turned, how bright they are."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor

from luxloop.loop.scenario.model import HeadlightParams
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module, Range
from luxloop.world.lamps.description import load_lamp

TurnedPart = TypeVar("TurnedPart", Lamp, Module)


@dataclass(frozen=True, eq=False)
class MountedModule:
    """One module of a lamp on the car.

    number: its place in the lamp. headlight: its light with the scenario's intensity. T_world_module: `[4, 4]`, at rest. swivel_deg,
    level_deg: how far it can be turned from there, least and most.
    """

    side: str
    lamp: Lamp
    number: int
    headlight: Headlight
    T_world_module: Tensor
    swivel_deg: Range
    level_deg: Range

    @property
    def name(self) -> str:
        """As lighting functions name it, "left hires"."""
        return f"{self.side} {self.lamp.modules[self.number].name}"


def mounted(params: HeadlightParams, device: torch.device, unnamed: Callable[[Lamp], Sequence[Module]]) -> Iterator[MountedModule]:
    """The modules that a scenario names in each of its lamps, those that `unnamed` chooses where it names none.

    Raises LuxloopError where there is no such lamp, module or movement, and where the modules of a lamp give no light.
    """
    for side in params.lamps:
        lamp = load_lamp(params.model, side)
        with locate("headlight.modules"):
            modules = unnamed(lamp) if params.modules is None else [lamp.module(name) for name in params.modules]
        names = ", ".join(module.name for module in modules)
        for movement in ("swivel_deg", "level_deg"):
            if getattr(params, movement) and not any(any(getattr(module, movement)) for module in modules):
                raise LuxloopError(f"headlight.{movement}: none of the modules ({names}) can turn in this way; leave it out or name others")
        peak_cd = max(module.headlight.peak_cd for module in modules)
        if not peak_cd > 0:
            raise LuxloopError(f"headlight.modules: {names} give no light; name others")
        scale = 1.0 if params.intensity_cd is None else params.intensity_cd / peak_cd
        for module in modules:
            number = [each.name for each in lamp.modules].index(module.name)
            rest, light = turned(module, side, params), module.headlight.scale(scale).to(device)
            T_world_module = T_world_lamp(side, params) @ rest.T_lamp_module
            yield MountedModule(side, lamp, number, light, T_world_module.to(device), rest.swivel_deg, rest.level_deg)


def T_world_lamp(side: str, params: HeadlightParams) -> Tensor:
    """Pose `[4, 4]` of a lamp on the car."""
    return pose_from_degrees((0.0, (0.5 if side == "left" else -0.5) * params.distance_m, params.height_m))


def turned(part: TurnedPart, side: str, params: HeadlightParams) -> TurnedPart:
    """A lamp or module turned as a scenario says. Raises LuxloopError that names the lamp's side where it cannot be turned so far."""
    try:
        return part.turn(params.swivel_deg, params.level_deg)
    except LuxloopError as error:
        mirrored = "; a right lamp is the left one's mirror image, and so is its range" if side == "right" else ""
        raise LuxloopError(f"headlight: {side} lamp, {error}{mirrored}") from error
