"""Bodies for training alone: those of the first population in random proportions, poses and textures, with loads; boxes on wheels;
random clutter. None is a shape of the second population, on which detectors are judged.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import torch
import trimesh
from torch import Tensor

from luxloop.world.frames import pose_from_degrees
from luxloop.world.materials.library import MaterialName
from luxloop.world.roads.base import Road
from luxloop.world.scene.body import Body, Figure, Part, PoseTrack
from luxloop.world.traffic.car import WHEEL_M, spotlights
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.traffic.people import SIDES, PedestrianParams, dress, someone, upright
from luxloop.world.traffic.shapes import Floats, Piece, blob, block, ellipsoid, join, limb, plate, polygon, tube, xyz
from luxloop.world.traffic.tracked import Category, Looks, RandomParams

PLAIN: Final = 0.3  # share of bodies that stay as they are
TEXTURED: Final = ("cloth", "car_paint", "fur", "matt", "rubber")
COVERS: Final[tuple[MaterialName, ...]] = ("cloth", "car_paint", "matt", "metal", "rubber", "bark")
# least and greatest factors of length, width and height
FACTORS: Final = {
    "pedestrian": ((0.75, 1.6), (0.75, 1.6), (0.55, 1.15)),
    "cyclist": ((0.65, 1.25), (0.75, 1.7), (0.8, 1.15)),
    "car": ((0.6, 2.2), (0.85, 1.35), (0.85, 2.0)),
    "animal": ((0.7, 1.5), (0.7, 1.8), (0.4, 1.3)),
}
UNEVEN: Final = 0.2  # deviation of the logarithm of the factors of quarters of a side
Rng = np.random.Generator


def between(rng: Rng, low: float, high: float) -> float:
    """A number, uniform in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def crowd(tables: dict[str, Any], seed: int) -> dict[str, Any]:
    """More objects than in tables of `random_tables`; roads with grades, or wet, of every other seed."""
    rng = np.random.default_rng([seed, 6])
    traffic = tables["traffic"] | {"on_road": True}
    for key, more in {"pedestrians": 2, "cyclists": 1, "animals": 1, "parked": 1}.items():
        traffic[key] += more
    if seed % 2:
        return {"traffic": traffic}
    grades, x = [], float(rng.uniform(4, 15))
    while x < 100:
        grades.append({"x_m": round(x, 1), "percent": round(float(rng.uniform(-7, 7)), 1), "curve_m": 15.0})
        x += 15 + float(rng.uniform(5, 40))
    surface = tables["surface"] | {"wet": round(float(rng.uniform(0.2, 1)), 2) if seed % 4 else 0.0}
    road = {"kind": "profile", "grades": grades, "roughness_class": "B", "seed": int(rng.integers(1000))}
    return {"traffic": traffic, "road": road, "surface": surface}


def widen_scene(items: Sequence[ObjectParams], road: Road, time_s: float, rng: Rng) -> list[tuple[Body | Figure, Category | None]]:
    """Bodies of objects at a time on a road, wider, with company and clutter, and what each counts as."""
    found = list[tuple[Body | Figure, Category | None]]()
    for item in items:
        made = item.build()
        body = widen(item, made.at(time_s) if isinstance(made, Figure) else made, rng)
        category: Category | None = "car" if item.kind == "car" else item.category
        found.append((_place(body, body.track.pose_at(time_s), road, item.wheels_m), category))
        if item.kind == "pedestrian" and rng.random() < 0.25:
            beside = body.track.pose_at(time_s) @ pose_from_degrees((rng.normal(0, 0.2), rng.uniform(0.55, 0.9), 0.0))
            other = item.model_copy(update={"seed": int(rng.integers(2**31)), "name": f"{item.name}_company"}).build()
            found.append((_place(widen(item, other.at(0.0) if isinstance(other, Figure) else other, rng), beside, road, None), category))
    return [*found, *((each, None) for each in clutter(int(rng.integers(2, 8)), [body for body, _ in found], road, rng))]


