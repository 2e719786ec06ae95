"""Cars: a lower body of rounded sections, a cabin with windows on it, wheels, plates and lamps."""

from typing import ClassVar, Literal

import numpy as np
import torch
from pydantic import Field

from luxloop.world.scene.body import Body, Spotlight
from luxloop.world.traffic.colours import TAIL_LAMP
from luxloop.world.traffic.shapes import Floats, Piece, ellipsoid, plate, tube, xyz
from luxloop.world.traffic.tracked import Looks, RandomParams, Reported

Style = Literal["hatchback", "saloon", "van"]
# Length, width, height in m; then in shares of the length from the rear: foot of the rear window, its top, top of the windscreen, its foot.
STYLES: dict[Style, tuple[tuple[float, float, float], tuple[float, float, float, float]]] = {
    "hatchback": ((4.1, 1.77, 1.48), (0.03, 0.12, 0.56, 0.74)),
    "saloon": ((4.7, 1.83, 1.44), (0.13, 0.28, 0.58, 0.74)),
    "van": ((4.9, 1.92, 1.95), (0.02, 0.035, 0.68, 0.82)),
}
# 135 cd 0.57 deg above the horizon, where UN R112 allows a class B low beam 350 cd towards oncoming eyes (B50L)
LOW_BEAM_CD, LOW_BEAM_WIDTH_DEG, LOW_BEAM_DOWN_DEG = 15_000.0, (14.0, 1.0), 2.5
TAIL_CD = 8.0
WHEEL_M = 0.32
CLEARANCE_M = 1e-3  # of the arches over the road, which the tyres touch


class CarParams(RandomParams):
    """A car; the origin lies on the road below its middle."""

    wheels_m: ClassVar = (2.6, 1.5)
    kind: Literal["car"] = "car"
    category: Reported = "car"
    style: Style | None = Field(None, description="body style; left out: from the seed")
    lit: bool = Field(True, description="whether headlamps and tail lamps are on; false: parked")

    def build(self) -> Body:
        """Raises LuxloopError where `parts` names an unknown part."""
        rng = self.random()
        style: Style = self.style or ("hatchback", "saloon", "van")[int(rng.choice(3, p=[0.45, 0.4, 0.15]))]
        size = np.array(STYLES[style][0]) * rng.uniform(0.95, 1.05, 3)
        paint = float(np.exp(rng.uniform(np.log(0.03), np.log(0.8))))
        looks: Looks = {
            "body": ("car_paint", paint),
            "trim": ("rubber", 0.03),
            "tyres": ("rubber", 0.05),
            "rims": ("metal", 0.3),
            "plates": ("retroreflective_sign", 0.5),
            "headlamps": ("headlamp" if self.lit else "glass", 0.25),
            "tail_lamps": ("tail_lamp" if self.lit else "retroreflective_sign", 0.08),
            **{name: ("glass", 0.03) for name in ("windscreen", "rear_window", "windows")},
        }
        pieces = [*_lower(size, style), *_cabin(size, style), *_wheels(size), *_lamps(size)]
        return self.body(pieces, looks, self.pose_track(), spotlights(*_lamp_places(size)) if self.lit else ())


def _belt(size: Floats) -> float:
    return 0.52 * float(size[2]) + 0.14


def _lower(size: Floats, style: Style) -> list[Piece]:
    length, width, _ = size
    along = np.array([0.0, 0.015, 0.06, 0.2, 0.5, 0.74, 0.93, 0.985, 1.0])
    share = np.array([0.92, 0.97, 0.99, 1.0, 1.0, 1.0, 0.97, 0.9, 0.8])
    foot = np.array([0.4, 0.32, 0.26, 0.2, 0.18, 0.2, 0.24, 0.3, 0.38])
    belt = _belt(size)
    front = 0.78 if style == "van" else 0.74
    top = np.array([belt - 0.04, belt, belt, belt, belt, belt, front * belt + 0.12, front * belt, front * belt - 0.1])
    centres = np.stack([(along - 0.5) * length, 0 * along, (foot + top) / 2], 1)
    pieces = [tube("body", centres, np.stack([share * width / 2, (top - foot) / 2], 1), (0, 1, 0), 24, power=5.0)]
    nose, z = length / 2 + 0.006, 0.55 * belt
    grille = [(nose, y * width, z + dz) for y, dz in ((-0.24, -0.11), (0.24, -0.11), (0.27, 0.04), (-0.27, 0.04))]
    return [*pieces, plate("trim", grille), *_plates(size)]


