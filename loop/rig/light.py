"""The interface of all lights of a rig: they show pictures of utilisations, and go dark."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from luxloop.loop.rig.params import DdpLightParams, FilesLightParams, Lights, ScanParams, ScreenLightParams
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST, Commands

Picture = NDArray[np.float32]  # utilisations [rows, columns] of a module in 0..1, row 0 on top, column 0 on the left
METHODS: Final = ("show", "dark", "close")
KEY: Final = "light.kind"


@dataclass(frozen=True, eq=False)
class Shine:
    """Light of all modules. number: of its exposure. commands: one a module, or none where all are at rest."""

    number: int
    pictures: tuple[Picture, ...]
    commands: Commands = ()

    @property
    def dimmed(self) -> tuple[Picture, ...]:
        """The pictures times the modules' intensities, for lamps without this command."""
        commands = self.commands or (REST,) * len(self.pictures)
        return tuple(np.float32(each.intensity) * u for each, u in zip(commands, self.pictures, strict=True))

    @property
    def share(self) -> float:
        """Mean utilisation of all pixels, times the modules' intensities."""
        return float(sum(u.sum() for u in self.dimmed) / sum(u.size for u in self.pictures))


class Light(Protocol):
    """One device. `show` with the same number again is the same light, sent to signal that the loop is alive."""

    def show(self, shine: Shine) -> str | None:
        """Send light; returns after all of it was sent: None, or the reason in words why it may not be shown."""
        ...

    def dark(self) -> None:
        """Darken the lamp. Never raises."""
        ...

    def close(self) -> None:
        """Close the device, which is dark. Never raises."""
        ...


class NoLight:
    """The light of a dry run: nothing is lit, and no device is opened."""

    def show(self, shine: Shine) -> str | None:
        return None

    def dark(self) -> None:
        return None

    def close(self) -> None:
        return None


def open_light(params: Lights, grids: Sequence[tuple[int, int]]) -> Light:
    """The light of a rig file. grids: rows and columns of the modules' pixels. Raises LuxloopError if it cannot be opened."""
    from luxloop.loop.rig.ddp import DdpLight
    from luxloop.loop.rig.files import FilesLight
    from luxloop.loop.rig.screen import ScreenLight

    match params:
        case DdpLightParams():
            return DdpLight(params, grids)
        case ScreenLightParams():
            return ScreenLight(params, grids)
        case FilesLightParams():
            return FilesLight(params)
    return cast(Light, plugin.make(params.kind, KEY, {"grids": tuple(grids)}, params.options, METHODS))


def places(scan: ScanParams, rows: int, columns: int) -> NDArray[np.int64]:
    """Indices `[rows * columns]` into a picture in the order in which a device wants its pixels."""
    index = np.arange(rows * columns).reshape(rows, columns)
    index = index[:: -1 if scan.from_bottom else 1, :: -1 if scan.from_right else 1]
    lines = index.T if scan.columns_first else index
    if scan.serpentine:
        lines = lines.copy()
        lines[1::2] = lines[1::2, ::-1]
    return lines.ravel()


def checked_reason(reason: Any) -> str | None:
    """The result of a light's `show`. Raises LuxloopError if it is neither None nor a text."""
    if reason is None or isinstance(reason, str):
        return reason
    raise LuxloopError(f"{KEY}: show gives a {type(reason).__name__}; return None where the light was sent, else the reason as a text")