def _place(body: Body, T_world_body: Tensor, road: Road, wheels_m: tuple[float, float] | None) -> Body:
    return replace(body, track=replace(PoseTrack.static(T_world_body), road=road, wheels_m=wheels_m))


def widen(item: ObjectParams, body: Body, rng: Rng) -> Body:
    """A body of an object in other proportions, another pose or another texture, with loads; some stay as they are."""
    if item.kind not in FACTORS or rng.random() < PLAIN:
        return body
    other = {"pedestrian": (_pose, 0.3), "car": (_vehicle, 0.4), "animal": (_animal, 0.5)}.get(item.kind)
    if other and rng.random() < other[1]:
        body = other[0](item, body.track, rng)
    body = _texture(_warp(body, FACTORS[item.kind], rng), rng)
    return _join(body, *_loads(body, item.kind, rng)) if rng.random() < 0.6 else body


def _warp(body: Body, factors: Sequence[tuple[float, float]], rng: Rng) -> Body:
    """A body stretched along its axes, unevenly, and wider or narrower from height to height; its foot stays."""
    vertices = np.array(body.mesh.vertices)
    low, high = vertices.min(0), vertices.max(0)
    knots = np.linspace(low, high, 5)
    steps = np.exp(rng.normal(0, UNEVEN, (4, 3)))
    grown = (high - low) * [between(rng, *each) for each in factors]
    places = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, 0)]) / steps.sum(0) * grown
    places += np.where([True, True, False], low * grown / (high - low).clip(1e-6), low)
    girths = np.exp(rng.normal(0, 0.15, (5, 2)))

    def moved(points: Floats) -> Floats:
        found = np.stack([np.interp(points[:, k], knots[:, k], places[:, k]) for k in range(3)], 1)
        for k in range(2):
            found[:, k] *= np.interp(points[:, 2], knots[:, 2], girths[:, k])
        return found

    lamps = tuple(replace(each, position=torch.from_numpy(moved(each.position.numpy()[None])[0])) for each in body.spotlights)
    return replace(body, mesh=trimesh.Trimesh(moved(vertices), body.mesh.faces, process=False), spotlights=lamps)


def _texture(body: Body, rng: Rng) -> Body:
    """A body some of whose parts have blotches of another albedo: where the sum of two random waves is positive."""
    assert body.part_of_face is not None
    of_face, parts, middles = body.part_of_face.numpy().copy(), list(body.parts), np.asarray(body.mesh.triangles_center)
    for k, part in enumerate(body.parts):
        if part.material in TEXTURED and rng.random() < 0.4:
            ways = rng.normal(0, 1, (2, 3))
            ways *= 2 * np.pi / (np.linalg.norm(ways, axis=1) * np.exp(rng.uniform(np.log(0.08), np.log(0.8), 2)))[:, None]
            blotched = np.sin(middles @ ways.T + rng.uniform(0, 2 * np.pi, 2)).sum(1) > rng.uniform(-0.8, 0.8)
            of_face[(of_face == k) & blotched] = len(parts)
            parts.append(Part(f"{part.name}_blotches", between(rng, 0.03, 0.8), part.material))
    return replace(body, parts=tuple(parts), part_of_face=torch.from_numpy(of_face))


def _join(body: Body, pieces: list[Piece], looks: Looks) -> Body:
    assert body.part_of_face is not None
    mesh, names, of_face = join(pieces)
    parts = tuple(Part(name, looks[name][1], looks[name][0]) for name in names)
    of_both = torch.cat([body.part_of_face, torch.from_numpy(of_face) + len(body.parts)])
    return replace(body, mesh=body.mesh + mesh, parts=body.parts + parts, part_of_face=of_both)


def _cover(rng: Rng) -> tuple[MaterialName, float]:
    return COVERS[int(rng.integers(len(COVERS)))], between(rng, 0.03, 0.85)


