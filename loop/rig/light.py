"""Light of a rig: pictures of utilisations, the interface of all light devices, and the limits of power and rate of change."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.loop.rig.arrays import Indices
from luxloop.loop.rig.params import LimitParams, ScanParams
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST, Commands

Picture = NDArray[np.float32]  # utilisations [rows, columns] of a module in 0..1, row 0 on top, column 0 on the left
KEY = "light.kind"


@dataclass(frozen=True, eq=False)
class Shine:
    """Light of all modules.

    number: of its exposure. commands: one per module, or empty if all are at rest.
    """

    number: int
    pictures: tuple[Picture, ...]
    commands: Commands = ()

    @property
    def net_pictures(self) -> tuple[Picture, ...]:
        """Pictures times the modules' intensities, for lamps that cannot dim a module."""
        commands = self.commands or (REST,) * len(self.pictures)
        return tuple(np.float32(each.intensity) * u for each, u in zip(commands, self.pictures, strict=True))

    @property
    def share(self) -> float:
        """Mean utilisation of all pixels, times the modules' intensities."""
        return float(sum(u.sum() for u in self.net_pictures) / sum(u.size for u in self.pictures))


class LightDevice:
    """A light device; this one lights nothing, as in a dry run. `show` with the same number repeats the light, as a sign of life."""

    def show(self, shine: Shine) -> str | None:
        """Send light. Returns after all of it was sent: None, or the reason why it may not be shown."""
        return None

    def dark(self) -> None:
        """Darken the lamp. Never raises."""

    def close(self) -> None:
        """Close the device, which is dark. Never raises."""


def places(scan: ScanParams, rows: int, columns: int) -> Indices:
    """Indices `[rows * columns]` into a picture in a device's order of pixels."""
    index = np.arange(rows * columns).reshape(rows, columns)
    index = index[:: -1 if scan.from_bottom else 1, :: -1 if scan.from_right else 1]
    lines = index.T if scan.columns_first else index
    if scan.serpentine:
        lines = lines.copy()
        lines[1::2] = lines[1::2, ::-1]
    return lines.ravel()


def check_reason(reason: Any) -> str | None:
    """The result of a light's `show`, checked. Raises LuxloopError if it is neither None nor a text."""
    if reason is None or isinstance(reason, str):
        return reason
    raise LuxloopError(f"{KEY}: show gives a {type(reason).__name__}; return None where the light was sent, else the reason as a text")


@dataclass(frozen=True, eq=False)
class LimitedLight:
    """Light within the limits.

    dimmed: factor by the power limit. slowed: applied share of the requested change, 1 for all of it.
    """

    shine: Shine
    dimmed: float = 1.0
    slowed: float = 1.0

    @property
    def whole(self) -> bool:
        """Whether the requested light is unchanged."""
        return self.dimmed == 1 and self.slowed == 1


def limit(shine: Shine, before: Sequence[Picture] | None, passed_s: float, limits: LimitParams) -> LimitedLight:
    """Light within the limits.

    before: current pictures times the modules' intensities, None if dark. passed_s: time since they were sent. All pixels are dimmed by one
    factor. Of a change that is too fast only a part is applied; it is complete after several exposures.
    """
    share = shine.share
    factor = 1.0 if share <= limits.share else limits.share / share
    pictures = shine.pictures if factor == 1 else tuple(np.float32(factor) * u for u in shine.pictures)
    asked = replace(shine, pictures=pictures)
    old = tuple(np.zeros_like(u) for u in pictures) if before is None else tuple(before)
    count = sum(u.size for u in pictures)
    change = float(sum(np.abs(new - u).sum() for new, u in zip(asked.net_pictures, old, strict=True))) / count
    most = limits.change_per_s * passed_s
    if change <= most:
        return LimitedLight(asked, factor)
    part = most / change
    commands = shine.commands and tuple(replace(each, intensity=1.0) for each in shine.commands)
    between = tuple(u + np.float32(part) * (new - u) for new, u in zip(asked.net_pictures, old, strict=True))
    return LimitedLight(replace(asked, pictures=between, commands=commands), factor, part)
