"""Light for scenes rendered in the dark: full light (even or beam-like), or object-based light."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from luxloop.loop.studies.training.scenes import CLASSES, DarkScene, SceneObject
from luxloop.world.traffic.tracked import Category

WELL_LIT_LX = 5.0  # least illuminance on objects in training
FULL_LX = (WELL_LIT_LX, 150.0)  # full light; near surfaces often saturate the camera
DARK_LX = (0.02, 1.0)  # object-based light around objects
OBJECT_LX = (WELL_LIT_LX, 40.0)  # object-based light on objects
TOP_LX = (0.2, 1.0)  # object-based light on heads and windscreens
NOBODY = SceneObject(-1, 0, (0.0, 0.0, 1.0, 1.0), 1.0, 1.0)
# dark share of a box from its top in glare-free light: the head, or the part above the bumper, with blur and tracking errors
TOP: Mapping[Category, tuple[float, float]] = {"pedestrian": (0.12, 0.45), "cyclist": (0.12, 0.45), "car": (0.35, 0.75)}


def luminance(scene: DarkScene, lx: Tensor | float) -> Tensor:
    """Luminance `[height, width]` in cd/m^2 if surfaces facing the headlamps get `lx` from them."""
    return scene.lamps * lx + scene.own + scene.sky * scene.ambient_lx


def full_light(scene: DarkScene, rng: np.random.Generator) -> Tensor:
    """Illuminance `[height, width]` in lx of surfaces facing the lamps, even or of a beam."""
    return (_uniform if rng.random() < 0.6 else _beam)(scene, _between(rng, FULL_LX), rng)


def object_light(scene: DarkScene, rng: np.random.Generator, wide: bool = False) -> Tensor:
    """Illuminance `[height, width]` in lx of object-based light on most objects, most with dark tops, and on places without objects.

    wide: on clutter, too, and with dark tops on some of these places.
    """
    light = (_uniform if rng.random() < 0.5 else _beam)(scene, _between(rng, DARK_LX), rng)
    lit = [each for each in scene.objects if rng.random() < 0.9] if rng.random() < 0.85 else []
    for box in _places(scene, rng, wide):
        light = light + _between(rng, OBJECT_LX) * _patch(scene, box, float(rng.uniform(0.5, 5)))
        if wide and rng.random() < 0.5:
            top = replace(NOBODY, box=box)
            light = darken(scene, light, top, float(rng.uniform(0.12, 0.7)), float(rng.uniform(*TOP_LX)), float(rng.uniform(0.7, 2)))
    for each in lit:
        around = _wider(each, float(rng.uniform(-0.03, 0.25)), float(rng.uniform(-0.03, 0.2)))
        light = torch.maximum(light, _between(rng, OBJECT_LX) * _patch(scene, around, float(rng.uniform(0.5, 5))))
    for each in lit:
        share = TOP.get(CLASSES[each.label])
        if share and rng.random() < 0.9:
            light = darken(scene, light, each, float(rng.uniform(*share)), float(rng.uniform(*TOP_LX)), float(rng.uniform(0.7, 2)))
    return light


def _places(scene: DarkScene, rng: np.random.Generator, wide: bool) -> Iterator[tuple[float, float, float, float]]:
    """Boxes anywhere and, if wide, around half of what is no object of the classes, nor the road."""
    height, width = scene.shape
    for _ in range(int(rng.integers(4))):
        w, h = float(rng.uniform(10, 0.4 * width)), float(rng.uniform(10, 0.5 * height))
        u, v = float(rng.uniform(-w / 2, width)), float(rng.uniform(-h / 2, height))
        yield u, v, u + w, v + h
    known = {each.object_id for each in scene.objects}
    for object_id in scene.pixels[1].unique().tolist() if wide else ():
        if object_id not in known and rng.random() < 0.5:
            here = scene.object_id == object_id
            rows, columns = (torch.nonzero(here.any(axis))[:, 0].tolist() for axis in (1, 0))
            yield float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)


def darken(scene: DarkScene, light: Tensor, each: SceneObject, share: float, lx: float, soft: float) -> Tensor:
    """Light with a darkened top of an object: a share of its box from the top, and as much above, gets `lx`. soft: scale of the edge in
    px.
    """
    u0, v0, u1, _ = _wider(each, 0.15, share)
    dark = _patch(scene, (u0, v0, u1, each.box[1] + share * each.height), soft)
    return light + dark * (lx - light)


def lit_alone(scene: DarkScene, lx: float, around_lx: float, top: Mapping[Category, float], top_lx: float, soft: float) -> Tensor:
    """Illuminance in lx: `lx` on all objects, `top_lx` on shares of their boxes from the top by class, `around_lx` elsewhere."""
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
    """Even light with a horizontal gradient."""
    slope = torch.linspace(-1, 1, scene.shape[1]) * float(rng.normal(0, 0.3))
    return (lx * slope.exp()).expand(scene.shape)


def _beam(scene: DarkScene, lx: float, rng: np.random.Generator) -> Tensor:
    """Cone of light that falls with the square of the distance, with or without a cut-off; lx: at 25 m."""
    height, width = scene.shape
    column, row = torch.arange(width) - float(rng.uniform(0, width)), torch.arange(height) - float(rng.uniform(0, 0.6 * height))
    across = (-0.5 * (column / float(rng.uniform(0.3, 1.5) * width)) ** 2).exp()
    above = float(rng.choice([0.03, 1.0])) if rng.random() < 0.7 else 0.3
    down = above + (1 - above) * torch.sigmoid(row / float(rng.uniform(2, 10)))
    return lx * (down[:, None] * across) * (25 / scene.distance.clamp(3, 200)) ** 2


def _wider(each: SceneObject, across: float, down: float) -> tuple[float, float, float, float]:
    """An object's box, enlarged on both sides by shares of its width and height."""
    u0, v0, u1, v1 = each.box
    dx, dy = across * (u1 - u0), down * (v1 - v0)
    return u0 - dx, v0 - dy, u1 + dx, v1 + dy


def _patch(scene: DarkScene, box: tuple[float, float, float, float], soft: float) -> Tensor:
    """Mask of a box with soft edges."""
    (rows, columns), (u0, v0, u1, v1) = scene.shape, box
    u, v = torch.arange(columns) + 0.5, torch.arange(rows) + 0.5
    across = torch.sigmoid((u - u0) / soft) * torch.sigmoid((u1 - u) / soft)
    down = torch.sigmoid((v - v0) / soft) * torch.sigmoid((v1 - v) / soft)
    return down[:, None] * across


def all_light(scene: DarkScene, bright: Tensor) -> Tensor:
    """Headlamp illuminance `[height, width]` in lx that gives a luminance in cd/m^2."""
    return torch.where(scene.lamps > 0, bright / scene.lamps.clamp(min=1e-6), 0)


def lit_share(scene: DarkScene, light: Tensor, lx: float) -> Tensor:
    """Share `[n]` of each object's visible part with at least `lx`."""
    at, ids = scene.pixels
    its = torch.tensor([each.object_id for each in scene.objects]).long()
    rows = 1 + max(its.tolist(), default=0)
    lit, pixels = torch.bincount(ids, light.flatten()[at] >= lx, rows), torch.bincount(ids, minlength=rows)
    return lit[its] / pixels[its].clamp(min=1)
