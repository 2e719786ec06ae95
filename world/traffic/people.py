"""People on foot and on bicycles: a skeleton of joints, dressed with limbs, after Drillis & Contini's body segments (1966)."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from luxloop.world.scene.body import Body, Figure
from luxloop.world.traffic.shapes import Floats, Piece, block, ellipsoid, limb, torus, tube, xyz
from luxloop.world.traffic.tracked import Looks, RandomParams, Reported

UPPER_ARM, FOREARM, THIGH, SHANK, FOOT = 0.186, 0.20, 0.245, 0.246, 0.11
TRUNK = 0.29  # from the hips to the line of the shoulders
SOLE = 0.039  # of the ankle over the ground
Clothing = Literal["dark", "mixed", "light", "vest"]
SIDES = (1.0, -1.0)  # left, right


@dataclass(frozen=True)
class Person:
    """Build and clothing of a person.

    girth: width as a multiple of the usual. coat: how far it hangs below the hips, as a share of the height. banded: as on a vest.
    """

    height_m: float
    girth: float
    coat: float
    hat: bool
    bag: bool
    looks: Looks
    banded: bool


@dataclass(frozen=True)
class Joints:
    """Joints `[3]` in m; those of limbs `[2, 3]`, the left one first. up: unit vector `[3]` from the hips to the shoulders."""

    hips: Floats
    up: Floats
    head: Floats
    hip: Floats
    knee: Floats
    ankle: Floats
    toe: Floats
    shoulder: Floats
    elbow: Floats
    hand: Floats


def someone(rng: np.random.Generator, height_m: float | None, clothing: Clothing | None) -> Person:
    """A random person, of a given height and clothing if not None."""
    clothing = clothing or rng.choice(["dark", "mixed", "light"], p=[0.45, 0.4, 0.15])
    low, high = {"dark": (0.03, 0.1), "mixed": (0.06, 0.45), "light": (0.35, 0.75), "vest": (0.03, 0.3)}[clothing]
    jacket, trousers = rng.uniform(low, high, 2)
    skin = rng.uniform(0.2, 0.6)
    looks: Looks = {
        "head": ("skin", skin),
        "hands": ("skin", skin),
        "hair": ("hair", rng.uniform(0.03, 0.3)),
        "helmet": ("cloth", rng.uniform(0.05, 0.8)),
        "jacket": ("cloth", 0.6 if clothing == "vest" else float(jacket)),
        "trousers": ("cloth", float(trousers)),
        "shoes": ("cloth", rng.uniform(0.03, 0.4)),
        "bag": ("cloth", rng.uniform(0.03, 0.4)),
        "bands": ("reflective_band", 0.4),
    }
    height = float(np.clip(rng.normal(1.71, 0.09), 1.5, 1.95)) if height_m is None else height_m
    coat = rng.uniform(0.06, 0.2) if rng.random() < 0.35 else 0.0
    girth, hat, bag = rng.uniform(0.88, 1.25), rng.random() < 0.2, rng.random() < 0.3
    return Person(height, girth, coat, hat, bag, looks, clothing == "vest")


def dress(who: Person, j: Joints, helmet: bool = False) -> list[Piece]:
    """The pieces of a person with the given joints; facing x, left is y."""
    h, w = who.height_m, who.girth
    left = np.array([0.0, 1.0, 0.0])
    front = np.cross(left, j.up)
    at = np.array([-0.055, -0.02, 0.06, 0.13, 0.2, 0.26, 0.29, 0.325])[:, None] * h
    across = np.array([0.06, 0.092, 0.085, 0.08, 0.098, 0.107, 0.085, 0.03]) * h * w**0.7
    radii = np.stack([across, np.array([0.05, 0.066, 0.06, 0.058, 0.068, 0.062, 0.05, 0.032]) * h * w], 1)
    trunk = j.hips + at * j.up
    pieces = [tube("trousers", trunk[:3], radii[:3], left, 12), tube("jacket", trunk[1:], radii[1:] * 1.04, left, 12)]
    if who.banded:
        for share in (0.1, 0.2):
            width = radii[3 if share < 0.15 else 4] * 1.09
            pieces.append(tube("bands", j.hips + np.array([[share - 0.015], [share + 0.015]]) * h * j.up, [width, width], left, 12))
    if who.coat:
        below = np.array([[0.02], [-0.5 * who.coat], [-who.coat]]) * h
        pieces.append(tube("jacket", j.hips + below * np.array([0, 0, 1.0]), radii[1] * [[1.02, 1.05], [1.12, 1.25], [1.2, 1.4]], left, 12))
    if who.bag:
        pieces.append(ellipsoid("bag", j.hips + 0.2 * h * j.up - 0.085 * h * front, h * np.array([0.05, 0.08, 0.11])))
    pieces += [
        limb("head", j.hips + 0.3 * h * j.up, j.head, 0.03 * h, 0.03 * h),
        ellipsoid("head", j.head, h * np.array([0.055, 0.044, 0.066])),
    ]
    if helmet:
        pieces.append(ellipsoid("helmet", j.head + h * np.array([-0.006, 0, 0.028]), h * np.array([0.075, 0.054, 0.048])))
    else:
        pieces.append(
            ellipsoid("hair", j.head + h * np.array([-0.012, 0, 0.022]), h * np.array([0.053, 0.049, 0.065 if who.hat else 0.053]))
        )
    for i in range(2):
        pieces += [
            limb("jacket", j.shoulder[i], j.elbow[i], 0.034 * h * w**0.5, 0.028 * h),
            limb("jacket", j.elbow[i], j.hand[i] + 0.25 * (j.elbow[i] - j.hand[i]), 0.028 * h, 0.021 * h),
            ellipsoid("hands", j.hand[i], h * np.array([0.022, 0.017, 0.035]), sides=6, rings=5),
            limb("trousers", j.hip[i], j.knee[i], 0.052 * h * w**0.5, 0.036 * h),
            limb("trousers", j.knee[i], j.ankle[i], 0.037 * h, 0.024 * h),
            limb("shoes", j.ankle[i] + (0, 0, -0.014 * h), j.toe[i], 0.026 * h, 0.022 * h),
        ]
    return pieces


def upright(who: Person, thigh: Floats, knee: Floats, arm: Floats, elbow: Floats, spread: float = 0.0) -> Joints:
    """Joints of an upright person; the lower foot touches z = 0.

    thigh, arm: `[2]` rad, forward of hanging down. knee, elbow: `[2]` rad, by which they are bent. spread: of legs and arms, rad.
    """
    h, up = who.height_m, np.array([0.0, 0.0, 1.0])
    out = np.array([[0, side, 0] for side in SIDES])
    hip = out * 0.052 * h
    knees = hip + THIGH * h * _swung(thigh, out * spread)
    ankle = knees + SHANK * h * _swung(thigh - knee, out * spread)
    tilt = 0.6 * (thigh - knee)
    toe = ankle + h * (FOOT * np.stack([np.cos(tilt), 0 * tilt, np.sin(tilt)], 1) + out * 0.02 - xyz(0, 0, 0.017))
    lowest = min(float(ankle[:, 2].min() - SOLE * h), float(toe[:, 2].min() - 0.022 * h))
    shoulder = (TRUNK - 0.022) * h * up + out * 0.1 * h * who.girth**0.7
    elbows = shoulder + UPPER_ARM * h * _swung(arm, out * (0.12 + spread))
    hand = elbows + FOREARM * h * _swung(arm + elbow, out * 0.02)
    lift = -lowest * up
    head = (TRUNK + 0.125) * h * up + xyz(0.012 * h, 0, 0)
    return Joints(lift, up, head + lift, hip + lift, knees + lift, ankle + lift, toe + lift, shoulder + lift, elbows + lift, hand + lift)


def walking(who: Person, phase: float) -> Joints:
    """In mid-walk; phase: share 0..1 of a stride, the left leg passing the right one at 0."""
    angle = 2 * np.pi * phase + np.array([0.0, np.pi])
    thigh = 0.07 + 0.44 * np.sin(angle)
    knee = 0.1 + 0.85 * np.cos(angle + 0.4).clip(0) ** 2
    return upright(who, thigh, knee, -0.45 * np.sin(angle), 0.3 - 0.15 * np.sin(angle))


def standing(who: Person, rng: np.random.Generator) -> Joints:
    """On both feet; some hold a phone before them."""
    arm, elbow = rng.uniform(-0.1, 0.15, 2), rng.uniform(0.1, 0.4, 2)
    if rng.random() < 0.3:
        arm[0], elbow[0] = 0.35, 1.9
    bend = rng.uniform(0, 0.12)
    return upright(who, np.array([bend, 0.0]), np.array([2 * bend, 0.0]), arm, elbow, rng.uniform(0.02, 0.09))


def bent(start: Floats, stop: Floats, first: float, second: float, towards: Floats) -> Floats:
    """The joint `[3]` between two bones of lengths `first` and `second` from `start` to `stop`, bent towards a direction `[3]`.

    Stretched out if the bones are too short.
    """
    way = stop - start
    d = float(np.linalg.norm(way))
    along = way / d
    x = min((d * d + first**2 - second**2) / (2 * d), first)
    square = towards - along * (along @ towards)
    return start + x * along + np.sqrt(max(first**2 - x * x, 0.0)) * square / np.linalg.norm(square)


def _swung(forward: Floats, out: Floats) -> Floats:
    """Unit vectors `[2, 3]` that hang down, swung forward by `[2]` rad, and aside."""
    hanging = np.stack([np.sin(forward), 0 * forward, -np.cos(forward)], 1) + out
    return hanging / np.linalg.norm(hanging, axis=1, keepdims=True)


CLOTHING = "Albedo of the clothes: dark to 0.1, mixed to 0.45, light from 0.35 on, vest: with reflective bands; left out: by the seed"
STRIDE = 0.83  # of a walker's height
TURN_M = 4.6  # distance of a bicycle in one turn of its cranks
CRANK_M, WHEEL_M = 0.17, 0.34


class PedestrianParams(RandomParams):
    """Someone on foot; the origin lies between the feet."""

    kind: Literal["pedestrian"] = "pedestrian"
    category: Reported = "pedestrian"
    height_m: float | None = Field(None, ge=0.8, le=2.2, description="height; left out: from the seed, around 1.71 m")
    clothing: Clothing | None = Field(None, description=CLOTHING)
    stance: Literal["walking", "standing"] | None = Field(None, description="stance; left out: walking while it moves, else standing")

    def build(self) -> Body | Figure:
        """Raises LuxloopError where `parts` names an unknown part."""
        rng, track = self.random(), self.pose_track()
        who = someone(rng, self.height_m, self.clothing)
        start, moves = rng.random(), len(track.times_s) > 1
        if self.stance == "standing" or (self.stance is None and not moves):
            return self.body(dress(who, standing(who, rng)), who.looks, track)

        def shape(phase: float) -> Body:
            return self.body(dress(who, walking(who, phase)), who.looks, track)

        return Figure(self.name, shape, STRIDE * who.height_m, track, start) if moves else shape(start)


class CyclistParams(RandomParams):
    """Someone on a bicycle; the origin lies between the wheels' feet."""

    wheels_m: ClassVar = (1.06, 0.0)
    kind: Literal["cyclist"] = "cyclist"
    category: Reported = "cyclist"
    height_m: float | None = Field(None, ge=1.2, le=2.2, description="height of the rider on foot; left out: from the seed, around 1.71 m")
    clothing: Clothing | None = Field(None, description=CLOTHING)
    helmet: bool | None = Field(None, description="whether the rider wears a helmet; left out: from the seed, every other one does")
    lit: bool = Field(True, description="whether the bicycle's front and rear lamps are on")

    def build(self) -> Body | Figure:
        """Raises LuxloopError where `parts` names an unknown part."""
        rng, track = self.random(), self.pose_track()
        who = someone(rng, self.height_m, self.clothing)
        helmet = rng.random() < 0.5 if self.helmet is None else self.helmet
        lean, start = rng.uniform(0.35, 0.75), rng.random()
        machine: Looks = {
            "frame": ("car_paint", rng.uniform(0.03, 0.6)),
            "tyres": ("rubber", 0.05),
            "front_lamp": ("headlamp" if self.lit else "glass", 0.2),
            "rear_lamp": ("tail_lamp" if self.lit else "glass", 0.1),
            "reflector": ("retroreflective_sign", 0.1),
        }

        def shape(phase: float) -> Body:
            return self.body([*dress(who, riding(who, phase, lean), helmet), *bicycle(who, phase)], who.looks | machine, track)

        return Figure(self.name, shape, TURN_M, track, start) if len(track.times_s) > 1 else shape(start)