def _loads(body: Body, kind: str, rng: Rng) -> tuple[list[Piece], Looks]:
    """Boxes, balls and rods that touch a body, of random sizes in random places; people also wear cones."""
    low, high = (each.numpy() for each in body.bounds)
    middle, half = (low + high) / 2, (high - low) / 2
    pieces, looks, people = list[Piece](), Looks(), kind == "pedestrian"
    size = 0.35 if people else 0.25
    for k in range(int(rng.integers(1, 4))):
        name = f"load_{k}"
        looks[name] = _cover(rng)
        radii = np.exp(rng.uniform(np.log(0.06), np.log(max(size * high[2], 0.1)), 3)) * rng.choice([0.5, 1.0])
        way = rng.normal(0, 1, 3) * (1, 1, 0.8)
        way /= np.abs(way).max()
        at = middle + way * (half + 0.6 * radii)
        at[2] = max(at[2], radii[2] if people or kind == "animal" else 0.3 + radii[2])
        shape = rng.random()
        if shape < 0.45:
            pieces.append(block(name, at, 2 * radii))
        elif shape < 0.8:
            pieces.append(ellipsoid(name, at, radii))
        else:
            pieces.append(limb(name, middle + 0.3 * way * half, at, 0.02, between(rng, 0.01, 0.04)))
    if people and rng.random() < 0.4:  # worn from the waist or the shoulders
        looks["cone"] = _cover(rng)
        z = high[2] * np.array([rng.uniform(0.5, 0.82), rng.uniform(0.3, 0.48), rng.uniform(0.03, 0.3)])
        radii = high[2] * np.sort(rng.uniform(0.06, 0.2, 3))
        pieces.append(tube("cone", [xyz(0, 0, each) for each in z], np.stack([radii, radii * rng.uniform(0.7, 1.2)], 1), (0, 1, 0), 14))
    return pieces, looks


def _pose(item: ObjectParams, track: PoseTrack, rng: Rng) -> Body:
    """Somebody in a random pose, bent or seated on a box."""
    assert isinstance(item, PedestrianParams)
    who = someone(rng, item.height_m, item.clothing)
    seated = rng.random() < 0.5
    thigh = rng.uniform(0.9, 1.7, 2) if seated else rng.uniform(-0.5, 0.9, 2)
    knee = rng.uniform(0.6, 1.8, 2) if seated else rng.uniform(0, 0.9, 2)
    joints = upright(who, thigh, knee, rng.uniform(-0.6, 2.2, 2), rng.uniform(0, 2.2, 2), rng.uniform(0, 0.15))
    pieces, looks = dress(who, joints), dict(who.looks)
    if seated:
        looks["box"] = _cover(rng)
        size = np.array([*rng.uniform((0.25, 0.3), (0.7, 0.8)), max(float(joints.hips[2]) - 0.08 * who.height_m, 0.1)])
        pieces.append(block("box", (-0.1 * rng.random(), 0, size[2] / 2), size))
    return item.body(pieces, looks, track)


