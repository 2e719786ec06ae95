"""Light for scenes that are rendered in the dark: full light (even or like a beam), or object-based light in darkness."""

from collections.abc import Mapping
from typing import Final

import numpy as np
import torch
from torch import Tensor

from luxloop.loop.studies.training.scenes import CLASSES, DarkScene, SceneObject
from luxloop.world.traffic.tracked import Category

WELL_LIT_LX = 5.0  # least illuminance on objects in training
FULL_LX = (WELL_LIT_LX, 150.0)  # of full light, in which near surfaces often saturate the camera
DARK_LX = (0.02, 1.0)  # around objects that are lit alone
OBJECT_LX = (WELL_LIT_LX, 40.0)  # on these
TOP_LX = (0.2, 1.0)  # on their heads and windscreens
# share of a box from its top that glare-free light leaves dark: the head, or what is above the bumper, with the lamps' blur and a
# tracker's errors
TOP: Final[Mapping[Category, tuple[float, float]]] = {"pedestrian": (0.12, 0.45), "cyclist": (0.12, 0.45), "car": (0.35, 0.75)}


def luminance(scene: DarkScene, lx: Tensor | float) -> Tensor:
    """`[height, width]` in cd/m^2 where surfaces that face the headlamps get `lx` from them."""
    return scene.lamps * lx + scene.own + scene.sky * scene.ambient_lx


def full_light(scene: DarkScene, rng: np.random.Generator) -> Tensor:
    """Illuminance `[height, width]` in lx of surfaces that face the lamps, as by day or as a beam gives it."""
    return (_uniform if rng.random() < 0.6 else _beam)(scene, _between(rng, FULL_LX), rng)


def object_light(scene: DarkScene, rng: np.random.Generator) -> Tensor:
    """Illuminance `[height, width]` in lx of object-based light on most objects, most with dark tops, and on places without objects."""
    light, (height, width) = (_uniform if rng.random() < 0.5 else _beam)(scene, _between(rng, DARK_LX), rng), scene.shape
    lit = [each for each in scene.objects if rng.random() < 0.9] if rng.random() < 0.85 else []
    for _ in range(int(rng.integers(4))):
        w, h = float(rng.uniform(10, 0.4 * width)), float(rng.uniform(10, 0.5 * height))
        u, v = float(rng.uniform(-w / 2, width)), float(rng.uniform(-h / 2, height))
        light = light + _between(rng, OBJECT_LX) * _patch(scene, (u, v, u + w, v + h), float(rng.uniform(0.5, 5)))
    for each in lit:
        around = _wider(each, float(rng.uniform(-0.03, 0.25)), float(rng.uniform(-0.03, 0.2)))
        light = torch.maximum(light, _between(rng, OBJECT_LX) * _patch(scene, around, float(rng.uniform(0.5, 5))))
    for each in lit:
        share = TOP.get(CLASSES[each.label])
        if share and rng.random() < 0.9:
            light = darken(scene, light, each, float(rng.uniform(*share)), float(rng.uniform(*TOP_LX)), float(rng.uniform(0.7, 2)))
    return light


def darken(scene: DarkScene, light: Tensor, each: SceneObject, share: float, lx: float, soft: float) -> Tensor:
    """Light of which a share of an object's box, from the top, and as much above it, gets only so many lx; soft: px of the edge's scale."""
    u0, v0, u1, _ = _wider(each, 0.15, share)
    dark = _patch(scene, (u0, v0, u1, each.box[1] + share * each.height), soft)
    return light + dark * (lx - light)


def lit_alone(scene: DarkScene, lx: float, around_lx: float, top: Mapping[Category, float], top_lx: float, soft: float) -> Tensor:
    """Light in lx on all objects amid `around_lx`, with `top_lx` on shares of their boxes from the top, by class."""
    light = torch.full(scene.shape, around_lx)
    for each in scene.objects:
        light = torch.maximum(light, lx * _patch(scene, _wider(each, 0.1, 0.05), soft))
    for each in scene.objects:
        if share := top.get(CLASSES[each.label]):
            light = darken(scene, light, each, share, top_lx, soft)
    return light


def _between(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(limits))))


def _uniform(scene: DarkScene, lx: float, rng: np.random.Generator) -> Tensor:
    """Even light with a gradient from side to side."""
    slope = torch.linspace(-1, 1, scene.shape[1]) * float(rng.normal(0, 0.3))
    return (lx * slope.exp()).expand(scene.shape)


def _beam(scene: DarkScene, lx: float, rng: np.random.Generator) -> Tensor:
    """A cone whose light falls with the square of the distance, with a cut-off or without; lx: at 25 m."""
    height, width = scene.shape
    column, row = torch.arange(width) - float(rng.uniform(0, width)), torch.arange(height) - float(rng.uniform(0, 0.6 * height))
    across = (-0.5 * (column / float(rng.uniform(0.3, 1.5) * width)) ** 2).exp()
    above = float(rng.choice([0.03, 1.0])) if rng.random() < 0.7 else 0.3
    down = above + (1 - above) * torch.sigmoid(row / float(rng.uniform(2, 10)))
    return lx * (down[:, None] * across) * (25 / scene.distance.clamp(3, 200)) ** 2


def _wider(each: SceneObject, across: float, down: float) -> tuple[float, float, float, float]:
    """Its box and so large a share of its width and height to both sides."""
    u0, v0, u1, v1 = each.box
    dx, dy = across * (u1 - u0), down * (v1 - v0)
    return u0 - dx, v0 - dy, u1 + dx, v1 + dy


def _patch(scene: DarkScene, box: tuple[float, float, float, float], soft: float) -> Tensor:
    """A rectangle of 1 with soft edges amid 0."""
    (rows, columns), (u0, v0, u1, v1) = scene.shape, box
    u, v = torch.arange(columns) + 0.5, torch.arange(rows) + 0.5
    across = torch.sigmoid((u - u0) / soft) * torch.sigmoid((u1 - u) / soft)
    down = torch.sigmoid((v - v0) / soft) * torch.sigmoid((v1 - v) / soft)
    return down[:, None] * across


def all_light(scene: DarkScene, lx: Tensor) -> Tensor:
    """`[height, width]` lx from the headlamps that would make the scene as bright as `lx` from them and all other light do together."""
    return torch.where(scene.lamps > 0, luminance(scene, lx) / scene.lamps.clamp(min=1e-6), 0)


def lit_share(scene: DarkScene, light: Tensor, lx: float) -> Tensor:
    """Which share of each object of the scene gets so much light or more, `[n]`, of what is seen of it."""
    ids, its = scene.object_id.flatten() + 1, torch.tensor([each.object_id + 1 for each in scene.objects]).long()
    rows = 1 + max(its.tolist(), default=0)
    lit, pixels = torch.bincount(ids, (light >= lx).flatten().float(), rows), torch.bincount(ids, minlength=rows)
    return lit[its] / pixels[its].clamp(min=1)