def _saddle(who: Person) -> Floats:
    """Place `[3]` m of the saddle, from which a leg almost reaches the lower pedal."""
    return np.array([-0.2, 0.0, 0.28 + 0.93 * (THIGH + SHANK) * who.height_m - CRANK_M + SOLE * who.height_m])


def _pedals(phase: float) -> Floats:
    """Places of the pedals, `[2, 3]` m; the upper one moves forward."""
    angle = 2 * np.pi * phase + np.array([0.0, np.pi])
    return np.stack([-0.03 + CRANK_M * np.sin(angle), [0.1, -0.1], 0.28 + CRANK_M * np.cos(angle)], 1)


def _grips(who: Person) -> Floats:
    return np.array([[0.4, side * 0.24, _saddle(who)[2] + 0.1] for side in SIDES])


def riding(who: Person, phase: float, lean: float) -> Joints:
    """Seated on a bicycle, leaning forward by `lean` rad; phase: share 0..1 of a turn of the cranks."""
    ankle = _pedals(phase) + xyz(-0.06, 0, 0.03 + SOLE * who.height_m)
    return seated(who, _saddle(who) + xyz(0, 0, 0.05 * who.height_m), lean, ankle, _grips(who))


def seated(who: Person, hips: Floats, lean: float, ankle: Floats, hand: Floats) -> Joints:
    """Seated astride with the hips at a place `[3]` m, leaning forward by `lean` rad. ankle, hand: `[2, 3]` m, the left one first."""
    h, up = who.height_m, np.array([np.sin(lean), 0.0, np.cos(lean)])
    out = np.array([[0.0, side, 0.0] for side in SIDES])
    hip = hips + out * 0.052 * h
    shoulder = hips + (TRUNK - 0.022) * h * up + out * 0.1 * h * who.girth**0.7
    knee = np.stack([bent(a, b, THIGH * h, SHANK * h, np.array([1.0, 0, 0.3])) for a, b in zip(hip, ankle, strict=True)])
    elbow = np.stack(
        [bent(a, b, UPPER_ARM * h, FOREARM * h, np.array([0, 0.5 * s, -1.0])) for a, b, s in zip(shoulder, hand, SIDES, strict=True)]
    )
    head = hips + (TRUNK + 0.06) * h * up + xyz(0.03 * h, 0, 0.07 * h)
    return Joints(hips, up, head, hip, knee, ankle, ankle + xyz(FOOT * h, 0, -0.012 * h), shoulder, elbow, hand)


