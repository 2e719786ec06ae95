"""A lamp: modules with their mounts and movements, and named beams (T 2.2, 5.2)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight

Range = tuple[float, float]
ALWAYS = ("full", "off")  # beams of every lamp
_MIRROR = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0], dtype=torch.float64))


@dataclass(frozen=True)
class ModuleCommand:
    """Turn of a module from its rest pose, and dimming; by default at rest and undimmed.

    swivel_deg: to the left positive (bending). level_deg: nose down positive (levelling). intensity: limit of its maximum intensity as a
    share, 0..1.
    """

    swivel_deg: float = 0.0
    level_deg: float = 0.0
    intensity: float = 1.0

    def turn(self, T: Tensor) -> Tensor:
        """The pose `[4, 4]` of a module at rest, turned about its photometric centre."""
        if not (self.swivel_deg or self.level_deg):
            return T
        return T @ pose_from_degrees((0.0, 0.0, 0.0), 0.0, self.level_deg, self.swivel_deg).to(T)


Commands = tuple[ModuleCommand, ...]  # one per module; empty if all are at rest
REST = ModuleCommand()


@dataclass(frozen=True)
class Module:
    """One module: its light, mount and ranges of movement.

    T_lamp_module: `[4, 4]` float64, from the module's headlight frame to the lamp's. swivel_deg: least and greatest turn about the
    mount's z axis, to the left positive (bending). level_deg: the same about its y axis, nose down positive (levelling). draws_only: fitted
    beams leave it dark, for what lighting functions draw.
    """

    name: str
    headlight: Headlight
    T_lamp_module: Tensor = field(default_factory=lambda: torch.eye(4, dtype=torch.float64))
    swivel_deg: Range = (0.0, 0.0)
    level_deg: Range = (0.0, 0.0)
    draws_only: bool = False

    def pose(self, swivel_deg: float = 0.0, level_deg: float = 0.0) -> Tensor:
        """`T_lamp_module` `[4, 4]` of the module turned about its photometric centre. Raises LuxloopError beyond its range."""
        for movement, angle, (low, high) in (("swivel", swivel_deg, self.swivel_deg), ("level", level_deg, self.level_deg)):
            if not low <= angle <= high:
                raise LuxloopError(f"module {self.name!r}: {movement} of {angle:g} deg is out of its range, {low:g} to {high:g} deg")
        return ModuleCommand(swivel_deg, level_deg).turn(self.T_lamp_module)

    def turn(self, swivel_deg: float, level_deg: float) -> "Module":
        """The module with the turned pose as its rest pose, and with the remaining ranges.

        A module without a range of swivel does not swivel; one without a range of levelling is tilted with the lamp. Raises as `pose`.
        """
        swivel, level = (
            angle if any(movement) else 0.0 for angle, movement in ((swivel_deg, self.swivel_deg), (level_deg, self.level_deg))
        )
        swivels, levels = ((low - angle, high - angle) for angle, (low, high) in ((swivel, self.swivel_deg), (level, self.level_deg)))
        tilt = pose_from_degrees((0.0, 0.0, 0.0), pitch_deg=level_deg - level)
        return replace(self, T_lamp_module=tilt @ self.pose(swivel, level), swivel_deg=swivels, level_deg=levels)

    def mirror(self) -> "Module":
        """The module of the other side's lamp."""
        low, high = self.swivel_deg
        T = _MIRROR @ self.T_lamp_module @ _MIRROR
        return replace(self, headlight=self.headlight.mirror(), T_lamp_module=T, swivel_deg=(-high, -low))


