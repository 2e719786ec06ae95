"""Light as photometric files that other programs read: the beam of a lamp, and what modules give at one time."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp
from luxloop.world.photometry import Distribution, sample, write, write_eulumdat

LEAST_STEP_DEG, MOST_STEP_DEG, MOST_NODES = 0.01, 5.0, 4_000_000
PLANES: Final = 360  # of EULUMDAT, all round
SUFFIXES: Final = (".ies", ".ldt")


def export(lamp: Lamp, beam: str, file: Path, step_deg: float = 0.1) -> Distribution:
    """Write a beam over the lamp's field, as LM-63-2019, type A, or as EULUMDAT, by the suffix; zero outside the field.

    Raises LuxloopError for an unknown beam, another suffix, a step out of range or too fine, and where the file cannot be written.
    """
    return _write(file, lamp.lit(lamp.beam(beam)), lamp.field_deg, f"{lamp.name}, beam {beam}", step_deg, {})


def write_texture(
    file: Path, headlight: Headlight, texture: Tensor, name: str, step_deg: float, keywords: Mapping[str, str]
) -> Distribution:
    """Write the light texture `[rows, cols]` in cd of a module about its own axis, as LM-63-2019, type A, or as EULUMDAT, by the suffix.

    name: of the luminaire. keywords: more of them in LM-63. Raises LuxloopError for a step out of range or too fine, and where the file
    cannot be written.
    """
    light = texture.detach().double().cpu()
    borders = (headlight.left, headlight.right, headlight.bottom, headlight.top)
    left, right, bottom, top = (math.degrees(math.atan(each)) for each in borders)
    return _write(file, lambda directions: headlight.intensity(light, directions), (left, right, bottom, top), name, step_deg, keywords)


def _write(
    file: Path, intensity: Callable[[Tensor], Tensor], field_deg: tuple[float, ...], name: str, step_deg: float, keywords: Mapping[str, str]
) -> Distribution:
    """field_deg: left and right (left positive), bottom and top (up positive), beyond which it is dark."""
    left, right, bottom, top = field_deg
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise LuxloopError(f"--out {file}: gives no photometric format; end it in {' or '.join(SUFFIXES)}")
    if suffix == ".ies":
        h, v = _nodes(-left, -right, step_deg), _nodes(bottom, top, step_deg)
        _refuse_many(len(h), len(v), step_deg)
        distribution = sample(intensity, h, v)
        write(file, distribution, {"LUMINAIRE": name, **keywords})
    else:
        corner = math.cos(math.radians(max(left, -right))) * math.cos(math.radians(max(-bottom, top)))
        gamma = _nodes(0.0, math.degrees(math.acos(corner)), step_deg)
        gamma = np.append(gamma[gamma >= 0], 180.0)
        _refuse_many(PLANES, len(gamma), step_deg)
        distribution = sample(intensity, np.arange(PLANES) * (360 / PLANES), gamma, "C")
        write_eulumdat(file, distribution, name)
    return distribution


def _refuse_many(columns: int, rows: int, step_deg: float) -> None:
    if columns * rows > MOST_NODES:
        raise LuxloopError(f"--step-deg {step_deg:g}: makes {columns} x {rows} angles; give a larger step")


def _nodes(low: float, high: float, step_deg: float) -> np.ndarray:
    """Multiples of the step from one below low to one above high, and +-90 deg, where LM-63 requires type A to begin and end."""
    if not LEAST_STEP_DEG <= step_deg <= MOST_STEP_DEG:
        raise LuxloopError(f"--step-deg {step_deg:g}: give an angle step of {LEAST_STEP_DEG:g} to {MOST_STEP_DEG:g} deg")
    first, last = math.floor(low / step_deg) - 1, math.ceil(high / step_deg) + 1
    inner = np.arange(first, last + 1) * step_deg
    return np.concatenate([[-90.0], inner[(inner > -90) & (inner < 90)], [90.0]])
