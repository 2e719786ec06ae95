"""People and animals of the second population: capsules on joints that follow from where hands and feet are."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from luxloop.world.traffic.people import bent
from luxloop.world.traffic.shapes import Floats, Piece, tube, xyz
from luxloop.world.traffic.solids import Capsule, blend
from luxloop.world.traffic.tracked import Looks

STRIDE: Final = 0.72  # of the height
GAIT: Final = 1.1  # of an animal's stride, of the height of its shoulders
SIDES: Final = np.array([[1.0], [-1.0]]) * (0, 1, 0)  # left, right
HIPS, ANKLE, TRUNK = 0.505, 0.045, 0.3  # heights of hips and ankles, and from the hips to the shoulders, in shares of the height
THIGH, SHANK, UPPER_ARM, FOREARM = 0.245, 0.24, 0.17, 0.2  # shares of the height


@dataclass(frozen=True)
class Build:
    """Build and clothes of somebody. girth: width as a multiple of the usual. head: its size as a multiple of an adult's."""

    height_m: float
    girth: float
    head: float
    gown: str  # "coat", "skirt" or ""
    hair: str  # "short", "long", "hat" or "helmet"
    short: bool  # sleeves
    backpack: bool
    umbrella: bool
    pattern: str  # of the jacket: "stripes", "checks", "halves" or ""
    looks: Looks


def build(rng: np.random.Generator, child: bool = False, gown: str = "", hair: str = "", umbrella: bool = False) -> Build:
    """Heights of women and men of DIN 33402-2 (5, 50 and 95 %: 1.535, 1.625, 1.72 and 1.65, 1.75, 1.855 m), of children 0.95 to 1.4 m."""
    woman = rng.random() < 0.5
    height = rng.uniform(0.95, 1.4) if child else rng.normal(1.625 if woman else 1.75, 0.06)
    cloth = np.exp(rng.uniform(np.log(0.04), np.log([0.7, 0.7, 0.4, 0.6])))
    skin = rng.uniform(0.12, 0.55)
    looks: Looks = {
        "head": ("skin", skin),
        "skin": ("skin", skin),
        "hair": ("cloth" if hair == "hat" else "hair", rng.uniform(0.02, 0.4)),
        "helmet": ("car_paint", rng.uniform(0.05, 0.8)),
        **{name: ("cloth", float(value)) for name, value in zip(("jacket", "pattern", "trousers", "umbrella"), cloth, strict=True)},
        "shoes": ("rubber", rng.uniform(0.03, 0.5)),
        "backpack": ("cloth", rng.uniform(0.03, 0.5)),
        "stick": ("metal", 0.3),
    }
    hair = hair or str(rng.choice(["short", "long", "hat"], p=[0.45, 0.35, 0.2]))
    pattern = str(rng.choice(["", "stripes", "checks", "halves"], p=[0.55, 0.15, 0.15, 0.15])) if gown != "coat" else ""
    head = float(1.0 + 0.9 * max(1.5 - height, 0.0))
    return Build(height, rng.uniform(0.85, 1.35), head, gown, hair, rng.random() < 0.25, rng.random() < 0.25, umbrella, pattern, looks)