@dataclass(frozen=True)
class Lamp:
    """One headlamp. beams: utilisations `[n_p]`, one per module, by the beam's name. notes: what is published and what is assumed."""

    name: str
    modules: tuple[Module, ...]
    beams: Mapping[str, tuple[Tensor, ...]] = field(default_factory=lambda: MappingProxyType({}))
    notes: str = ""

    def module(self, name: str) -> Module:
        """The module of a name. Raises LuxloopError that lists the modules."""
        for module in self.modules:
            if module.name == name:
                return module
        raise LuxloopError(f"lamp {self.name!r} has no module {name!r}; it has {', '.join(module.name for module in self.modules)}")

    def turn(self, swivel_deg: float, level_deg: float) -> "Lamp":
        """The lamp turned: all modules levelled, and swivelled where they can. Raises LuxloopError beyond a module's range."""
        return replace(self, modules=tuple(module.turn(swivel_deg, level_deg) for module in self.modules))

    @property
    def finest(self) -> Module:
        """The module with the smallest pixels on the texture plane, which is best for symbols."""
        return min(self.modules, key=lambda module: pixel_area(module.headlight))

    @property
    def field_deg(self) -> tuple[float, float, float, float]:
        """Field of all modules as angles in deg from the axis: left and right (left positive), bottom and top (up positive)."""
        edge = torch.linspace(0, 1, 33, dtype=torch.float64)
        h, v = [], []
        for module in self.modules:
            light = module.headlight
            y, z = light.left + edge * (light.right - light.left), light.bottom + edge * (light.top - light.bottom)
            borders = [(y, torch.full_like(y, light.top)), (y, torch.full_like(y, light.bottom))]
            borders += [(torch.full_like(z, light.left), z), (torch.full_like(z, light.right), z)]
            ray = torch.stack([torch.ones(4, 33, dtype=torch.float64), *(torch.stack(each) for each in zip(*borders, strict=True))])
            x, y, z = module.T_lamp_module[:3, :3] @ ray.flatten(1)
            h.append(torch.rad2deg(torch.atan2(y, x)))
            v.append(torch.rad2deg(torch.atan2(z, torch.hypot(x, y))))
        low_h, high_h = (float(value) for value in torch.cat(h).aminmax())
        low_v, high_v = (float(value) for value in torch.cat(v).aminmax())
        return high_h, low_h, low_v, high_v

    @property
    def default_beam(self) -> str:
        """Name of the default beam: the low beam, or `full` if the lamp has none."""
        return "low" if "low" in self.beams else "full"

    def beam(self, name: str) -> tuple[Tensor, ...]:
        """Utilisations of a beam by name, or of `full` (all pixels on) and `off`. Raises as `require_beam`."""
        self.require_beam(name)
        if name in ALWAYS:
            share = float(name == "full")
            return tuple(torch.full((module.headlight.n_pixels,), share) for module in self.modules)
        return self.beams[name]

    def require_beam(self, name: str) -> None:
        """Raises LuxloopError that lists the beams if there is none of that name."""
        if name not in self.beams and name not in ALWAYS:
            raise LuxloopError(f"lamp {self.name!r} has no beam {name!r}; it has {', '.join([*self.beams, *ALWAYS])}")

    def lit(self, utilisations: Sequence[Tensor]) -> Callable[[Tensor], Tensor]:
        """The lamp's far-field intensity for fixed utilisations, one per module, as a function of directions like `intensity`."""
        textures = [module.headlight.light_texture(u).double().cpu() for module, u in zip(self.modules, utilisations, strict=True)]

        def intensity(directions: Tensor) -> Tensor:
            directions = directions.double()
            total = torch.zeros(directions.shape[1], dtype=torch.float64)
            for module, texture in zip(self.modules, textures, strict=True):
                total += module.headlight.intensity(texture, module.T_lamp_module[:3, :3].T @ directions)
            return total

        return intensity

    def intensity(self, utilisations: Sequence[Tensor], directions: Tensor) -> Tensor:
        """Luminous intensity `[N]` in cd, float64, in directions `[3, N]` of the lamp frame: sum of all modules in the far field."""
        return self.lit(utilisations)(directions)


def pixel_area(headlight: Headlight) -> float:
    """Mean area of a pixel on the texture plane x = 1."""
    return (headlight.left - headlight.right) * (headlight.top - headlight.bottom) / headlight.n_pixels


def direction(h_deg: Tensor, v_deg: Tensor) -> Tensor:
    """Unit directions `[3, ...]` of the lamp frame for angles in deg as headlamp photometry gives them: h to the right, v up (type A)."""
    h, v = torch.deg2rad(h_deg.double()), torch.deg2rad(v_deg.double())
    return torch.stack([v.cos() * h.cos(), -v.cos() * h.sin(), v.sin()])