def _plates(size: Floats) -> list[Piece]:
    length, belt = size[0], _belt(size)
    corners = np.array([(0, -0.26, -0.055), (0, 0.26, -0.055), (0, 0.26, 0.055), (0, -0.26, 0.055)])
    return [
        plate("plates", corners + xyz(length / 2 + 0.012, 0, 0.5 * belt)),
        plate("plates", corners[::-1] + xyz(-length / 2 - 0.006, 0, 0.68 * belt)),
    ]


def _cabin(size: Floats, style: Style) -> list[Piece]:
    """Four sides and a roof, and windows a little before them."""
    length, width, height = size
    x = (np.array(STYLES[style][1]) - 0.5) * length
    low, high, wide, narrow = _belt(size) - 0.12, float(height), 0.46 * width, 0.385 * width
    foot = np.array([(x[0], -wide, low), (x[3], -wide, low), (x[3], wide, low), (x[0], wide, low)])
    roof = np.array([(x[1], -narrow, high), (x[2], -narrow, high), (x[2], narrow, high), (x[1], narrow, high)])
    pieces = [plate("body", roof)]
    for k, name in enumerate(("windows", "windscreen", "windows", "rear_window")):
        n = (k + 1) % 4
        side = np.array([foot[k], foot[n], roof[n], roof[k]])
        pieces += [plate("body", side), plate(name, _inset(side, 0.07 if name == "windows" else 0.05))]
    return pieces


def _inset(corners: Floats, margin: float) -> Floats:
    """A quadrangle moved 6 mm outwards, its corners a share of its diagonals inwards."""
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    inner = corners + margin * (corners[[2, 3, 0, 1]] - corners)
    return inner + 0.006 * normal / np.linalg.norm(normal)


def _wheels(size: Floats) -> list[Piece]:
    """Dark arches on the sides, tyres that stand out of them by a centimetre or more on both faces, and rims."""
    length, width, _ = size
    pieces = []
    for x in (-0.3 * length, 0.31 * length):
        for side in (-1.0, 1.0):
            centre, out = np.array([x, side * (width / 2 - 0.1), WHEEL_M]), np.array([0.0, side, 0.0])
            sizes = ("trim", 1.16 * WHEEL_M, 0.08, 0.103), ("tyres", WHEEL_M, 0.1, 0.113), ("rims", 0.62 * WHEEL_M, 0.09, 0.118)
            for part, radius, inside, outside in sizes:
                middle = centre + xyz(0, 0, CLEARANCE_M + radius - WHEEL_M if part == "trim" else 0)
                ends = middle + np.array([[-inside], [outside]]) * out
                pieces.append(tube(part, ends, [[radius, radius]] * 2, (1, 0, 0), 16))
    return pieces


def _lamp_places(size: Floats) -> tuple[Floats, Floats]:
    """Middles of headlamps and of tail lamps, `[2, 3]` m each."""
    length, width, _ = size
    belt, sides = _belt(size), np.array([[0, 1, 0], [0, -1, 0]])
    head = np.array([length / 2 - 0.04, 0, 0.63 * belt]) + sides * 0.36 * width
    return head, np.array([-length / 2 + 0.02, 0, 0.83 * belt]) + sides * 0.4 * width


def _lamps(size: Floats) -> list[Piece]:
    head, tail = _lamp_places(size)
    pieces = [ellipsoid("headlamps", each, (0.07, 0.17, 0.075), sides=10, rings=7) for each in head]
    pieces += [ellipsoid("tail_lamps", each, (0.05, 0.1, 0.09), sides=10, rings=7) for each in tail]
    mirror = np.array([0.2 * size[0], 0.0, _belt(size) + 0.09])
    return pieces + [
        ellipsoid("body", mirror + xyz(0, side * (size[1] / 2 + 0.08), 0), (0.06, 0.11, 0.075), sides=8, rings=6) for side in (1, -1)
    ]


def spotlights(head: Floats, tail: Floats) -> tuple[Spotlight, ...]:
    """Low beams and tail lamps from the middles `[n, 3]` m of headlamps and tail lamps."""
    down = np.radians(LOW_BEAM_DOWN_DEG)
    ahead, back = torch.tensor([np.cos(down), 0.0, -np.sin(down)]), torch.tensor([-1.0, 0.0, 0.0], dtype=torch.float64)
    return (
        *(Spotlight(torch.from_numpy(each), ahead, LOW_BEAM_CD, LOW_BEAM_WIDTH_DEG) for each in head),
        *(Spotlight(torch.from_numpy(each), back, TAIL_CD, (40.0, 15.0), TAIL_LAMP) for each in tail),
    )