def figure(who: Build, hips: Floats, lean: float, ankle: Floats, hand: Floats, flat: float | Floats = 0.0) -> list[Piece]:
    """Somebody with the hips at a place `[3]` m, who leans forward by `lean` rad. ankle, hand: `[2, 3]` m, left and right.

    flat: of the feet, rad by which they point down, one or `[2]`.
    """
    h, w = who.height_m, who.girth
    up, fore = xyz(np.sin(lean), 0, np.cos(lean)), xyz(np.cos(lean), 0, -np.sin(lean))
    hip, shoulder = hips + 0.05 * h * SIDES, hips + (TRUNK - 0.018) * h * up + 0.098 * h * w**0.5 * SIDES
    heel = ankle - xyz(0.02 * h, 0, 0.015 * h)
    down = np.broadcast_to(flat, 2)
    toe = heel + 0.135 * h * np.stack([np.cos(down), 0.12 * SIDES[:, 1], -np.sin(down) - 0.04], 1)
    size = 0.055 * h * who.head
    crown = hips + TRUNK * h * up + xyz(0.02 * h, 0, 0.16 * h + 0.03 * h * lean - size)
    chin = crown + size * xyz(0.25, 0, -0.75)
    chest, collar = hips + 0.215 * h * up + 0.035 * h * SIDES, 0.8 * shoulder + 0.2 * shoulder.mean(0)
    capsules = [
        Capsule("trousers", hip[0], hip[1], 0.07 * h * w, 0.07 * h * w),
        Capsule("jacket", hips + 0.07 * h * up, hips + 0.12 * h * up + 0.01 * h * w * fore, 0.078 * h * w, 0.075 * h * w),
        Capsule("jacket", chest[0], chest[1], 0.07 * h * w**0.7, 0.07 * h * w**0.7),
        Capsule("jacket", collar[0], collar[1], 0.043 * h, 0.043 * h),
        Capsule("skin", hips + TRUNK * h * up, chin, 0.033 * h, 0.03 * h),
        Capsule("head", chin, crown, 0.8 * size, size),
        Capsule("head", chin + size * xyz(0.5, 0, 0.1), chin + size * xyz(0.7, 0, 0.25), 0.2 * size, 0.25 * size),
    ]
    hair = "helmet" if who.hair == "helmet" else "hair"
    back, top = crown + size * xyz(-0.2, 0, 0.05), crown + size * xyz(-0.02, 0, 0.16 if hair == "hair" else 0.3)
    capsules.append(Capsule(hair, back, top, 0.95 * size, (0.97 if hair == "hair" else 1.1) * size))
    if who.hair == "long":
        capsules.append(Capsule("hair", back, hips + 0.27 * h * up - 0.05 * h * fore, 0.9 * size, 0.6 * size))
    if who.backpack:
        away = hips + 0.2 * h * up - (0.085 + 0.03 * w) * h * fore
        capsules.append(Capsule("backpack", away - 0.06 * h * up, away + 0.05 * h * up, 0.07 * h, 0.06 * h))
    thighs = "jacket" if who.gown == "coat" else "trousers"  # those of a skirt are covered by it
    shanks, sleeves = "skin" if who.gown == "skirt" else "trousers", "skin" if who.short else "jacket"
    for i in range(2):
        knee = bent(hip[i], ankle[i], THIGH * h, SHANK * h, xyz(1, 0, 0.3))
        elbow = bent(shoulder[i], hand[i], UPPER_ARM * h, FOREARM * h, xyz(-0.4, 0.25 * SIDES[i, 1], -1))
        wrist = hand[i] + 0.2 * (elbow - hand[i])
        capsules += [
            Capsule(thighs, hip[i], knee, 0.058 * h * w**0.7, 0.04 * h),
            Capsule(shanks, knee, ankle[i], 0.042 * h, 0.026 * h),
            Capsule("shoes", heel[i], toe[i], 0.029 * h, 0.022 * h),
            Capsule("jacket", shoulder[i], elbow, 0.035 * h * w**0.5, 0.03 * h),
            Capsule(sleeves, elbow, wrist, 0.031 * h, 0.024 * h),
            Capsule("skin", wrist, hand[i], 0.02 * h, 0.024 * h),
        ]
    pieces = [part for piece in blend(capsules, 0.021 * h, 0.009 * h) for part in _patterned(piece, who, hips)]
    if who.gown:
        z = np.array([0.29, 0.24, 0.08, -0.04, -0.18, -0.2] if who.gown == "coat" else [0.1, 0.06, 0.0, -0.1, -0.24, -0.26])
        across = np.array([0.05, 0.112, 0.11, 0.118, 0.13, 0.13] if who.gown == "coat" else [0.07, 0.082, 0.1, 0.125, 0.15, 0.15]) * w**0.8
        deep = np.array([0.04, 0.085, 0.1, 0.11, 0.16, 0.16])  # as far as a stride reaches
        rings = hips + h * (z[:, None] * np.where(z[:, None] > 0, up, (0, 0, 1)))
        pieces.append(tube(thighs, rings, h * np.stack([across, deep * w**0.5], 1), (0, 1, 0), 20))
    if who.hair == "hat":
        brim = crown + size * xyz(-0.05, 0, 0.25)
        heights, radii = size * np.array([0.0, 0.08, 0.16, 0.75, 0.9]), size * np.array([1.75, 1.8, 1.12, 1.0, 0.8])
        pieces.append(tube("hair", brim + heights[:, None] * (0, 0, 1), np.stack([radii, radii], 1), (0, 1, 0), 16))
    if who.umbrella:
        top, angle = crown + xyz(0.1 * h, 0, 0.2 * h), np.radians([0, 1, 25, 45, 65, 80])[::-1]
        rings = top + np.stack([0 * angle, 0 * angle, 0.28 * np.cos(angle) - 0.1], 1)
        pieces.append(tube("umbrella", rings, 0.52 * np.sin(angle)[:, None] * (1, 1), (0, 1, 0), 16))
        pieces += blend([Capsule("stick", hand[0] - xyz(0, 0, 0.1), top + xyz(0, 0, 0.2), 0.012, 0.008)], 0.02, 0.005)
    return pieces


def _patterned(piece: Piece, who: Build, hips: Floats) -> list[Piece]:
    """A piece, of the jacket with its pattern."""
    if piece.part != "jacket" or not who.pattern:
        return [piece]
    x, y, z = ((piece.vertices[piece.faces].mean(1) - hips) / who.height_m).T
    column, row = np.floor(y / 0.05), np.floor(z / 0.045)
    other = {"stripes": row % 2, "checks": (column + row + np.floor(x / 0.05)) % 2, "halves": z > 0.16}[who.pattern].astype(bool)
    return [replace(piece, faces=piece.faces[~other]), replace(piece, part="pattern", faces=piece.faces[other])]


