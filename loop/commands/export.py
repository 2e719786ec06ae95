"""A lamp's beam as a photometric file that other programs read."""

import math
from pathlib import Path

import numpy as np

from world.errors import LuxloopError
from world.headlight.lamp import Lamp
from world.photometry import Distribution, sample, write

LEAST_STEP_DEG, MOST_STEP_DEG, MOST_NODES = 0.01, 5.0, 4_000_000


def export(lamp: Lamp, beam: str, file: Path, step_deg: float = 0.1) -> Distribution:
    """Write a beam as LM-63-2019, type A, with nodes every step_deg over the lamp's field and zero outside it.

    Raises LuxloopError for an unknown beam, a step out of range or too fine, and where the file cannot be written.
    """
    if not LEAST_STEP_DEG <= step_deg <= MOST_STEP_DEG:
        raise LuxloopError(f"--step-deg {step_deg:g}: give an angle step of {LEAST_STEP_DEG:g} to {MOST_STEP_DEG:g} deg")
    left, right, bottom, top = lamp.field_deg
    h, v = _nodes(-left, -right, step_deg), _nodes(bottom, top, step_deg)
    if len(h) * len(v) > MOST_NODES:
        raise LuxloopError(f"--step-deg {step_deg:g}: makes {len(h)} x {len(v)} angles; give a larger step")
    distribution = sample(lamp.lit(lamp.beam(beam)), h, v)
    write(file, distribution, {"LUMINAIRE": f"{lamp.name}, beam {beam}"})
    return distribution


def _nodes(low: float, high: float, step_deg: float) -> np.ndarray:
    """Multiples of the step from one below low to one above high, and +-90 deg, where LM-63 requires type A to begin and end."""
    first, last = math.floor(low / step_deg) - 1, math.ceil(high / step_deg) + 1
    inner = np.arange(first, last + 1) * step_deg
    return np.concatenate([[-90.0], inner[(inner > -90) & (inner < 90)], [90.0]])
