"""Lamps that come with luxloop; what is published of each and what is guessed stands in its notes and beside its numbers."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Literal

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.presets import dmd, hd84, ideal, ssl_hd
from luxloop.world.presets.beams import FittedBeams
from luxloop.world.presets.ideal import idealised

__all__ = ["NAMES", "SUMMARIES", "idealised", "lamp"]


def _alone(name: str, light: Callable[[float], Headlight]) -> Callable[[float], tuple[Module, ...]]:
    return lambda chromatic_shift: (Module(name, light(chromatic_shift)),)


# Modules of the left lamp, given the chromatic shift, and what is known of them.
_LAMPS: dict[str, tuple[Callable[[float], tuple[Module, ...]], str]] = {
    "idealised-332x1024": (_alone("matrix", ideal.light), ideal.NOTES),
    "hd84": (_alone("matrix", hd84.light), hd84.NOTES),
    "ssl-hd-lores": (_alone("lores", ssl_hd.lores), f"The module LoRes alone, of the lamp of which the rest tells.\n{ssl_hd.NOTES}"),
    "ssl-hd-hires": (_alone("hires", ssl_hd.hires), f"The module HiRes alone, of the lamp of which the rest tells.\n{ssl_hd.NOTES}"),
    "ssl-hd": (ssl_hd.modules, ssl_hd.NOTES),
    "dmd-1m3": (_alone("matrix", dmd.light), dmd.NOTES),
}
NAMES = tuple(_LAMPS)
SUMMARIES: Mapping[str, str] = MappingProxyType(
    {
        "idealised-332x1024": "the thesis' idealised lamp: 332 x 1024 pixels on 20 x 5 deg that hardly overlap",
        "hd84": "84 Gaussian pixels in three unequal rows on 40 x 10 deg",
        "ssl-hd-lores": "64 x 256 blurred pixels on 40 x 10 deg",
        "ssl-hd-hires": "64 x 256 blurred pixels on 20 x 5 deg",
        "ssl-hd": "the lamp around both: LoRes, HiRes, auxiliary high beam, courtesy light, cornering light",
        "dmd-1m3": "1.3 million micromirrors on 14 x 7 deg",
    }
)


@lru_cache(maxsize=4)
def lamp(name: str, side: Literal["left", "right"] = "left", chromatic_shift: float = 0.0) -> Lamp:
    """A lamp by name, one of NAMES; its beams are fitted when they are first asked for.

    side: of the car; the right lamp is the left one's mirror image. chromatic_shift: by what share the lenses of the HD modules image
    blue larger than red, 0 for one colour. Raises: LuxloopError for an unknown name or side.
    """
    if name not in _LAMPS:
        raise LuxloopError(f"there is no lamp {name!r}; {did_you_mean(name, NAMES)}")
    if side not in ("left", "right"):
        raise LuxloopError(f"a lamp's side is 'left' or 'right', not {side!r}")
    build, notes = _LAMPS[name]
    modules = build(chromatic_shift)
    if side == "right":
        modules = tuple(module.mirrored() for module in modules)
    bare = Lamp(name, modules, notes=notes)
    return replace(bare, beams=FittedBeams(bare))
