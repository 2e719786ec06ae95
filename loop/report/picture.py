"""A step as a picture: the camera's image with boxes and other marks, and the beam on a wall."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Literal

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.zone import ZoneParams
from luxloop.controllers.situation import TrackedObject
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.recording.functions_summary import plain_name
from luxloop.loop.recording.video import Picture, tone_map
from luxloop.loop.scenario.model import HeadlightParams
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.columns import loss_name
from luxloop.loop.simulation.detection import name_of
from luxloop.loop.simulation.evaluator import Evaluation, FrameDetections, SymbolStep
from luxloop.loop.simulation.lamps import ShiningModule, T_world_reference, under
from luxloop.loop.simulation.road_metrics import SymbolEvaluator
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import expose, luminance_of
from luxloop.world.frames import View, transform
from luxloop.world.light.emitters import Source, wall_illuminance
from luxloop.world.traffic.tracked import Category

Point = tuple[int, int]
LINES = 3  # heights that a text may take, one line above the other
Lines = tuple[tuple[Point, Point], ...]
EDGES = [(a, b) for a, b in combinations(range(8), 2) if (a ^ b) in (1, 2, 4)]  # of a box, corners numbered by the bits x, y, z
RING = [(0, 1), (1, 2), (2, 3), (3, 0)]


@dataclass(frozen=True)
class Mark:
    """Lines and a text in px of the camera's image.

    kind: `masked` an object that must be dark, `found` a detection in this frame alone, `target` a symbol's target on a flat road.
    """

    lines: Lines
    kind: Literal["tracked", "masked", "found", "target", "zone"] = "tracked"
    text: str = ""
    at: Point = (0, 0)


def marks(result: Evaluation, simulation: Simulation) -> tuple[Mark, ...]:
    """Marks of zones, of targets of symbols under control, and of objects: boxes on the road, or with a detector boxes in the image."""
    view = result.sense.view
    functions = simulation.scenario.functions.items()
    zones = tuple(_zone(name, each, view) for name, each in functions if isinstance(each, ZoneParams))
    held = (simulation.controlled[name].function.held for name in result.held if name in simulation.controlled)
    zones += tuple(Mark(_target(each, view), "target") for each in held)
    if result.detections is None:
        there = (each for each in result.now.objects if each.since_s <= result.time_s < each.until_s)
        return (*zones, *(Mark(_around(each, view), _kind(each.name, result.masked)) for each in there))
    assert simulation.pipeline is not None
    found = (Mark(_ring(box), "found") for box in result.detections.found.boxes.tolist())
    return (*zones, *found, *_tracks(result.detections, simulation.pipeline.classes, result.masked))


def readable(marked: Iterable[Mark], character_px: float, width_px: int) -> tuple[Mark, ...]:
    """Marks with their texts moved into the image and up to two lines higher, so that none covers an earlier one, or else without texts.

    character_px: width of a character; its height is twice as large.
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
    if not lines:
        return Mark((), "zone")
    us, vs = zip(*chain.from_iterable(lines), strict=True)
    return Mark(lines, "zone", plain_name(name), (min(us), min(vs)))


def _target(symbol: SymbolParams, view: View) -> Lines:
    centre = torch.tensor([[symbol.x_m], [symbol.y_m], [0.0]], dtype=torch.float64)
    return _seen(rectangle(symbol.length_m, symbol.width_m) + centre, RING, view)


def rectangle(length_m: float, width_m: float) -> Tensor:
    """Corners `[3, 4]` m of a rectangle on the plane z = 0 around the origin, in the order of its border."""
    x, y = length_m / 2, width_m / 2
    return torch.tensor([[x, x, -x, -x], [y, -y, -y, y], [0.0] * 4], dtype=torch.float64)


def _tracks(look: FrameDetections, classes: tuple[Category, ...], masked: frozenset[str]) -> tuple[Mark, ...]:
    tracks = look.tracks
    values = (each.tolist() for each in (tracks.number, tracks.boxes, tracks.category, tracks.confidence))
    return tuple(
        Mark(
            _ring(box),
            _kind(name_of(number), masked),
            f"{classes[category]} {number}: {confidences[category]:.2f}",
            (round(box[0]), round(box[1])),
        )
        for number, box, category, confidences in zip(*values, strict=True)
    )


def _kind(name: str, masked: frozenset[str]) -> Literal["masked", "tracked"]:
    return "masked" if name in masked else "tracked"


def _ring(box: list[float]) -> Lines:
    left, top, right, bottom = map(round, box)
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    return tuple((corners[a], corners[b]) for a, b in RING)


def _around(each: TrackedObject, view: View) -> Lines:
    length, width, height = each.size_m
    high = torch.tensor([length / 2, width / 2, height], dtype=torch.float64)
    return _edges(each.T_world_object.double(), high * torch.tensor([-1, -1, 0]), high, view)