def _animal(item: ObjectParams, track: PoseTrack, rng: Rng) -> Body:
    """A quadruped of random proportions; lengths are shares of the height of its shoulders."""
    assert isinstance(item, RandomParams)
    length, depth, width, legs = rng.uniform(0.8, 1.6), rng.uniform(0.12, 0.27), rng.uniform(0.1, 0.26), rng.uniform(0.35, 0.7)
    x = length * np.array([-0.52, -0.45, -0.25, 0.0, 0.25, 0.42, 0.5])
    z = 1 - depth + rng.normal(0, 0.04, 7)
    shares = np.array([0.3, 0.7, 0.95, 1.0, 1.0, 0.85, 0.5]) * np.exp(rng.normal(0, 0.1, 7))
    pieces = [tube("trunk", np.stack([x, 0 * x, z], 1), np.stack([width * shares, depth * shares], 1), (0, 1, 0), 12)]
    neck, angle = xyz(0.42 * length, 0, 1 - 0.8 * depth), rng.uniform(-0.9, 1.3)
    poll = neck + rng.uniform(0.15, 0.6) * xyz(np.cos(angle), 0, np.sin(angle))
    size, down = rng.uniform(0.07, 0.16), rng.uniform(-0.2, 1.1)
    nose = poll + rng.uniform(0.15, 0.4) * xyz(np.cos(down), 0, -np.sin(down))
    pieces += [
        limb("trunk", neck, poll, rng.uniform(0.6, 0.95) * depth, 0.9 * size),
        limb("head", poll, nose, size, rng.uniform(0.4, 0.8) * size),
    ]
    ear = rng.uniform(0.05, 0.25)
    for side in SIDES:
        pieces.append(
            limb("head", poll + xyz(0, 0.6 * side * size, 0.5 * size), poll + xyz(-0.03, side * (size + 0.5 * ear), ear), 0.04, 0.015)
        )
    thick, swing = rng.uniform(0.04, 0.1), rng.normal(0, 0.25, 4)
    for k, (at, side) in enumerate((at, side) for at in (0.38, -0.44) for side in SIDES):
        hip = xyz(at * length, 0.7 * side * width, 1 - depth)
        knee = hip + xyz(0.5 * legs * swing[k], 0, -(1 - depth) * rng.uniform(0.45, 0.6))
        foot = xyz(knee[0] + rng.normal(0, 0.08), hip[1], 0.03)
        pieces += [limb("legs", hip, knee, 1.5 * thick, 0.8 * thick), limb("legs", knee, foot, 0.8 * thick, 0.5 * thick)]
    tail = xyz(-0.5 * length, 0, 1 - 0.6 * depth)
    pieces.append(limb("tail", tail, tail + rng.uniform(0.1, 0.5) * xyz(-rng.uniform(0.2, 1), 0, rng.uniform(-1, 0.8)), 0.04, 0.02))
    fur, height = between(rng, 0.04, 0.5), rng.uniform(0.35, 1.5)
    looks: Looks = {"trunk": ("fur", fur), "head": ("fur", between(rng, 0.04, 0.5)), "legs": ("fur", fur), "tail": ("fur", fur)}
    return item.body([replace(each, vertices=each.vertices * height) for each in pieces], looks, track)


