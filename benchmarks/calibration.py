"""How well the joint optimisation of all pixels can draw rectangles with a lamp: the figure that two presets are calibrated by (T 8.4).

`python benchmarks/calibration.py hd84` draws a part of the 1,215 rectangles and prints the mean error; `--every 1` draws them all.
"""

import argparse

import numpy as np

from luxloop.controllers.pixels.jpo_part import pixel_goal
from luxloop.controllers.pixels.jpo_solvers import least_error
from luxloop.world.lamps.patterns import RECTANGLES
from luxloop.world.lamps.presets import lamp

PUBLISHED = {"hd84": 0.81, "ssl-hd-lores": 0.19}  # mean error, T 8.4


def errors(name: str, every: int, gap: float = 0.005) -> list[float]:
    """The least mean absolute error (T 8.3) of every n-th rectangle."""
    light = lamp(name).modules[0].headlight
    textures = [rectangle.texture(light) for rectangle in RECTANGLES[every // 2 :: every]]
    return [float(least_error(light.matrix, pixel_goal(light, each), gap=gap).error / each.sum()) for each in textures]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("lamp", choices=sorted(PUBLISHED))
    parser.add_argument("--every", type=int, default=29, help="take every n-th rectangle (default 29)")
    given = parser.parse_args()
    found = errors(given.lamp, given.every)
    print(f"{given.lamp}: mean {np.mean(found):.3f}, median {np.median(found):.3f}; thesis {PUBLISHED[given.lamp]}")