def _edges(T_world_box: Tensor, low: Tensor, high: Tensor, view: View) -> Lines:
    """Edges of a box in a view. low, high: `[3]` m, opposite corners in the box's frame."""
    bits = torch.cartesian_prod(*3 * [torch.arange(2)]).T
    return _seen(transform(T_world_box, low[:, None] + (high - low)[:, None] * bits), EDGES, view)


def _seen(corners: Tensor, edges: Sequence[tuple[int, int]], view: View) -> Lines:
    """Edges between corners `[3, n]` m in a view; none if a corner lies behind the eye."""
    uv, depth = view.project(corners)
    points = [(round(u), round(v)) for u, v in uv.T.tolist()]
    return () if (depth <= 0).any() else tuple((points[a], points[b]) for a, b in edges)


TEXT_RGB, TARGET_RGB, SEEN_RGB, LOST_RGB = (235, 235, 235), (80, 170, 255), (255, 170, 40), (255, 90, 80)
MARKS_RGB = {"tracked": (90, 220, 120), "zone": (90, 220, 120), "masked": SEEN_RGB, "found": (110, 130, 160), "target": TARGET_RGB}
WHITE = 2.0  # least luminance that is shown as white, as a multiple of the median of symbols under control
CLOSE = 1.4  # half the extent of the inset from above, in symbol lengths and widths
ABOVE = 0.44  # height of the inset from above, relative to the picture's
CHARACTER = 0.47  # width of a character, relative to a line's height
WALL_DEG = (24.0, 8.0, 6.0)  # extent of the wall that the lamps light: to each side, down and up
WALL_SHARE = 0.3  # width of the wall's inset, relative to the picture's
WALL_M = 25.0
BRIGHT = 0.995  # quantile of the first picture's luminance that is shown as white


def white_of(result: Evaluation, simulation: Simulation) -> Tensor:
    """Luminance in cd/m^2 that a run's pictures show as white, by its first step; at most the largest that the camera can measure."""
    camera = simulation.scenario.camera
    most = luminance_of(expose(torch.tensor(math.inf), camera), camera)
    symbols = [WHITE * float(each.brightness) for each in simulation.controlled.values()]
    if result.luminance is None:
        return torch.tensor(max(symbols)).to(most).clamp(max=most) if symbols else most
    bright = torch.from_numpy(np.quantile(result.luminance.cpu().numpy(), BRIGHT, keepdims=True)).squeeze().clamp(min=1e-6) * 1.5
    return bright.clamp(min=max(symbols, default=0.0)).clamp(max=most)


def camera_luminance(result: Evaluation, simulation: Simulation) -> Tensor:
    """Luminance `[height, width]` in cd/m^2 that the camera measures, with the noise of its frame; dark without a frame."""
    camera = simulation.scenario.camera
    return torch.zeros(camera.height_px, camera.width_px) if result.frame is None else luminance_of(result.frame, camera)


def frame_picture(result: Evaluation, simulation: Simulation, white: Tensor) -> Picture:
    """A step as a picture `[H, W, 3]` of the camera's size.

    Boxes of objects are green, or orange where a mask keeps them dark, detections grey; symbols under control have their extracted outlines
    in orange and their targets in blue. Insets: the first symbol from above, without noise, on the upper left; the beam on the upper right.
    """
    picture = tone_map(camera_luminance(result, simulation), white)
    height, width = picture.shape[:2]
    line, margin = line_px(height), max(height // 60, 1)
    draw_marks(picture, marks(result, simulation))
    for held in result.held.values():
        _outline(picture, held.measurement)
    for name in list(result.held)[:1]:
        if (evaluator := simulation.controlled[name].evaluator) is not None:
            _paste(picture, _from_above(result, evaluator, white, round(ABOVE * height)), margin, left=True)
    modules, mount = under(simulation.modules, result.now.commands), simulation.scenario.headlight
    wall = wall_light(modules, result.lights, mount, round(WALL_SHARE * width))
    _paste(picture, tone_map(wall, wall.max().clamp(min=1e-6)), margin, left=False)
    lines = captions(result, simulation)
    for number, (text, colour) in enumerate(lines):
        at = (margin, round(height - margin - line * (len(lines) - 1 - number)))
        for wide, shade in ((3, (0, 0, 0)), (1, colour)):  # outlined, as it may lie on lit road
            cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, line / 38, shade, wide, cv2.LINE_AA)
    return picture


def line_px(height: int) -> float:
    """Height in px of a line of text in a picture of a height."""
    return max(height / 28, 9.0)


def draw_marks(picture: Picture, marked: Iterable[Mark]) -> None:
    """Draw marks with legible texts into a picture `[H, W, 3]`."""
    line = line_px(len(picture))
    for mark in readable(marked, CHARACTER * line, picture.shape[1]):
        colour = MARKS_RGB[mark.kind]
        for a, b in mark.lines:
            cv2.line(picture, a, b, colour, 1, cv2.LINE_AA)
        at = (mark.at[0], mark.at[1] - 3)
        cv2.putText(picture, mark.text, at, cv2.FONT_HERSHEY_SIMPLEX, line / 38, colour, 1, cv2.LINE_AA)


