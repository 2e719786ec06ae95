"""Pedestrians and cyclists."""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from luxloop.world.materials.library import MaterialName
from luxloop.world.scene.body import Body
from luxloop.world.scene.figure import Figure
from luxloop.world.traffic.making import MadeParams
from luxloop.world.traffic.people import (
    FOOT,
    FOREARM,
    SHANK,
    SIDES,
    SOLE,
    THIGH,
    TRUNK,
    UPPER_ARM,
    Clothing,
    Joints,
    Person,
    bent,
    dressed,
    someone,
    standing,
    walking,
)
from luxloop.world.traffic.shapes import Floats, Piece, block, ellipsoid, limb, xyz
from luxloop.world.traffic.tracked import Category

CLOTHING = "Albedo of the clothes: dark to 0.1, mixed to 0.45, light from 0.35 on, vest: with reflective bands; left out: by the seed"
STRIDE = 0.83  # of a walker's height
TURN_M = 4.6  # that a bicycle goes for a turn of its cranks
CRANK_M, WHEEL_M = 0.17, 0.34


class PedestrianParams(MadeParams):
    """Someone on foot; the origin lies between the feet."""

    kind: Literal["pedestrian"] = "pedestrian"
    category: Category | None = Field("pedestrian", description="class that trackers report to lighting functions")
    height_m: float | None = Field(None, ge=0.8, le=2.2, description="height; left out: from the seed, around 1.71 m")
    clothing: Clothing | None = Field(None, description=CLOTHING)
    stance: Literal["walking", "standing"] | None = Field(None, description="stance; left out: walking while it moves, else standing")

    def build(self) -> Body | Figure:
        """Raises LuxloopError where `parts` names one that there is not."""
        rng, track = self.random(), self.pose_track()
        who = someone(rng, self.height_m, self.clothing)
        start, moves = float(rng.random()), len(track.times_s) > 1
        if self.stance == "standing" or (self.stance is None and not moves):
            return self.made(dressed(who, standing(who, rng)), who.looks, track)

        def shape(phase: float) -> Body:
            return self.made(dressed(who, walking(who, phase)), who.looks, track)

        return Figure(self.name, shape, STRIDE * who.height_m, track, start) if moves else shape(start)


class CyclistParams(MadeParams):
    """Someone on a bicycle; the origin lies between the wheels' feet."""

    wheels_m: ClassVar = (1.06, 0.0)
    kind: Literal["cyclist"] = "cyclist"
    category: Category | None = Field("cyclist", description="class that trackers report to lighting functions")
    height_m: float | None = Field(None, ge=1.2, le=2.2, description="height of the rider on foot; left out: from the seed, around 1.71 m")
    clothing: Clothing | None = Field(None, description=CLOTHING)
    helmet: bool | None = Field(None, description="whether the rider wears a helmet; left out: from the seed, every other one does")
    lit: bool = Field(True, description="whether the bicycle's front and rear lamps are on")

    def build(self) -> Body | Figure:
        """Raises LuxloopError where `parts` names one that there is not."""
        rng, track = self.random(), self.pose_track()
        who = someone(rng, self.height_m, self.clothing)
        helmet = bool(rng.random() < 0.5) if self.helmet is None else self.helmet
        lean, start = float(rng.uniform(0.35, 0.75)), float(rng.random())
        machine: dict[str, tuple[MaterialName, float]] = {
            "frame": ("car_paint", float(rng.uniform(0.03, 0.6))),
            "tyres": ("rubber", 0.05),
            "front_lamp": ("headlamp" if self.lit else "glass", 0.2),
            "rear_lamp": ("tail_lamp" if self.lit else "glass", 0.1),
            "reflector": ("retroreflective_sign", 0.1),
        }

        def shape(phase: float) -> Body:
            return self.made([*dressed(who, riding(who, phase, lean), helmet), *bicycle(who, phase)], who.looks | machine, track)

        return Figure(self.name, shape, TURN_M, track, start) if len(track.times_s) > 1 else shape(start)


