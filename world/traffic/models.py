"""Models: objects that share no shape with the other kinds, so that a detector that was trained on those can be judged on them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from luxloop.world.scene.body import Body, Figure
from luxloop.world.traffic import vehicles
from luxloop.world.traffic.car import spotlights
from luxloop.world.traffic.figures import GAIT, STRIDE, beast, build, walker
from luxloop.world.traffic.shapes import Piece, limb, tube, xyz
from luxloop.world.traffic.solids import box, hull
from luxloop.world.traffic.tracked import Category, Looks, RandomParams
from luxloop.world.traffic.vehicles import Machine

SHAPES = 12  # of a gait, each of which takes 10 ms
TURN_M = 5.2  # distance of a bicycle in one turn of its cranks
Walker = Literal["adult", "coat", "skirt", "umbrella", "child", "pram", "wheelchair"]
Rider = Literal["bicycle", "kick_scooter", "motor_scooter"]
Vehicle = Literal[vehicles.Car, "lorry", "bus", "tractor"]
Beast = Literal["boar", "dog"]
Thing = Literal["wheelie_bin", "hydrant", "statue", "poster"]
Model = Literal[Walker, Rider, Vehicle, Beast, Thing]


@dataclass(frozen=True)
class Shape:
    """A body at a moment. machine: makes it. cycle_m: distance in which its gait repeats, 0 of what has none."""

    machine: Callable[[], Machine]
    looks: Looks
    cycle_m: float = 0.0


Maker = Callable[[np.random.Generator, float | None, bool], Shape]  # from a seed, phase of the gait if it moves, and whether lamps are on
Wheels = tuple[float, float] | None  # as those of `PoseTrack`


def _walks(rng: np.random.Generator, phase: float | None, lit: bool, child: bool = False, gown: str = "", umbrella: bool = False) -> Shape:
    who = build(rng, child, gown, umbrella=umbrella)
    return Shape(lambda: Machine(walker(who, phase, rng=rng)), who.looks, STRIDE * who.height_m)


def _pram(rng: np.random.Generator, phase: float | None, lit: bool) -> Shape:
    who = build(rng, gown=str(rng.choice(["", "coat"])))
    return Shape(lambda: vehicles.pram(who, phase), who.looks | vehicles.looks(rng, lit), STRIDE * who.height_m)


def _rides(rng: np.random.Generator, phase: float | None, lit: bool, machine: Callable[..., Machine], helmet: float = 0.0) -> Shape:
    who = build(rng, hair="helmet" if rng.random() < helmet else "")
    return Shape(lambda: machine(who), who.looks | vehicles.looks(rng, lit))


def _cycles(rng: np.random.Generator, phase: float | None, lit: bool) -> Shape:
    who = build(rng, hair="helmet" if rng.random() < 0.4 else "")
    basket, start = rng.random() < 0.5, rng.random()
    return Shape(lambda: vehicles.bicycle(who, start if phase is None else phase, basket), who.looks | vehicles.looks(rng, lit), TURN_M)


def _drives(rng: np.random.Generator, phase: float | None, lit: bool, machine: Callable[[np.random.Generator], Machine]) -> Shape:
    return Shape(lambda: machine(rng), vehicles.looks(rng, lit))


def _beast(rng: np.random.Generator, phase: float | None, lit: bool, boar: bool) -> Shape:
    """Shoulders of a boar 0.6 to 1 m high, of a dog 0.35 to 0.75 m."""
    height = rng.uniform(0.6, 1.0) if boar else rng.uniform(0.35, 0.75)
    fur = rng.uniform(0.04, 0.15) if boar else rng.uniform(0.05, 0.6)
    names = ("trunk", "head", "legs", "tail")
    looks: Looks = {name: ("fur", fur if name in ("trunk", "tail") or boar else rng.uniform(0.5, 1.2) * fur) for name in names}
    girth = rng.uniform(0.85, 1.15)
    return Shape(lambda: Machine(beast(boar, height, girth, phase)), looks, GAIT * height)


def _stands(rng: np.random.Generator, phase: float | None, lit: bool, pieces: Callable[[np.random.Generator], list[Piece]]) -> Shape:
    stone, paint, second = rng.uniform(0.15, 0.5), rng.uniform(0.05, 0.6), rng.uniform(0.05, 0.7)
    looks: Looks = {
        "stone": ("matt", stone),
        "shell": ("car_paint", paint),
        "lid": ("car_paint", second),
        "tyres": ("rubber", 0.05),
        "frame": ("metal", 0.25),
        "sheet": ("matt", rng.uniform(0.4, 0.8)),
    }
    printed: Looks = {f"print_{name}": ("matt", albedo) for name, (_, albedo) in build(rng).looks.items()}
    return Shape(lambda: Machine(pieces(rng)), looks | printed)


def _wheelie_bin(rng: np.random.Generator) -> list[Piece]:
    """EN 840-1, 120 and 240 l: 0.48 m x 0.55 m x 0.94 m and 0.58 m x 0.73 m x 1.07 m."""
    x, y, z = (0.55, 0.48, 0.94) if rng.random() < 0.5 else (0.73, 0.58, 1.07)
    low, high = np.array([[0.36, 0.34], [0.5, 0.5]]) * (x, y)
    corners = [(sx * half[0], sy * half[1], height) for half, height in ((low, 0.06), (high, 0.92 * z)) for sx in (1, -1) for sy in (1, -1)]
    wheels = [
        tube("tyres", [(-0.36 * x, s * 0.3 * y, 0.1), (-0.36 * x, s * 0.46 * y, 0.1)], [[0.1, 0.1]] * 2, (1, 0, 0), 16) for s in (1, -1)
    ]
    return [
        hull("shell", corners),
        box("lid", (-0.54 * x, -0.52 * y, 0.92 * z), (0.54 * x, 0.52 * y, z), 0.03),
        *wheels,
        box("shell", (0.1, -0.2 * y, 0), (0.16, 0.2 * y, 0.07)),
    ]


def _hydrant(rng: np.random.Generator) -> list[Piece]:
    """A pillar hydrant 0.75 to 1.1 m high."""
    z = rng.uniform(0.75, 1.1)
    shaft = [(0.18, 0.0), (0.18, 0.05), (0.12, 0.06), (0.12, 0.6 * z), (0.17, 0.61 * z), (0.17, 0.82 * z), (0.13, 0.93 * z), (0.05, z)]
    caps = [limb("lid", (0, 0.12 * s, 0.71 * z), (0, 0.2 * s, 0.71 * z), 0.06, 0.06, 10) for s in (1, -1)]
    heights, radii = np.array(shaft).T[[1, 0], :, None]
    return [
        tube("shell", heights * (0, 0, 1), radii * (1, 1), (0, 1, 0), 20),
        *caps,
        limb("lid", (0.12, 0, 0.71 * z), (0.21, 0, 0.71 * z), 0.08, 0.08, 12),
    ]


def _statue(rng: np.random.Generator) -> list[Piece]:
    """Somebody of stone, larger than life, on a pedestal."""
    who, foot = build(rng, gown=str(rng.choice(["", "coat", "skirt"]))), rng.uniform(0.5, 1.1)
    stone = [replace(each, part="stone", vertices=1.1 * each.vertices + xyz(0, 0, foot)) for each in walker(who, None, rng=rng)]
    return [*stone, box("stone", (-0.4, -0.4, 0), (0.4, 0.4, 0.15)), box("stone", (-0.32, -0.32, 0.1), (0.32, 0.32, foot), 0.03)]


def _poster(rng: np.random.Generator) -> list[Piece]:
    """A sheet of 1.185 m x 1.75 m (4/1) in a frame, with a picture of somebody; it faces along its x axis."""
    who = build(rng, gown=str(rng.choice(["", "coat", "skirt"])))
    away, size = rng.uniform(-0.2, 0.2), rng.uniform(0.6, 1.0) * 1.65 / who.height_m
    flat = []
    for each in walker(who, rng.random(), rng=rng):
        x, y, z = each.vertices.T
        at = np.stack([0.062 + 0.004 * x, size * y + away, 0.7 + size * z], 1)
        flat.append(replace(each, part=f"print_{each.part}", vertices=at))
    frame = [box("frame", (-0.06, -0.68, 0.55), (0.05, 0.68, 2.5), 0.02), box("sheet", (0.0, -0.59, 0.64), (0.055, 0.59, 2.39), 0.002)]
    return [*frame, *flat, *(box("frame", (-0.05, s * 0.5 - 0.04, 0), (0.04, s * 0.5 + 0.04, 0.6)) for s in (1, -1))]


MODELS: dict[Model, tuple[Category | None, Wheels, Maker]] = {
    "adult": ("pedestrian", None, _walks),
    "coat": ("pedestrian", None, partial(_walks, gown="coat")),
    "skirt": ("pedestrian", None, partial(_walks, gown="skirt")),
    "umbrella": ("pedestrian", None, partial(_walks, umbrella=True)),
    "child": ("pedestrian", None, partial(_walks, child=True)),
    "pram": ("pedestrian", None, _pram),
    "wheelchair": ("pedestrian", (0.5, 0.5), partial(_rides, machine=vehicles.wheelchair)),
    "bicycle": ("cyclist", (1.07, 0.0), _cycles),
    "kick_scooter": ("cyclist", (0.95, 0.0), partial(_rides, machine=vehicles.kick_scooter, helmet=0.3)),
    "motor_scooter": ("motorcycle", (1.24, 0.0), partial(_rides, machine=vehicles.motor_scooter, helmet=1.0)),
    **{
        name: ("car", (0.6 * CAR[0][0], 1.5), partial(_drives, machine=partial(vehicles.car, kind=name)))
        for name, CAR in vehicles.CARS.items()
    },
    "lorry": ("truck", (5.0, 2.0), partial(_drives, machine=vehicles.lorry)),
    "bus": ("truck", (5.8, 2.0), partial(_drives, machine=vehicles.bus)),
    "tractor": ("truck", (2.25, 1.7), partial(_drives, machine=vehicles.tractor)),
    "boar": ("animal", None, partial(_beast, boar=True)),
    "dog": ("animal", None, partial(_beast, boar=False)),
    "wheelie_bin": (None, None, partial(_stands, pieces=_wheelie_bin)),
    "hydrant": (None, None, partial(_stands, pieces=_hydrant)),
    "statue": (None, None, partial(_stands, pieces=_statue)),
    "poster": (None, None, partial(_stands, pieces=_poster)),
}


class ModelParams(RandomParams):
    """A road user or thing whose shape no other kind has; the origin lies on the ground below its middle."""

    kind: Literal["model"] = "model"
    model: Model = Field(examples=["bus"], description="what it is")
    lit: bool = Field(True, description="whether the lamps of a vehicle are on")

    @model_validator(mode="after")
    def _category_of_model(self) -> Self:
        return self if "category" in self.model_fields_set else self.model_copy(update={"category": MODELS[self.model][0]})

    @classmethod
    def of(cls, **keys: Any) -> Self:
        """With the category of the model, unless `category` is given. keys: of a table."""
        return cls(**{"category": MODELS[keys["model"]][0], **keys})

    @property
    def wheels_m(self) -> Wheels:  # type: ignore[override]
        """Wheelbase and track, with which it tilts as the road does."""
        return MODELS[self.model][1]

    def build(self) -> Body | Figure:
        """Raises LuxloopError where `parts` names an unknown part."""
        track, (_, _, make) = self.pose_track(), MODELS[self.model]
        moves = len(track.times_s) > 1
        start = float(np.random.default_rng([self.seed, 1]).random())

        def shape(phase: float) -> Body:
            made = make(self.random(), phase if moves else None, self.lit)
            machine = made.machine()
            return self.body(machine.pieces, made.looks, track, spotlights(machine.head, machine.tail) if self.lit else ())

        cycle_m = make(self.random(), None, self.lit).cycle_m if moves else 0.0
        return Figure(self.name, shape, cycle_m, track, start, SHAPES) if cycle_m else shape(start)
