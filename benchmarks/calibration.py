"""How well the joint optimisation of all pixels can draw rectangles with a lamp: the figure that two presets are calibrated by (T 8.4).

`python benchmarks/calibration.py hd84` draws a part of the 1,215 rectangles and prints the mean error; `--every 1` draws them all.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from luxloop.controllers.pixels.jpo_part import pixel_goal
from luxloop.controllers.pixels.jpo_solvers import least_error
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.patterns import RECTANGLES, Rectangle
from luxloop.world.lamps.presets import lamp

PUBLISHED = {"hd84": 0.81, "ssl-hd-lores": 0.19}  # mean error, T 8.4


def drawn(light: Headlight, rectangle: Rectangle, gap: float = 0.005) -> tuple[float, float]:
    """The least mean absolute error (T 8.3) of a rectangle, and how much lower it might be."""
    texture = rectangle.texture(light)
    found = least_error(light.matrix, pixel_goal(light, texture), gap=gap)
    return float(found.error / texture.sum()), float((found.error - found.bound) / texture.sum())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("lamp", choices=sorted(PUBLISHED))
    parser.add_argument("--every", type=int, default=29, help="take every n-th rectangle (default 29)")
    chosen = parser.parse_args(arguments)
    light = lamp(chosen.lamp).modules[0].headlight
    errors = []
    for rectangle in RECTANGLES[chosen.every // 2 :: chosen.every]:
        error, gap = drawn(light, rectangle)
        errors.append(error)
        print(f"{rectangle}: {error:.3f} (-{gap:.3f})")
    print(f"{chosen.lamp}: mean {np.mean(errors):.3f}, median {np.median(errors):.3f}; thesis {PUBLISHED[chosen.lamp]}")


if __name__ == "__main__":
    main()