def _saddle(who: Person) -> Floats:
    """So high that a leg almost reaches the lower pedal."""
    return np.array([-0.2, 0.0, 0.28 + 0.93 * (THIGH + SHANK) * who.height_m - CRANK_M + SOLE * who.height_m])


def _pedals(phase: float) -> Floats:
    """`[2, 3]` m, going forward at the top."""
    angle = 2 * np.pi * phase + np.array([0.0, np.pi])
    return np.stack([-0.03 + CRANK_M * np.sin(angle), [0.1, -0.1], 0.28 + CRANK_M * np.cos(angle)], 1)


def _grips(who: Person) -> Floats:
    return np.array([[0.4, side * 0.24, _saddle(who)[2] + 0.1] for side in SIDES])


def riding(who: Person, phase: float, lean: float) -> Joints:
    """Seated on a bicycle, leaning forward by `lean` rad; phase: share 0..1 of a turn of the cranks."""
    h, hips = who.height_m, _saddle(who) + xyz(0, 0, 0.05 * who.height_m)
    up = np.array([np.sin(lean), 0.0, np.cos(lean)])
    out = np.array([[0.0, side, 0.0] for side in SIDES])
    hip, ankle, hand = hips + out * 0.052 * h, _pedals(phase) + xyz(-0.06, 0, 0.03 + SOLE * h), _grips(who)
    shoulder = hips + (TRUNK - 0.022) * h * up + out * 0.1 * h * who.girth**0.7
    knee = np.stack([bent(a, b, THIGH * h, SHANK * h, np.array([1.0, 0, 0.3])) for a, b in zip(hip, ankle, strict=True)])
    elbow = np.stack(
        [bent(a, b, UPPER_ARM * h, FOREARM * h, np.array([0, 0.5 * s, -1.0])) for a, b, s in zip(shoulder, hand, SIDES, strict=True)]
    )
    head = hips + (TRUNK + 0.06) * h * up + xyz(0.03 * h, 0, 0.07 * h)
    return Joints(hips, up, head, hip, knee, ankle, ankle + xyz(FOOT * h, 0, -0.012 * h), shoulder, elbow, hand)


def bicycle(who: Person, phase: float) -> list[Piece]:
    """Wheels, frame, cranks and lamps under a rider."""
    import trimesh

    saddle, grips, pedals = _saddle(who), _grips(who), _pedals(phase)
    rear, front, crank = np.array([-0.48, 0, WHEEL_M]), np.array([0.58, 0, WHEEL_M]), np.array([-0.03, 0, 0.28])
    stem = grips.mean(0) * [0.92, 1, 1]
    low_stem = stem + 0.45 * (front - stem)
    seat, aside = saddle + xyz(0.03, 0, -0.15), xyz(0, 0.08, 0)
    tubes = [(crank, saddle + xyz(0, 0, -0.04)), (crank, low_stem), (seat, stem), (crank, rear), (seat, rear), (front, stem)]
    tubes += [(stem, grips[0]), (stem, grips[1]), (crank + aside, pedals[0]), (crank - aside, pedals[1])]
    pieces = [limb("frame", a, b, 0.018, 0.018, sides=5) for a, b in tubes]
    for centre in (rear, front):
        ring = trimesh.creation.torus(WHEEL_M - 0.02, 0.02, major_sections=16, minor_sections=5)
        ring.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
        pieces.append(Piece("tyres", np.asarray(ring.vertices) + centre, np.asarray(ring.faces, dtype=np.int64)))
    pieces += [ellipsoid("tyres", saddle, (0.13, 0.07, 0.03), sides=8, rings=5)]
    pieces += [block("tyres", pedal, (0.1, 0.1, 0.03)) for pedal in pedals]
    pieces.append(ellipsoid("front_lamp", stem + xyz(0.06, 0, -0.06), (0.03, 0.035, 0.035), sides=8, rings=6))
    pieces.append(ellipsoid("rear_lamp", saddle + xyz(-0.12, 0, -0.1), (0.02, 0.03, 0.025), sides=8, rings=6))
    pieces.append(block("reflector", rear + xyz(-WHEEL_M + 0.06, 0, 0.2), (0.01, 0.06, 0.08)))
    return pieces