def _feet(phase: float, starts: Floats, stride: float, lift: float) -> Floats:
    """How far feet are ahead, and lifted, `[n, 2]`, at a phase 0..1 of the gait; on the ground they go back as the body goes ahead."""
    at = (phase + starts) % 1
    ahead = np.where(at < 0.5, stride * (0.25 - at), -stride / 4 + stride / 2 * (0.5 - 0.5 * np.cos(2 * np.pi * (at - 0.5))))
    return np.stack([ahead, lift * np.sin(np.pi * (at - 0.42) / 0.58).clip(0)], 1)


def walker(who: Build, phase: float | None, handle: Floats | None = None, rng: np.random.Generator | None = None) -> list[Piece]:
    """Somebody who walks at a phase 0..1, or stands. handle: place `[3]` m between the hands, which push it."""
    h = who.height_m
    ahead, lift = np.zeros((2, 2)).T if phase is None else _feet(phase, np.array([0.0, 0.5]), STRIDE * h, 0.07 * h).T
    ankle = 0.055 * h * SIDES + np.stack([ahead, 0 * ahead, ANKLE * h + lift], 1)
    hips = xyz(0, 0, (HIPS + (0.02 if phase is None else 0.0)) * h)
    if handle is not None:
        hand = handle + 0.2 * SIDES
    else:
        hand = 0.15 * h * who.girth**0.5 * SIDES + np.stack([-0.85 * ahead + 0.02 * h, 0 * ahead, 0.44 * h + 0.25 * np.abs(ahead)], 1)
        if who.umbrella or (phase is None and rng is not None and rng.random() < 0.4):
            hand[0] = (0.15 * h, 0.08 * h, 0.66 * h)
    flat = np.where(ahead < 0, 8 * lift / h, -1.2 * ahead / h) * (0 if phase is None else 1)
    return figure(who, hips, 0.12 if handle is not None else 0.03, ankle, hand, flat)


def beast(boar: bool, h: float, girth: float, phase: float | None) -> list[Piece]:
    """A boar or a dog whose shoulders are h m high."""
    if boar:
        shapes = [
            ("trunk", (-0.6, 0.64), (0.2, 0.68), 0.27, 0.34),
            ("trunk", (0.1, 0.8), (0.35, 0.78), 0.2, 0.2),
            ("head", (0.5, 0.66), (0.72, 0.56), 0.2, 0.14),
            ("head", (0.72, 0.56), (1.02, 0.42), 0.11, 0.07),
            ("tail", (-0.85, 0.72), (-0.95, 0.45), 0.03, 0.025),
        ]
        ear, ears, leg, width = (0.55, 0.84), (0.5, 0.92), (0.1, 0.055, 0.05), 0.17
    else:
        shapes = [
            ("trunk", (-0.42, 0.76), (0.0, 0.72), 0.15, 0.17),
            ("trunk", (0.0, 0.72), (0.3, 0.7), 0.17, 0.21),
            ("trunk", (0.35, 0.82), (0.55, 1.06), 0.13, 0.11),
            ("head", (0.58, 1.1), (0.66, 1.1), 0.125, 0.11),
            ("head", (0.66, 1.08), (0.9, 1.02), 0.07, 0.055),
            ("tail", (-0.55, 0.85), (-0.9, 1.02), 0.045, 0.025),
        ]
        ear, ears, leg, width = (0.55, 1.2), (0.5, 1.08), (0.075, 0.045, 0.045), 0.11
    ends = [(name, xyz(a[0], 0, a[1]), xyz(b[0], 0, b[1]), ra * girth, rb * girth) for name, a, b, ra, rb in shapes]
    capsules = [Capsule(name, a * h, b * h, ra * h, rb * h) for name, a, b, ra, rb in ends]
    gait = np.zeros((4, 2)) if phase is None else _feet(phase, np.array([0.0, 0.5, 0.75, 0.25]), GAIT, 0.12)
    for k, (ahead, lift) in enumerate(gait):
        fore, side = k < 2, width * (1, -1)[k % 2]
        hip, foot = xyz(0.28 if fore else -0.5, side, 0.58), xyz((0.28 if fore else -0.52) + ahead, side, leg[2] + lift)
        knee = bent(hip, foot, 0.3, 0.3, xyz(1 if fore else -1, 0, 0.2))
        capsules += [
            Capsule("legs", hip * h, knee * h, leg[0] * h * (1 if fore else 1.4), leg[1] * 1.2 * h),
            Capsule("legs", knee * h, foot * h, leg[1] * h, leg[2] * h),
        ]
    for side in (0.09, -0.09):
        capsules.append(Capsule("head", h * xyz(ear[0], side, ear[1]), h * xyz(ears[0], 1.5 * side, ears[1]), 0.05 * h, 0.025 * h))
    pieces = blend(capsules, 0.05 * h, 0.025 * h)
    lowest = min(float(each.vertices[each.faces, 2].min()) for each in pieces)  # of paws, whose tips the corners may miss
    return [replace(each, vertices=each.vertices - (0, 0, lowest)) for each in pieces]
