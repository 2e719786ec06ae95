"""What is drawn over the camera's picture: the boxes of tracked objects, and with a detector what it found and how sure the car is."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import torch
from torch import Tensor

from luxloop.controllers.functions.zone import ZoneParams
from luxloop.controllers.situation import TrackedObject
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.loop.recording.functions_summary import spoken
from luxloop.loop.simulation.detection import name_of
from luxloop.loop.simulation.evaluator import Evaluation, FrameDetections
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.frames import View, transform
from luxloop.world.traffic.tracked import Category

Point = tuple[int, int]
LINES = 3  # at which a text may stand, each above the other
Lines = tuple[tuple[Point, Point], ...]
EDGES = [(a, b) for a, b in combinations(range(8), 2) if bin(a ^ b).count("1") == 1]  # corners whose bits are x, y, z
RING = [(0, 1), (1, 2), (2, 3), (3, 0)]


@dataclass(frozen=True)
class Mark:
    """Lines in px of the image, and a text at its place.

    kind: `masked` is what must be dark, `found` what a detector found in this frame alone, `target` where a symbol shall lie on flat road.
    """

    lines: Lines
    kind: Literal["tracked", "masked", "found", "target", "zone"] = "tracked"
    text: str = ""
    at: Point = (0, 0)


def marks(result: Evaluation, simulation: Simulation) -> tuple[Mark, ...]:
    """Zones, targets of symbols that are held, and boxes: on the road of what a perfect tracker tells, or in the image of tracks."""
    view = result.sense.view
    functions = simulation.scenario.functions.items()
    zones = tuple(_zone(name, each, view) for name, each in functions if isinstance(each, ZoneParams))
    held = (simulation.controlled[name].function.held for name in result.held if name in simulation.controlled)
    zones += tuple(Mark(_target(each, view), "target") for each in held)
    if result.look is None:
        there = (each for each in result.now.objects if each.since_s <= result.time_s < each.until_s)
        return (*zones, *(Mark(_around(each, view), _kind(each.name, result.masked)) for each in there))
    assert simulation.pipeline is not None
    found = (Mark(_outline(box), "found") for box in result.look.found.boxes.tolist())
    return (*zones, *found, *_tracks(result.look, simulation.pipeline.classes, result.masked))


def readable(marked: Iterable[Mark], character_px: float, width_px: int) -> tuple[Mark, ...]:
    """The same marks with their texts within the image, up to two lines higher where they would cover one before them, or else without.

    character_px: how wide one is; it is twice as high.
    """
    kept: list[Mark] = []
    taken: list[tuple[float, float, float]] = []  # left, right, bottom
    for mark in marked:
        long = character_px * len(mark.text)
        left, high = max(min(mark.at[0], round(width_px - long)), 0), math.ceil(2 * character_px)
        beside = [other for *sides, other in taken if left < sides[1] and sides[0] < left + long]
        places = (max(mark.at[1] - higher * high, high) for higher in range(LINES))
        bottom = next((place for place in places if all(abs(place - other) >= high for other in beside)), None)
        if mark.text and bottom is not None:
            taken.append((left, left + long, bottom))
        kept.append(replace(mark, text="") if bottom is None else replace(mark, at=(left, bottom)))
    return tuple(kept)


def _zone(name: str, zone: ZoneParams, view: View) -> Mark:
    lines = _edges(*zone.box, view)
    points = [point for line in lines for point in line]
    at = (min(u for u, _ in points), min(v for _, v in points)) if points else (0, 0)
    return Mark(lines, "zone", text=spoken(name) if points else "", at=at)


def _target(symbol: SymbolParams, view: View) -> Lines:
    x, y = symbol.length_m / 2, symbol.width_m / 2
    corners = torch.tensor([[x, x, -x, -x], [y, -y, -y, y], [0.0] * 4], dtype=torch.float64)
    return _seen(corners + torch.tensor([[symbol.x_m], [symbol.y_m], [0.0]], dtype=torch.float64), RING, view)


def _tracks(look: FrameDetections, classes: tuple[Category, ...], masked: frozenset[str]) -> tuple[Mark, ...]:
    drawn, tracks = [], look.tracks
    for number, box, category, sure in zip(
        tracks.number.tolist(), tracks.boxes.tolist(), tracks.category.tolist(), tracks.confidence.tolist(), strict=True
    ):
        text = f"{classes[category]} {number}: {sure[category]:.2f}"
        drawn.append(Mark(_outline(box), _kind(name_of(number), masked), text=text, at=(round(box[0]), round(box[1]))))
    return tuple(drawn)


def _kind(name: str, masked: frozenset[str]) -> Literal["masked", "tracked"]:
    return "masked" if name in masked else "tracked"


def _outline(box: list[float]) -> Lines:
    left, top, right, bottom = map(round, box)
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    return tuple((corners[a], corners[b]) for a, b in RING)


def _around(each: TrackedObject, view: View) -> Lines:
    length, width, height = each.size_m
    high = torch.tensor([length / 2, width / 2, height], dtype=torch.float64)
    return _edges(each.T_world_object.double(), high * torch.tensor([-1, -1, 0]), high, view)


def _edges(T_world_box: Tensor, low: Tensor, high: Tensor, view: View) -> Lines:
    """Of a box in a view, low and high `[3]` m opposite corners in its frame."""
    bits = torch.tensor([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)], dtype=torch.float64).T
    return _seen(transform(T_world_box, low[:, None] + (high - low)[:, None] * bits), EDGES, view)


def _seen(corners: Tensor, edges: Sequence[tuple[int, int]], view: View) -> Lines:
    """Edges between corners `[3, n]` m in a view; none where one lies behind the eye."""
    uv, depth = view.project(corners)
    points = [(round(u), round(v)) for u, v in uv.T.tolist()]
    return () if (depth <= 0).any() else tuple((points[a], points[b]) for a, b in edges)
