"""Draw the four shipped symbols: `python draw_symbols.py [FOLDER]`, by default into the current folder.

A symbol lies on the road 2 m wide and 4 m long, so an image has 128 pixels a metre; row 0 is the far end, white is light.
Each is designed in the unit square (x right, y towards the driver) and then stretched to twice its width in length, as painted road
markings are. Strokes are at least 0.055 of the square, 11 cm across and 22 cm along, so that they survive 40 rows of lamp pixels.
"""

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 256, 512
SUPERSAMPLING = 8
LIGHT, DARK = 255, 0

Point = tuple[float, float]


class Canvas:
    """A unit square to draw on, at several times the final resolution."""

    def __init__(self) -> None:
        self.pixels = np.zeros((HEIGHT * SUPERSAMPLING, WIDTH * SUPERSAMPLING), np.uint8)

    def polygon(self, points: list[Point], value: int = LIGHT) -> None:
        corners = np.array(points) * self.pixels.shape[::-1]
        cv2.fillPoly(self.pixels, [np.round(corners).astype(np.int32)], value)

    def rectangle(self, left: float, top: float, right: float, bottom: float, value: int = LIGHT) -> None:
        self.polygon([(left, top), (right, top), (right, bottom), (left, bottom)], value)

    def disc(self, centre: Point, radius: float, value: int = LIGHT) -> None:
        angle = np.linspace(0, 2 * np.pi, 180)
        self.polygon([(centre[0] + radius * np.cos(t), centre[1] + radius * np.sin(t)) for t in angle], value)

    def stroke(self, start: Point, end: Point, width: float, value: int = LIGHT) -> None:
        """A straight line with round ends."""
        (x0, y0), (x1, y1) = start, end
        length = np.hypot(x1 - x0, y1 - y0)
        dx, dy = -(y1 - y0) / length * width / 2, (x1 - x0) / length * width / 2
        self.polygon([(x0 + dx, y0 + dy), (x1 + dx, y1 + dy), (x1 - dx, y1 - dy), (x0 - dx, y0 - dy)], value)
        self.disc(start, width / 2, value)
        self.disc(end, width / 2, value)

    def rounded(self, points: list[Point], radius: float, value: int = LIGHT) -> None:
        """A polygon grown by `radius`, its corners round."""
        self.polygon(points, value)
        for start, end in zip(points, points[1:] + points[:1], strict=True):
            self.stroke(start, end, 2 * radius, value)

    def image(self) -> np.ndarray:
        return cv2.resize(self.pixels, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)


def snowflake(canvas: Canvas) -> None:
    """Six arms, each with two pairs of side branches."""
    width, arm = 0.062, 0.455

    def at(angle: float, radius: float, turn: float = 0.0, length: float = 0.0) -> Point:
        # 1.12 widens the flake from the hexagon's 0.87 to nearly the whole square.
        x = radius * np.sin(angle) + length * np.sin(angle + turn)
        y = radius * np.cos(angle) + length * np.cos(angle + turn)
        return 0.5 + 1.12 * x, 0.5 - y

    for angle in np.deg2rad(np.arange(0, 360, 60)):
        canvas.stroke((0.5, 0.5), at(angle, arm), width)
        for radius, length in ((0.195, 0.08), (0.32, 0.115)):
            for turn in np.deg2rad([-60, 60]):
                canvas.stroke(at(angle, radius), at(angle, radius, turn, length), width)


def chevrons(canvas: Canvas) -> None:
    """Three arrowheads that point ahead."""
    height, thickness = 0.26, 0.14
    for top in (0.03, 0.30, 0.57):
        tip, foot = top, top + height
        canvas.polygon([(0.5, tip), (0.97, foot), (0.97, foot + thickness), (0.5, tip + thickness), (0.03, foot + thickness), (0.03, foot)])


def warning_triangle(canvas: Canvas) -> None:
    """A triangular outline with rounded corners and an exclamation mark."""
    canvas.rounded([(0.5, 0.085), (0.915, 0.915), (0.085, 0.915)], 0.065)
    canvas.rounded([(0.5, 0.27), (0.79, 0.85), (0.21, 0.85)], 0.02, DARK)
    canvas.rounded([(0.46, 0.44), (0.54, 0.44), (0.52, 0.62), (0.48, 0.62)], 0.025)
    canvas.disc((0.5, 0.755), 0.06)


def distance_warning(canvas: Canvas) -> None:
    """The car ahead from behind, the gap as a double arrow, and the own curved bumper."""
    canvas.rounded([(0.31, 0.05), (0.69, 0.05), (0.77, 0.19), (0.23, 0.19)], 0.03)
    canvas.rounded([(0.19, 0.20), (0.81, 0.20), (0.81, 0.35), (0.19, 0.35)], 0.05)
    for left in (0.16, 0.68):
        canvas.rounded([(left + 0.02, 0.36), (left + 0.14, 0.36), (left + 0.14, 0.45), (left + 0.02, 0.45)], 0.02)
    canvas.polygon([(0.355, 0.085), (0.645, 0.085), (0.70, 0.175), (0.30, 0.175)], DARK)
    for x in (0.25, 0.75):
        canvas.disc((x, 0.275), 0.045, DARK)

    canvas.polygon([(0.5, 0.44), (0.66, 0.56), (0.34, 0.56)])
    canvas.polygon([(0.5, 0.81), (0.66, 0.69), (0.34, 0.69)])
    canvas.rectangle(0.45, 0.53, 0.55, 0.72)
    bumper = [(x, 0.855 + 0.38 * (x - 0.5) ** 2) for x in np.linspace(0.07, 0.93, 15)]
    for start, end in pairwise(bumper):
        canvas.stroke(start, end, 0.08)


SYMBOLS: list[Callable[[Canvas], None]] = [snowflake, chevrons, warning_triangle, distance_warning]


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    folder.mkdir(parents=True, exist_ok=True)
    for draw in SYMBOLS:
        canvas = Canvas()
        draw(canvas)
        image = canvas.image()
        cv2.imwrite(str(folder / f"{draw.__name__}.png"), image)
        print(f"{draw.__name__}: {image.mean() / 255:.0%} lit")


if __name__ == "__main__":
    main()
