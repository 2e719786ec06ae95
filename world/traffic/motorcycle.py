"""Motorcycles with a rider: wheels, engine, tank, seat, exhaust, one headlamp and one tail lamp."""

from functools import partial
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from luxloop.world.scene.body import Body
from luxloop.world.traffic.car import spotlights
from luxloop.world.traffic.people import CLOTHING, SIDES, SOLE, Clothing, Joints, Person, dress, seated, someone
from luxloop.world.traffic.shapes import Floats, Piece, block, ellipsoid, limb, plate, torus, tube, xyz
from luxloop.world.traffic.tracked import Looks, RandomParams, Reported

WHEEL_M, WHEELBASE_M = 0.31, 1.45
HEADLAMP, TAIL_LAMP = np.array([0.58, 0.0, 0.95]), np.array([-0.9, 0.0, 0.9])  # middles
SEAT, GRIP, PEG = xyz(-0.26, 0, 0.84), xyz(0.22, 0.36, 1.05), xyz(-0.28, 0.2, 0.36)  # the left ones
LEAN = 0.28  # rad, of the rider


class MotorcycleParams(RandomParams):
    """A motorcycle with its rider; the origin lies between the wheels' feet."""

    wheels_m: ClassVar = (WHEELBASE_M, 0.0)
    kind: Literal["motorcycle"] = "motorcycle"
    category: Reported = "motorcycle"
    height_m: float | None = Field(None, ge=1.4, le=2.2, description="height of the rider on foot; left out: from the seed, around 1.71 m")
    clothing: Clothing | None = Field(None, description=CLOTHING)
    lit: bool = Field(True, description="whether headlamp and tail lamp are on")

    def build(self) -> Body:
        """Raises LuxloopError where `parts` names an unknown part."""
        rng = self.random()
        who = someone(rng, self.height_m, self.clothing)
        looks: Looks = {
            "body": ("car_paint", float(np.exp(rng.uniform(np.log(0.03), np.log(0.8))))),
            "frame": ("metal", 0.15),
            "engine": ("metal", 0.25),
            "exhaust": ("metal", 0.5),
            "trim": ("rubber", 0.04),
            "seat": ("rubber", 0.04),
            "tyres": ("rubber", 0.05),
            "rims": ("metal", 0.3),
            "screen": ("glass", 0.03),
            "visor": ("glass", 0.03),
            "plate": ("retroreflective_sign", 0.5),
            "headlamp": ("headlamp" if self.lit else "glass", 0.25),
            "tail_lamp": ("tail_lamp" if self.lit else "retroreflective_sign", 0.08),
        }
        pieces = [*_rider(who), *_wheels(), *_machine(), *_lamps()]
        lamps = spotlights(HEADLAMP[None], TAIL_LAMP[None]) if self.lit else ()
        return self.body(pieces, who.looks | looks, self.pose_track(), lamps)


def _of_both(place: Floats) -> Floats:
    """The left and the right one `[2, 3]`."""
    return np.array([place * (1, side, 1) for side in SIDES])


def _joints(who: Person) -> Joints:
    h = who.height_m
    return seated(who, SEAT + xyz(0, 0, 0.05 * h), LEAN, _of_both(PEG + xyz(-0.05, 0, SOLE * h)), _of_both(GRIP))


def _rider(who: Person) -> list[Piece]:
    """Someone seated, in a full-face helmet."""
    joints, h = _joints(who), who.height_m
    middle = joints.head + h * xyz(0.002, 0, 0.006)
    shell = ellipsoid("helmet", middle, h * np.array([0.08, 0.07, 0.078]), sides=14, rings=10)
    z = np.array([-0.02, 0.0, 0.02, 0.034])
    radii = np.sqrt(1 - (z / 0.078) ** 2)[:, None] * (0.0705, 0.0805)
    visor = tube("visor", middle + h * np.stack([0 * z + 0.007, 0 * z, z], 1), h * radii, (0, 1, 0), 14)
    return [*dress(who, joints, helmet=True), shell, visor]


def _wheels() -> list[Piece]:
    pieces = []
    for x, tyre in ((-WHEELBASE_M / 2, 0.075), (WHEELBASE_M / 2, 0.058)):
        hub = xyz(x, 0, WHEEL_M)
        pieces.append(torus("tyres", hub, WHEEL_M, tyre, 20, 7))
        for half, radius in ((0.02, WHEEL_M - 1.6 * tyre), (0.06, 0.07)):  # disc and hub
            pieces.append(tube("rims", hub + np.array([[0, -half, 0], [0, half, 0]]), [[radius, radius]] * 2, (1, 0, 0), 16))
    return pieces