def _vehicle(item: ObjectParams, track: PoseTrack, rng: Rng) -> Body:
    """Boxes on wheels, sharp or rounded, with windows, plates and lamps."""
    assert isinstance(item, RandomParams)
    length, width, height, floor = between(rng, 2.4, 11), rng.uniform(1.4, 2.6), between(rng, 1.3, 3.8), rng.uniform(0.2, 0.6)
    lit = bool(getattr(item, "lit", False))
    names = [f"box_{k}" for k in range(int(rng.integers(1, 5)))]
    looks: Looks = {name: ("car_paint", between(rng, 0.03, 0.85)) for name in names}
    looks |= {"windows": ("glass", 0.03), "wheels": ("rubber", 0.05), "plates": ("retroreflective_sign", 0.5)}
    looks |= {"head": ("headlamp" if lit else "glass", 0.25), "tail": ("tail_lamp" if lit else "retroreflective_sign", 0.08)}
    cuts = length * (np.concatenate([[0], np.sort(rng.uniform(0.1, 0.9, len(names) - 1)), [1]]) - 0.5)
    tops = floor + (height - floor) * rng.uniform(0.3, 1, len(names))
    tops[rng.integers(len(names))] = height
    pieces, rounded = list[Piece](), rng.random() < 0.5
    for name, rear, front, top in zip(names, cuts[:-1], cuts[1:], tops.tolist(), strict=True):
        centre, size = xyz((rear + front) / 2, 0, (floor + top) / 2), xyz(front - rear, width, top - floor)
        if rounded:
            ends = np.array([rear, rear + 0.04 * size[0], front - 0.04 * size[0], front])
            shares = np.array([0.9, 1, 1, 0.9])[:, None] * size[1:] / 2
            pieces.append(tube(name, np.stack([ends, 0 * ends, 0 * ends + centre[2]], 1), shares, (0, 1, 0), 20, power=rng.uniform(3, 9)))
        else:
            pieces.append(block(name, centre, size))
        if rng.random() < 0.6 and top > 1.1:
            up = xyz(0, 0, rng.uniform(0.1, 0.3) * size[2])
            tall = rng.uniform(0.25, 0.5) * size[2]
            pieces.append(block("windows", centre + up, (0.8 * size[0], width + 0.02, tall)))
            pieces.append(block("windows", centre + up, (size[0] + 0.02, 0.85 * width, tall)))
    radius = rng.uniform(0.8, 1.6) * WHEEL_M
    for x in np.linspace(-0.34, 0.32, int(rng.integers(2, 5))) * length:
        for side in SIDES:
            ends = xyz(x, side * width / 2, radius) + np.array([[-0.25], [0.02]]) * xyz(0, side, 0)
            pieces.append(tube("wheels", ends, [[radius, radius]] * 2, (1, 0, 0), 16))
    z_head, z_tail, out = (rng.uniform(floor + 0.1, floor + 0.5) for _ in range(3))
    half = np.array([xyz(0, side * rng.uniform(0.3, 0.46) * width, 0) for side in SIDES])
    head, tail = xyz(length / 2, 0, z_head) + half, xyz(-length / 2, 0, z_tail) + half
    pieces += [ellipsoid("head", each, rng.uniform(0.05, 0.16, 3), 10, 7) for each in head]
    pieces += [ellipsoid("tail", each, rng.uniform(0.04, 0.14, 3), 10, 7) for each in tail]
    pieces += [block("plates", (way * (length / 2 + 0.01), 0, out), (0.01, 0.52, 0.11)) for way in (1, -1)]
    return item.body(pieces, looks, track, spotlights(head, tail) if lit else ())


def clutter(number: int, others: Sequence[Body | Figure], road: Road, rng: Rng) -> list[Body]:
    """Clutter in places beside or on the road that no other body covers."""
    taken = [(each.track.pose_at(0.0)[:2, 3].numpy(), float(np.hypot(*np.abs(each.bounds[:, :2].numpy()).max(0)))) for each in others]
    found = list[Body]()
    for k in range(number):
        make = (_stack, _panel, _bush)[int(rng.choice(3, p=[0.5, 0.3, 0.2]))]
        pieces, looks = make(rng)
        reach = float(np.hypot(*np.abs(np.concatenate([each.vertices for each in pieces])[:, :2]).max(0)))
        for _ in range(20):
            x = between(rng, 9, 55)
            place = np.array([x, rng.uniform(-0.26, 0.26) * x])
            if all(np.hypot(*(place - at)) > reach + other for at, other in taken):
                yaw_deg = float(180 + rng.normal(0, 25) if make is _panel else rng.uniform(-180, 180))
                mesh, names, of_face = join(pieces)
                parts = tuple(Part(name, looks[name][1], looks[name][0]) for name in names)
                body = Body(f"thing_{k}", mesh, smooth=True, parts=parts, part_of_face=torch.from_numpy(of_face))
                found.append(_place(body, pose_from_degrees((*place.tolist(), 0.0), yaw_deg=yaw_deg), road, None))
                taken.append((place, reach))
                break
    return found


