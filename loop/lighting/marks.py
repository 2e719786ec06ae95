"""What is drawn over the camera's picture: the boxes of tracked objects, and with a detector what it found and how sure the car is."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import torch

from controllers.functions.situation import TrackedObject
from loop.lighting.result import LightingResult, Look
from loop.lighting.sight import name_of
from loop.lighting.simulation import LightingSimulation
from world.frames import transform
from world.tracked import Category
from world.view import View

Point = tuple[int, int]
EDGES = [(a, b) for a, b in combinations(range(8), 2) if bin(a ^ b).count("1") == 1]  # corners whose bits are x, y, z


@dataclass(frozen=True)
class Mark:
    """Lines in px of the image, and a text at its place. masked: what must be dark. faint: what a detector found in this frame alone."""

    lines: tuple[tuple[Point, Point], ...]
    masked: bool = False
    faint: bool = False
    text: str = ""
    at: Point = (0, 0)


def marks(result: LightingResult, simulation: LightingSimulation) -> tuple[Mark, ...]:
    """Boxes on the road of what a perfect tracker tells; with a detector those in the image, of tracks after the frame."""
    if result.look is None:
        there = (each for each in result.now.objects if each.since_s <= result.time_s < each.until_s)
        return tuple(Mark(box_lines(each, simulation.camera.view), each.name in result.masked) for each in there)
    assert simulation.sight is not None
    return (*_found(result.look), *_tracked(result.look, simulation.sight.tracker.classes, result.masked))


def readable(marked: Iterable[Mark], character_px: float, width_px: int) -> tuple[Mark, ...]:
    """The same marks with their texts within the image, without those that would cover one before them.

    character_px: how wide one is; it is twice as high.
    """
    kept: list[Mark] = []
    taken: list[tuple[float, float, float]] = []  # left, right, bottom
    for mark in marked:
        long = character_px * len(mark.text)
        left, bottom = max(min(mark.at[0], round(width_px - long)), 0), max(mark.at[1], round(2 * character_px))
        right = left + long
        covers = any(left < other[1] and other[0] < right and abs(bottom - other[2]) < 2 * character_px for other in taken)
        if mark.text and not covers:
            taken.append((left, right, bottom))
        kept.append(replace(mark, text="" if covers else mark.text, at=(left, bottom)))
    return tuple(kept)


def _found(look: Look) -> tuple[Mark, ...]:
    return tuple(Mark(_outline(box), faint=True) for box in look.found.boxes.tolist())


def _tracked(look: Look, classes: tuple[Category, ...], masked: frozenset[str]) -> tuple[Mark, ...]:
    drawn, tracks = [], look.tracks
    for number, box, category, sure in zip(
        tracks.number.tolist(), look.boxes.tolist(), tracks.category.tolist(), tracks.confidence.tolist(), strict=True
    ):
        text = f"{classes[category]} {number}: {sure[category]:.2f}"
        drawn.append(Mark(_outline(box), name_of(number) in masked, text=text, at=(round(box[0]), round(box[1]))))
    return tuple(drawn)


def _outline(box: list[float]) -> tuple[tuple[Point, Point], ...]:
    left, top, right, bottom = (round(each) for each in box)
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    return tuple((corners[k], corners[(k + 1) % 4]) for k in range(4))


def box_lines(each: TrackedObject, view: View) -> tuple[tuple[Point, Point], ...]:
    """Edges of a box in a view; none where it reaches behind the eye."""
    length, width, height = each.size_m
    bits = torch.tensor([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)], dtype=torch.float64).T
    corners = torch.tensor([[length], [width], [height]]) * (bits - torch.tensor([[0.5], [0.5], [0.0]]))
    uv, depth = view.project(transform(each.T_world_object.double(), corners.double()))
    if (depth <= 0).any():
        return ()
    points = [(round(u), round(v)) for u, v in uv.T.tolist()]
    return tuple((points[a], points[b]) for a, b in EDGES)