def _machine() -> list[Piece]:
    """Frame, engine, exhaust and body."""
    rear, front = xyz(-WHEELBASE_M / 2, 0, WHEEL_M), xyz(WHEELBASE_M / 2, 0, WHEEL_M)
    bar = partial(limb, sides=5)
    arc = np.radians(np.linspace(35, 145, 7))
    guard = front + (WHEEL_M + 0.02) * np.stack([np.cos(arc), 0 * arc, np.sin(arc)], 1)
    engine = np.array([(-0.2, 0, 0.42), (-0.14, 0, 0.43), (0.16, 0, 0.47), (0.22, 0, 0.48)])
    pieces = [
        tube("engine", engine, [(0.13, 0.1), (0.2, 0.16), (0.2, 0.16), (0.13, 0.1)], (0, 1, 0), 16, power=4.0),
        limb("engine", (0.06, 0, 0.5), (0.17, 0, 0.72), 0.13, 0.12, sides=10),
        block("trim", (0.27, 0, 0.62), (0.06, 0.3, 0.24)),
        bar("frame", (0.36, 0, 0.9), (-0.34, 0, 0.72), 0.05, 0.04),
        bar("exhaust", (0.24, -0.1, 0.36), (-0.3, -0.19, 0.31), 0.03, 0.03),
        limb("exhaust", (-0.38, -0.2, 0.34), (-0.74, -0.22, 0.44), 0.055, 0.065, sides=10),
        ellipsoid("body", (0.12, 0, 0.87), (0.31, 0.16, 0.13), sides=16, rings=10),
        limb("body", (-0.4, 0, 0.8), (-0.84, 0, 0.91), 0.12, 0.05, sides=10),
        ellipsoid("seat", SEAT - xyz(0.02, 0, 0.02), (0.26, 0.15, 0.06)),
        ellipsoid("seat", (-0.6, 0, 0.92), (0.16, 0.1, 0.04)),
        tube("body", guard, [(0.075, 0.012)] * len(guard), (0, 1, 0), 8),
        bar("trim", (-0.84, 0, 0.86), (-0.96, 0, 0.6), 0.03, 0.015),
        bar("frame", (0.34, 0, 1.0), (0.42, 0, 0.84), 0.04, 0.04),
    ]
    for side in SIDES:
        aside = side * np.array([0.0, 1.0, 0.0])
        pieces += [
            bar("frame", front + 0.09 * aside, xyz(0.4, 0, 0.95) + 0.09 * aside, 0.028, 0.034),
            bar("frame", xyz(0.36, 0, 0.86), xyz(-0.26, 0, 0.42) + 0.16 * aside, 0.04, 0.04),
            bar("frame", xyz(-0.22, 0, 0.42) + 0.12 * aside, rear + 0.11 * aside, 0.035, 0.03),
            bar("frame", PEG * (1, 0, 1) + 0.12 * aside, PEG * (1, side, 1) + 0.05 * aside, 0.015, 0.015),
            bar("trim", (0.34, 0, 1.02), GRIP * (1, side, 1) - 0.1 * aside, 0.016, 0.016),
            bar("trim", GRIP * (1, side, 1) - 0.08 * aside, GRIP * (1, side, 1) + 0.06 * aside, 0.02, 0.02),
            bar("trim", GRIP * (1, side, 1) - 0.06 * aside, GRIP * (1, side, 1) + xyz(0.06, 0, 0.2), 0.008, 0.008),
            ellipsoid("trim", GRIP * (1, side, 1) + xyz(0.06, 0, 0.23) + 0.03 * aside, (0.02, 0.08, 0.05), sides=8, rings=6),
        ]
    return pieces


def _lamps() -> list[Piece]:
    """Lamps, a screen over the headlamp and the plate below the tail lamp."""
    screen = np.array([(0.6, -0.13, 1.04), (0.6, 0.13, 1.04), (0.47, 0.1, 1.22), (0.47, -0.1, 1.22)])
    number = xyz(-0.99, 0, 0.66) + np.array([(0, 0.11, -0.1), (0, -0.11, -0.1), (0.08, -0.11, 0.1), (0.08, 0.11, 0.1)])
    return [
        ellipsoid("trim", HEADLAMP - xyz(0.07, 0, 0), (0.11, 0.12, 0.12)),
        ellipsoid("headlamp", HEADLAMP, (0.06, 0.09, 0.09), sides=10, rings=7),
        ellipsoid("tail_lamp", TAIL_LAMP, (0.03, 0.08, 0.035), sides=10, rings=7),
        plate("screen", screen),
        plate("screen", screen[::-1] - xyz(0.005, 0, 0)),
        plate("plate", number),
    ]