def _stack(rng: Rng) -> tuple[list[Piece], Looks]:
    """One to five boxes, balls and cones on each other, some with arms."""
    pieces, looks, z = list[Piece](), Looks(), 0.0
    height, wide = between(rng, 0.4, 3.5), between(rng, 0.12, 0.9)
    shares = rng.dirichlet([3.0] * int(rng.integers(1, 6)))
    same = _cover(rng) if rng.random() < 0.5 else None
    for k, share in enumerate(shares):
        name, tall, radii = f"layer_{k}", float(share) * height, wide * np.exp(rng.normal(0, 0.35, 2)) / 2
        looks[name] = same or _cover(rng)
        shape = rng.random()
        if shape < 0.4:
            pieces.append(block(name, (0, 0, z + tall / 2), (*(2 * radii), tall)))
        elif shape < 0.6:
            pieces.append(ellipsoid(name, (0, 0, z + tall / 2), (*radii, tall / 2)))
        else:
            ends = radii * np.exp(rng.normal(0, 0.2, (3, 1)))
            pieces.append(tube(name, [xyz(0, 0, z + share * tall) for share in (0, 0.5, 1)], ends, (0, 1, 0), 14, power=rng.uniform(2, 6)))
        z += tall
    if rng.random() < 0.3:
        looks["arm"] = same or _cover(rng)
        for _ in range(int(rng.integers(1, 4))):
            start = xyz(0, 0, rng.uniform(0.2, 0.95) * height)
            pieces.append(limb("arm", start, start + rng.normal(0, 0.4, 3) * wide + xyz(0.05, 0, 0), *rng.uniform(0.02, 0.08, 2)))
    return pieces, looks


def _panel(rng: Rng) -> tuple[list[Piece], Looks]:
    """A board with cells and ellipses of random shades, on posts or on the ground."""
    width, height = between(rng, 0.4, 3), between(rng, 0.4, 2.5)
    foot, shades = rng.uniform(0, 1.8) * (rng.random() < 0.7), int(rng.integers(2, 5))
    looks: Looks = {f"shade_{k}": ("matt", between(rng, 0.03, 0.85)) for k in range(shades)} | {
        "board": _cover(rng),
        "posts": ("metal", 0.3),
    }
    pieces = [block("board", (0, 0, foot + height / 2), (0.06, width, height))]
    columns, rows = rng.integers(1, 7, 2)
    for row in range(rows):
        for column in range(columns):
            if rng.random() < 0.7:
                y, z = (np.array([column, column + 1]) / columns - 0.5) * width, foot + np.array([row, row + 1]) / rows * height
                corners = [(0.034, y[0], z[0]), (0.034, y[1], z[0]), (0.034, y[1], z[1]), (0.034, y[0], z[1])]
                pieces.append(plate(f"shade_{rng.integers(shades)}", corners))
    for k in range(int(rng.integers(0, 8))):
        at, size = xyz(0.036 + 0.002 * k, rng.uniform(-0.4, 0.4) * width, foot + rng.uniform(0.1, 0.9) * height), rng.uniform(0.04, 0.35, 2)
        outline = polygon((0, 0, 0), 1, 1, int(rng.choice([3, 4, 16])), rng.uniform(0, 3)) * xyz(1, size[0] * width, size[1] * height)
        pieces.append(plate(f"shade_{rng.integers(shades)}", (outline + at).clip((-1, -width / 2, foot), (1, width / 2, foot + height))))
    if foot:
        pieces += [limb("posts", (-0.05, y * width, 0), (-0.05, y * width, foot + 0.3), 0.04, 0.04) for y in rng.choice([0, 0.4, -0.4], 2)]
    return pieces, looks


def _bush(rng: Rng) -> tuple[list[Piece], Looks]:
    """Blobs of leaves, wider or higher than those of the first population."""
    size = between(rng, 0.3, 1.3) * np.exp(rng.normal(0, 0.3, 3))
    around = [size * rng.uniform(-0.7, 0.7, 3) + xyz(0, 0, 0.8 * size[2]) for _ in range(int(rng.integers(1, 5)))]
    return [blob("leaves", each, size * rng.uniform(0.4, 0.9, 3), rng, rng.uniform(0.05, 0.3)) for each in around], {
        "leaves": ("leaves", between(rng, 0.03, 0.3))
    }