def bicycle(who: Person, phase: float) -> list[Piece]:
    """Wheels, frame, cranks and lamps under a rider."""
    saddle, grips, pedals = _saddle(who), _grips(who), _pedals(phase)
    rear, front, crank = np.array([-0.48, 0, WHEEL_M]), np.array([0.58, 0, WHEEL_M]), np.array([-0.03, 0, 0.28])
    stem = grips.mean(0) * [0.92, 1, 1]
    low_stem = stem + 0.45 * (front - stem)
    seat, aside = saddle + xyz(0.03, 0, -0.15), xyz(0, 0.08, 0)
    tubes = [(crank, saddle + xyz(0, 0, -0.04)), (crank, low_stem), (seat, stem), (crank, rear), (seat, rear), (front, stem)]
    tubes += [(stem, grips[0]), (stem, grips[1]), (crank + aside, pedals[0]), (crank - aside, pedals[1])]
    pieces = [limb("frame", a, b, 0.018, 0.018, sides=5) for a, b in tubes]
    pieces += [torus("tyres", centre, WHEEL_M, 0.02, 16, 5) for centre in (rear, front)]
    pieces += [ellipsoid("tyres", saddle, (0.13, 0.07, 0.03), sides=8, rings=5)]
    pieces += [block("tyres", pedal, (0.1, 0.1, 0.03)) for pedal in pedals]
    pieces.append(ellipsoid("front_lamp", stem + xyz(0.06, 0, -0.06), (0.03, 0.035, 0.035), sides=8, rings=6))
    pieces.append(ellipsoid("rear_lamp", saddle + xyz(-0.12, 0, -0.1), (0.02, 0.03, 0.025), sides=8, rings=6))
    pieces.append(block("reflector", rear + xyz(-WHEEL_M + 0.06, 0, 0.2), (0.01, 0.06, 0.08)))
    return pieces