def _outline(picture: Picture, seen: Measurement) -> None:
    """Draw the outline of an extracted symbol."""
    mask = (seen.symbol > 0.5).to(torch.uint8).cpu().numpy()
    if mask.size:
        offset = (seen.crop.u_start, seen.crop.v_start)
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE, offset=offset)
        cv2.drawContours(picture, contours, -1, SEEN_RGB, 1)


def _from_above(result: Evaluation, evaluator: SymbolEvaluator, white: Tensor, height: int) -> Picture:
    """The road around a symbol's target from above, far end on top, with the outline of the target. height: px."""
    symbol, axes = evaluator.symbol, evaluator.plane.axes
    light = evaluator.from_above(result.exposures[0].lights, result.off.lights, result.time_s, result.now.commands)
    rows = (axes.v + symbol.x_m).abs() <= CLOSE * symbol.length_m
    cols = (axes.u + symbol.y_m).abs() <= CLOSE * symbol.width_m
    flat = tone_map(light[rows.to(light.device)][:, cols.to(light.device)], white)
    picture = cv2.resize(flat, (round(flat.shape[1] * height / flat.shape[0]), height), interpolation=cv2.INTER_AREA)
    px_per_m = height / (float(axes.v[1] - axes.v[0]) * int(rows.sum()))
    centre = (-symbol.y_m - float(axes.u[cols][0]), -symbol.x_m - float(axes.v[rows][0]))
    half = (symbol.width_m / 2, symbol.length_m / 2)
    low, high = ([round(px_per_m * (c + sign * h)) for c, h in zip(centre, half, strict=True)] for sign in (-1, 1))
    cv2.rectangle(picture, low, high, TARGET_RGB, 1)
    return picture


def _paste(picture: Picture, inset: Picture, margin: int, left: bool) -> None:
    """Draw a framed inset into the upper left or right corner, cut to the picture."""
    inset = inset[: picture.shape[0] - 2 * margin, : picture.shape[1] - 2 * margin]
    height, width = inset.shape[:2]
    u = margin if left else picture.shape[1] - margin - width
    picture[margin : margin + height, u : u + width] = inset
    cv2.rectangle(picture, (u - 1, margin - 1), (u + width, margin + height), TEXT_RGB, 1)


def captions(result: Evaluation, simulation: Simulation) -> list[tuple[str, tuple[int, int, int]]]:
    """Lines of text on a step, each with its colour."""
    base = result.plan.base
    lamps = ", ".join(f"{side} {power.flux_lm:.0f} lm" for side, power in result.powers.items())
    lines = [simulation.scenario.name, f"step {result.step}, {result.time_s:.2f} s", simulation.base(base.name), lamps]
    if shadow_of(simulation.scenario.plant) is not None:
        lines[2] = f"commanded in shadow: {lines[2]}"
    if base.bend or base.level or base.roll:
        lines[2] += f", bend {math.degrees(base.bend):+.1f}, level {math.degrees(base.level):+.1f} deg"
    lines[2] += base.shares
    if result.detections is not None:
        lines[3] += f", {sum(power.watts for power in result.powers.values()):.0f} W"
    if result.dark_lx_max is not None:
        lines.append(f"on masked objects: {result.dark_lx_max:.3g} lx")
    return [(line, TEXT_RGB) for line in lines] + [_symbol_caption(name, simulation, held) for name, held in result.held.items()]


def _symbol_caption(name: str, simulation: Simulation, held: SymbolStep) -> tuple[str, tuple[int, int, int]]:
    loss, lies = loss_name(int(held.measurement.code)), "not evaluated"
    if held.metrics is not None:
        x, y = held.metrics.centroid_percent.tolist()
        lies = f"centroid error {x:+.1f} %, {y:+.1f} %; IoU {float(held.metrics.iou):.2f}"
    seen = f"lost: {loss.replace('_', ' ')}" if loss else "seen"
    return f"{name}, {simulation.controlled[name].params.name}: {seen}; {lies}", LOST_RGB if loss else SEEN_RGB


def wall_light(modules: Sequence[ShiningModule], lights: Sequence[Tensor], mount: HeadlightParams, columns: int) -> Tensor:
    """Illuminance `[rows, columns]` in lx of all modules on a wall 25 m ahead, over angles from `T_world_reference`."""
    side, down, up = WALL_DEG
    h, v = torch.linspace(-side, side, columns), torch.linspace(up, -down, round(columns * (up + down) / (2 * side)))
    lit = [
        Source(module.headlight, module.headlight.light_texture(module.intensity * u), module.T_world_module.double().cpu())
        for module, u in zip(modules, lights, strict=True)
        if bool(u.any())
    ]
    H, V = torch.meshgrid(h, v, indexing="xy")
    return wall_illuminance(lit, T_world_reference({module.side for module in modules}, mount), H, V, WALL_M)
