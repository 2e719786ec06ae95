"""Vehicles of the second population: prisms on wheels, and what people ride, push or sit in."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from luxloop.world.traffic.figures import SIDES, Build, figure, walker
from luxloop.world.traffic.shapes import Floats, Piece, limb, torus, tube, xyz
from luxloop.world.traffic.solids import Capsule, blend, box, prism
from luxloop.world.traffic.tracked import Looks

Car = Literal["microcar", "estate", "off_roader", "pickup"]
Points = list[tuple[float, float]]


@dataclass(frozen=True)
class Machine:
    """Pieces, and middles `[n, 3]` m of head and tail lamps."""

    pieces: list[Piece]
    head: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    tail: Floats = field(default_factory=lambda: np.zeros((0, 3)))


def looks(rng: np.random.Generator, lit: bool) -> Looks:
    paint, second = np.exp(rng.uniform(np.log(0.03), np.log(0.85), 2))
    return {
        "body": ("car_paint", float(paint)),
        "panel": ("car_paint", float(second)),
        "frame": ("metal", rng.uniform(0.1, 0.4)),
        "seat": ("cloth", rng.uniform(0.03, 0.3)),
        "trim": ("rubber", 0.04),
        "tyres": ("rubber", 0.05),
        "rims": ("metal", 0.35),
        **{name: ("glass", 0.03) for name in ("windscreen", "windows")},
        "plates": ("retroreflective_sign", 0.5),
        "headlamps": ("headlamp" if lit else "glass", 0.25),
        "tail_lamps": ("tail_lamp" if lit else "retroreflective_sign", 0.08),
    }


def _wheel(x: float, y: float, radius: float, width: float) -> list[Piece]:
    """A wheel outside of y, with a dished rim."""
    out = xyz(0, np.sign(y), 0)
    tyre = np.array([(-0.5, 0.9), (-0.42, 1.0), (0.42, 1.0), (0.5, 0.9), (0.505, 0.66)]) * (width, radius)
    rim = np.array([(0.4, 0.66), (0.51, 0.64), (0.53, 0.58), (0.46, 0.2), (0.56, 0.12)]) * (width, radius)
    return [
        tube(part, xyz(x, y, radius) + each[:, :1] * out, each[:, 1:] * (1, 1), (1, 0, 0), 20)
        for part, each in (("tyres", tyre), ("rims", rim))
    ]


def _axles(places: ArrayLike, half_m: float, radius: float, width: float) -> list[Piece]:
    return [piece for x in np.atleast_1d(places) for side in (1, -1) for piece in _wheel(float(x), side * half_m, radius, width)]


def _lamps(x_front: float, x_rear: float, half_m: float, z_head: float, z_tail: float) -> Machine:
    """Two lamps on each end, and plates."""
    head, tail = xyz(x_front, 0, z_head) + half_m * SIDES, xyz(x_rear, 0, z_tail) + 1.05 * half_m * SIDES
    pieces = [box("headlamps", each - xyz(0.06, 0.14, 0.06), each + xyz(0.03, 0.14, 0.06), 0.03) for each in head]
    pieces += [box("tail_lamps", each - xyz(0.03, 0.07, 0.13), each + xyz(0.05, 0.07, 0.13), 0.02) for each in tail]
    for x, z in ((x_front + 0.03, z_head - 0.22), (x_rear - 0.03, z_tail - 0.25)):
        pieces.append(box("plates", (x - 0.01, -0.26, z - 0.055), (x + 0.01, 0.26, z + 0.055), 0.003))
    return Machine(pieces, head, tail)


# Side views: body, then foot and top of the rear window, top and foot of the windscreen, in shares of length and height.
CARS: dict[Car, tuple[tuple[float, float, float], list[Points], Points]] = {
    "microcar": (
        (2.7, 1.66, 1.55),
        [[(-0.5, 0.2), (-0.47, 0.58), (0.3, 0.6), (0.47, 0.5), (0.5, 0.22), (0.4, 0.12), (-0.4, 0.12)]],
        [(-0.45, 0.57), (-0.36, 1.0), (0.12, 0.99), (0.36, 0.58)],
    ),
    "estate": (
        (4.75, 1.83, 1.47),
        [[(-0.5, 0.25), (-0.49, 0.62), (0.24, 0.64), (0.45, 0.55), (0.5, 0.4), (0.49, 0.17), (-0.47, 0.17)]],
        [(-0.48, 0.6), (-0.4, 0.98), (0.06, 1.0), (0.25, 0.62)],
    ),
    "off_roader": (
        (4.6, 1.95, 1.85),
        [[(-0.5, 0.25), (-0.5, 0.62), (0.2, 0.64), (0.47, 0.6), (0.5, 0.5), (0.5, 0.24), (0.4, 0.18), (-0.4, 0.18)]],
        [(-0.49, 0.6), (-0.46, 1.0), (0.1, 1.0), (0.2, 0.62)],
    ),
    "pickup": (
        (5.3, 1.9, 1.8),
        [
            [(-0.5, 0.28), (-0.5, 0.6), (-0.05, 0.6), (-0.05, 0.2), (-0.45, 0.2)],
            [(-0.1, 0.2), (-0.1, 0.6), (0.24, 0.62), (0.47, 0.58), (0.5, 0.45), (0.49, 0.22)],
        ],
        [(-0.09, 0.58), (-0.07, 0.98), (0.12, 1.0), (0.25, 0.6)],
    ),
}


def car(rng: np.random.Generator, kind: Car) -> Machine:
    (length, width, height), bodies, cabin = CARS[kind]
    size = np.array([length, height]) * rng.uniform(0.95, 1.05, 2)
    half, (rear, rear_top, front_top, front) = width / 2, np.array(cabin) * size
    pieces = [prism("body", np.array(each) * size, half, 0.09) for each in bodies]
    inner = half - 0.07
    pieces.append(prism("windows", [rear, rear_top - (0, 0.03), front_top - (0, 0.03), front], inner, 0.04, tapers_m=0.14))
    narrow = inner - 0.13
    pieces.append(prism("body", [rear_top - (0.02, 0.05), rear_top, front_top, front_top - (-0.04, 0.05)], narrow + 0.02, 0.03))
    for side in (1, -1):  # pillars, and mirrors
        for foot, top in ((front, front_top), (rear, rear_top), (0.45 * front + 0.55 * rear, 0.4 * front_top + 0.6 * rear_top)):
            pieces.append(limb("body", (foot[0], side * inner, foot[1]), (top[0], side * narrow, top[1] - 0.04), 0.035, 0.035))
        mirror = xyz(front[0] - 0.12 * length, side * (half + 0.06), front[1] + 0.08)
        pieces.append(box("body", mirror - xyz(0.05, 0.1, 0.07), mirror + xyz(0.06, 0.1, 0.07), 0.03))
    pieces += _pane(front, front_top - (0, 0.03), inner - 0.06, narrow - 0.04)
    radius = 0.33 if kind in ("microcar", "estate") else 0.38
    axles = np.array([-0.3, 0.3]) * size[0]
    for x in axles:
        for side in (1, -1):
            arch = [(x, side * y, 1.2 * radius) for y in (half - 0.3, half + 0.002)]
            pieces.append(tube("trim", arch, [[1.15 * radius] * 2] * 2, (1, 0, 0), 20))
    pieces += _axles(axles, half - 0.11, radius, 0.24)
    nose, tail = max(at[0] for at in np.concatenate(bodies)) * size[0], -size[0] / 2
    pieces.append(box("trim", (nose - 0.1, -0.5 * half, 0.3 * size[1]), (nose + 0.012, 0.5 * half, 0.4 * size[1]), 0.02))
    lamps = _lamps(nose - 0.01, tail, 0.74 * half, 0.44 * size[1], 0.5 * size[1])
    return Machine(pieces + lamps.pieces, lamps.head, lamps.tail)


def _pane(foot: Floats, top: Floats, foot_half: float, top_half: float) -> list[Piece]:
    """A windscreen a little before a slanted front, from its foot to its top (x, z)."""
    way = top - foot
    out = 0.012 * np.array([way[1], -way[0]]) / np.hypot(*way)
    corners = [(foot + 0.12 * way, foot_half), (foot + 0.95 * way, 0.1 * foot_half + 0.9 * top_half)]
    sides = [(*at, half) for at, half in corners]
    (x0, z0, h0), (x1, z1, h1) = sides
    vertices = np.array([(x0, -h0, z0), (x0, h0, z0), (x1, h1, z1), (x1, -h1, z1)]) + xyz(out[0], 0, out[1])
    return [Piece("windscreen", vertices, np.array([[0, 1, 2], [0, 2, 3]]))]


def lorry(rng: np.random.Generator) -> Machine:
    """A rigid lorry; Directive 96/53/EC allows 12 m x 2.55 m x 4 m."""
    length, width, height = rng.uniform(7, 10.5), 2.5, rng.uniform(3.2, 3.9)
    half, front = width / 2, length / 2
    cab, back = front - 1.9, -front
    side = [(cab, 0.9), (cab, 2.75), (front - 0.25, 2.75), (front, 1.55), (front, 0.45), (cab + 0.3, 0.45)]
    pieces = [prism("body", side, half - 0.05, 0.1)]
    pieces += _pane(np.array([front, 1.55]), np.array([front - 0.25, 2.72]), half - 0.2, half - 0.2)
    for sign in (1, -1):
        y = sign * (half - 0.055)
        pieces.append(box("windows", (cab + 0.7, y - 0.01, 1.65), (front - 0.4, y + 0.01, 2.4), 0.002))
        pieces.append(
            box("trim", (front - 0.15, sign * (half + 0.17) - 0.12, 1.7), (front - 0.05, sign * (half + 0.17) + 0.12, 2.35), 0.03)
        )
        pieces.append(box("frame", (back + 1.0, sign * (half - 0.1) - 0.02, 0.5), (cab - 1.2, sign * (half - 0.1) + 0.02, 0.8)))
    pieces.append(box("trim", (front - 0.1, -half + 0.25, 0.75), (front + 0.015, half - 0.25, 1.3), 0.01))
    pieces.append(box("frame", (back, -0.5, 0.7), (cab, 0.5, 1.0)))
    kind = rng.integers(3)
    if kind == 0:  # container
        pieces.append(box("panel", (back, -half, 1.0), (cab - 0.25, half, height), 0.02))
        pieces.append(box("body", (back + 1, -half - 0.004, 1.6), (cab - 1.2, half + 0.004, 2.3), 0.002))
    elif kind == 1:  # tank
        x = np.array([back, back + 0.15, cab - 0.4, cab - 0.25])
        radii = np.array([0.75, 1.0, 1.0, 0.75])[:, None] * (1.2, 0.95)
        pieces.append(tube("frame", np.stack([x, 0 * x, 0 * x + 1.95], 1), radii, (0, 1, 0), 24))
    else:  # dropsides with a load
        pieces.append(box("panel", (back, -half, 1.0), (cab - 0.25, half, 1.6), 0.02))
        pieces.append(prism("seat", [(back + 0.3, 1.5), (back + 1.5, 2.5), (cab - 1.5, 2.4), (cab - 0.4, 1.5)], half - 0.15, 0.3))
    pieces += _axles([front - 1.3, back + 1.8], half - 0.17, 0.5, 0.3)
    lamps = _lamps(front, back, half - 0.35, 0.75, 0.85)
    return Machine(pieces + lamps.pieces, lamps.head, lamps.tail)


def bus(rng: np.random.Generator) -> Machine:
    """A bus of 12 m or 9 m, 2.55 m wide (Directive 96/53/EC)."""
    length, half, height = float(rng.choice([9.0, 12.0])), 1.275, rng.uniform(2.9, 3.3)
    front = length / 2
    side = [(-front, 0.35), (-front + 0.1, height), (front - 0.15, height), (front, 0.9), (front, 0.3)]
    pieces = [prism("body", side, half, 0.08)]
    pieces += _pane(np.array([front, 0.9]), np.array([front - 0.15, height]), half - 0.12, half - 0.12)
    pieces.append(box("panel", (-front + 0.5, -half - 0.004, 0.4), (front - 0.6, half + 0.004, 0.75), 0.002))
    for x in np.arange(-front + 0.35, front - 1.3, 1.25):
        pieces.append(box("windows", (x, -half - 0.006, 1.2), (x + 1.15, half + 0.006, 2.35), 0.002))
    pieces.append(box("windows", (-front - 0.01, -half + 0.25, 1.7), (-front + 0.2, half - 0.25, 2.5), 0.002))
    pieces.append(box("plates", (front - 0.1, -0.7, height - 0.3), (front - 0.02, 0.7, height - 0.08)))  # destination
    pieces += _axles([front - 2.6, -front + 3.0 if length > 10 else -front + 2.2], half - 0.14, 0.48, 0.3)
    for sign in (1, -1):
        pieces.append(
            limb("trim", (front - 0.1, sign * half, height - 0.25), (front + 0.25, sign * (half + 0.12), height - 0.7), 0.06, 0.09)
        )
    lamps = _lamps(front, -front, half - 0.25, 0.65, 1.1)
    return Machine(pieces + lamps.pieces, lamps.head, lamps.tail)


def tractor(rng: np.random.Generator) -> Machine:
    """4 m long, 2.3 m wide, 2.8 m high, as usual for 75 kW."""
    grow = rng.uniform(0.9, 1.15)
    pieces = [
        prism("body", [(0.0, 0.85), (0.0, 1.62), (1.6, 1.5), (1.95, 1.35), (1.95, 0.8)], 0.36, 0.08),
        prism("frame", [(-1.0, 0.5), (-1.0, 0.95), (1.8, 0.85), (1.8, 0.55)], 0.25, 0.05),
        prism("windows", [(-1.35, 1.2), (-1.3, 2.6), (0.0, 2.6), (0.15, 1.3)], 0.68, 0.03, tapers_m=0.08),
        prism("body", [(-1.45, 2.6), (-1.4, 2.78), (0.1, 2.78), (0.15, 2.6)], 0.72, 0.05),
        limb("trim", (0.9, 0.42, 1.4), (0.9, 0.42, 2.4), 0.05, 0.04),
        box("trim", (1.9, -0.25, 0.9), (1.965, 0.25, 1.3)),
    ]
    pieces += _pane(np.array([0.15, 1.3]), np.array([0.0, 2.6]), 0.6, 0.55)
    for side in (1, -1):
        fender = [(-1.75, 1.3), (-1.5, 1.75), (-0.45, 1.75), (-0.15, 1.3)]
        pieces.append(prism("body", fender, 0.26, 0.05, side * 0.88))
        for foot, top in (((0.15, 1.3), (0.0, 2.62)), ((-1.35, 1.2), (-1.3, 2.62))):
            pieces.append(limb("body", (foot[0], side * 0.68, foot[1]), (top[0], side * 0.61, top[1]), 0.04, 0.04))
    pieces += _axles([-0.95], 0.9, 0.85, 0.5) + _axles([1.3], 0.8, 0.58, 0.38)
    lamps = _lamps(1.95, -1.7, 0.24, 1.25, 1.45)
    tail = xyz(-1.72, 0, 1.5) + 0.9 * SIDES
    pieces += [piece for piece in lamps.pieces if piece.part == "headlamps"]
    pieces += [box("tail_lamps", each - xyz(0.05, 0.07, 0.1), each + xyz(0.05, 0.07, 0.1), 0.02) for each in tail]
    grown = [Piece(each.part, each.vertices * grow, each.faces) for each in pieces]
    return Machine(grown, lamps.head * grow, tail * grow)


def bicycle(who: Build, phase: float, basket: bool) -> Machine:
    """A step-through bicycle of 28 inch wheels (ISO 4210) and an upright rider."""
    h, hub = who.height_m, np.array([-0.52, 0.55])
    saddle = xyz(-0.22, 0, 0.28 + 0.4 * h)
    grips = xyz(0.3, 0, 0.55 * h + 0.16) + 0.28 * SIDES
    angle = 2 * np.pi * phase + np.array([0, np.pi])
    pedals = np.stack([-0.02 + 0.17 * np.sin(angle), [0.11, -0.11], 0.29 + 0.17 * np.cos(angle)], 1)
    rear, front, crank, stem = xyz(hub[0], 0, 0.35), xyz(hub[1], 0, 0.35), xyz(-0.02, 0, 0.29), xyz(0.36, 0, 0.88)
    tubes = [(rear, crank), (crank, stem), (crank, saddle), (rear, saddle - xyz(0, 0, 0.2)), (front, stem), (stem, grips.mean(0))]
    tubes += [(grips.mean(0), each) for each in grips]
    pieces = [limb("frame", a, b, 0.02, 0.018, 8) for a, b in tubes]
    for place in (rear, front):
        pieces.append(torus("tyres", place, 0.35, 0.024, 28, 6))
        pieces.append(tube("rims", place + np.array([[0, -0.03, 0], [0, 0.03, 0]]), [[0.045, 0.045]] * 2, (1, 0, 0), 10))
        for spoke in np.arange(6) * np.pi / 6:
            end = 0.33 * xyz(np.cos(spoke), 0, np.sin(spoke))
            pieces.append(limb("rims", place - end, place + end, 0.004, 0.004, 4))
        arc = np.radians(np.linspace(20, 170, 9))
        guard = place + 0.39 * np.stack([np.cos(arc), 0 * arc, np.sin(arc)], 1)
        pieces.append(tube("body", guard, [(0.03, 0.008)] * 9, (0, 1, 0), 6))
    pieces += blend([Capsule("seat", saddle + xyz(0.1, 0, 0), saddle - xyz(0.1, 0, 0), 0.03, 0.07)], 0.03, 0.01)
    pieces += [box("trim", each - xyz(0.05, 0.05, 0.015), each + xyz(0.05, 0.05, 0.015)) for each in pedals]
    if basket:
        pieces.append(prism("panel", [(0.45, 0.75), (0.4, 1.0), (0.78, 1.0), (0.72, 0.75)], 0.18, 0.02))
        pieces.append(box("seat", rear + xyz(-0.2, 0.08, 0.0), rear + xyz(0.15, 0.22, 0.34), 0.04))
    head, tail = xyz(0.5, 0, 0.72), xyz(-0.88, 0, 0.62)
    pieces.append(limb("headlamps", head, head + xyz(0.02, 0, 0), 0.035, 0.03, 10))
    pieces.append(box("tail_lamps", tail - xyz(0.02, 0.04, 0.025), tail + xyz(0.02, 0.04, 0.025), 0.005))
    ankle = pedals + xyz(-0.08, 0, 0.075)
    return Machine([*pieces, *figure(who, saddle + xyz(0, 0, 0.09), 0.16, ankle, grips + xyz(-0.03, 0, 0.03), 0.15)])


def kick_scooter(who: Build) -> Machine:
    """An electric one of usual size, 1.1 m long, with somebody who stands on it."""
    pieces = [
        box("frame", (-0.4, -0.08, 0.1), (0.35, 0.08, 0.15), 0.02),
        limb("frame", (0.45, 0, 0.15), (0.33, 0, 1.05), 0.03, 0.022),
        limb("trim", (0.33, -0.26, 1.05), (0.33, 0.26, 1.05), 0.018, 0.018),
        *(torus("tyres", xyz(x, 0, 0.11), 0.11, 0.025, 20, 6) for x in (-0.48, 0.47)),
        box("headlamps", (0.37, -0.03, 0.9), (0.42, 0.03, 0.96)),
        box("tail_lamps", (-0.56, -0.04, 0.2), (-0.53, 0.04, 0.25), 0.003),
    ]
    h = who.height_m
    ankle = xyz(-0.02, 0, 0.15 + 0.045 * h) + 0.045 * SIDES * h + [[0.12, 0, 0], [-0.16, 0, 0]]
    return Machine([*pieces, *figure(who, xyz(-0.05, 0, 0.15 + 0.5 * h), 0.05, ankle, xyz(0.3, 0, 1.08) + 0.24 * SIDES)])


def motor_scooter(who: Build) -> Machine:
    """A motor scooter of usual size, 1.85 m long, with its rider."""
    capsules = [
        Capsule("body", xyz(-0.75, 0, 0.62), xyz(-0.2, 0, 0.55), 0.14, 0.17),
        Capsule("body", xyz(-0.6, 0, 0.5), xyz(-0.15, 0, 0.35), 0.16, 0.12),
        Capsule("body", xyz(0.4, 0, 0.45), xyz(0.32, 0, 0.9), 0.11, 0.1),
        Capsule("body", xyz(0.4, 0.12, 0.4), xyz(0.36, 0.14, 0.75), 0.06, 0.06),
        Capsule("body", xyz(0.4, -0.12, 0.4), xyz(0.36, -0.14, 0.75), 0.06, 0.06),
        Capsule("seat", xyz(-0.7, 0, 0.76), xyz(-0.15, 0, 0.74), 0.09, 0.09),
        Capsule("panel", xyz(0.68, 0, 0.42), xyz(0.5, 0, 0.45), 0.08, 0.09),
    ]
    pieces = blend(capsules, 0.05, 0.02)
    pieces += [
        box("trim", (-0.25, -0.2, 0.22), (0.42, 0.2, 0.3), 0.03),
        *(torus("tyres", xyz(x, 0, 0.24), 0.24, 0.055, 24, 8) for x in (-0.62, 0.62)),
        *(tube("rims", [(x, -0.05, 0.24), (x, 0.05, 0.24)], [[0.15, 0.15]] * 2, (1, 0, 0), 16) for x in (-0.62, 0.62)),
        limb("trim", (0.26, -0.32, 1.02), (0.26, 0.32, 1.02), 0.022, 0.022),
        limb("headlamps", (0.4, 0, 0.95), (0.42, 0, 0.95), 0.08, 0.07, 12),
        box("tail_lamps", (-0.93, -0.1, 0.6), (-0.88, 0.1, 0.68)),
        box("plates", (-0.95, -0.1, 0.38), (-0.94, 0.1, 0.55), 0.002),
    ]
    for side in (0.28, -0.28):
        pieces.append(limb("trim", (0.28, side, 1.02), (0.24, 1.2 * side, 1.22), 0.01, 0.045))
    h = who.height_m
    ankle = xyz(0.18, 0, 0.3 + 0.045 * h) + 0.13 * SIDES
    pieces += figure(who, xyz(-0.3, 0, 0.84 + 0.05 * h), 0.1, ankle, xyz(0.22, 0, 1.05) + 0.3 * SIDES)
    return Machine(pieces, xyz(0.5, 0, 0.95)[None], xyz(-0.95, 0, 0.64)[None])


def wheelchair(who: Build) -> Machine:
    """Within 1.2 m x 0.7 m (DIN 18040), with somebody who drives it by hand."""
    pieces = [
        box("seat", (-0.25, -0.22, 0.46), (0.22, 0.22, 0.51), 0.02),
        prism("seat", [(-0.24, 0.48), (-0.34, 0.95), (-0.3, 0.95), (-0.2, 0.48)], 0.22, 0.01),
    ]
    for side in (1, -1):
        big, small = xyz(-0.2, side * 0.29, 0.3), xyz(0.3, side * 0.24, 0.09)
        pieces += [torus("tyres", big, 0.3, 0.018, 28, 6), torus("tyres", small, 0.09, 0.018, 16, 6)]
        pieces += [torus("frame", big + xyz(0, side * 0.04, 0), 0.27, 0.009, 28, 5)]
        for spoke in np.arange(5) * np.pi / 5:
            end = 0.28 * xyz(np.cos(spoke), 0, np.sin(spoke))
            pieces.append(limb("rims", big - end, big + end, 0.004, 0.004, 4))
        bars = [((-0.22, 0.3), (-0.22, 0.95)), ((-0.22, 0.46), (0.34, 0.46)), ((0.34, 0.46), (0.48, 0.12)), ((-0.2, 0.7), (0.15, 0.7))]
        bars += [((-0.3, 0.93), (-0.45, 0.95)), ((0.3, 0.46), (0.3, 0.1))]
        pieces += [limb("frame", (a[0], side * 0.23, a[1]), (b[0], side * 0.23, b[1]), 0.013, 0.013, 6) for a, b in bars]
        pieces.append(box("trim", (0.42, side * 0.12 - 0.08, 0.1), (0.62, side * 0.12 + 0.08, 0.12), 0.005))
    ankle = xyz(0.48, 0, 0.12 + 0.045 * who.height_m) + 0.11 * SIDES
    return Machine([*pieces, *figure(who, xyz(-0.1, 0, 0.58), -0.06, ankle, xyz(0.0, 0, 0.6) + 0.32 * SIDES)])


def pram(who: Build, phase: float | None) -> Machine:
    """Somebody who pushes a pram of usual size, 0.95 m x 0.6 m x 1.05 m."""
    reach = 0.3 * who.height_m
    pieces = [
        prism("panel", [(0.3, 0.55), (0.25, 0.8), (1.1, 0.8), (1.0, 0.55)], 0.21, 0.04),
        *blend([Capsule("body", xyz(0.8, 0, 0.78), xyz(0.92, 0, 0.76), 0.23, 0.22)], 0.05, 0.01),
    ]
    handle = xyz(0.02, 0, 0.62 * who.height_m)
    for side in (0.26, -0.26):
        for x, radius in ((0.35, 0.14), (0.95, 0.14)):
            pieces.append(torus("tyres", xyz(x, side, radius), radius, 0.025, 20, 6))
            pieces.append(tube("rims", [(x, side - 0.02, radius), (x, side + 0.02, radius)], [[0.05, 0.05]] * 2, (1, 0, 0), 10))
        y = 0.85 * side
        for a, b in (((0.35, 0.14), (0.8, 0.6)), ((0.95, 0.14), (0.5, 0.6)), ((0.5, 0.6), (handle[0], handle[2]))):
            pieces.append(limb("frame", (a[0], y, a[1]), (b[0], y, b[1]), 0.012, 0.012, 6))
    pieces.append(limb("trim", handle - xyz(0, 0.24, 0), handle + xyz(0, 0.24, 0), 0.018, 0.018, 8))
    moved = [Piece(each.part, each.vertices + xyz(reach - 0.05, 0, 0), each.faces) for each in pieces]
    return Machine([*moved, *walker(who, phase, handle + xyz(reach - 0.05, 0, 0.02))])
