"""A step of lighting functions as a picture: what the camera sees, the boxes that the tracker reports, and the beam on a wall."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from loop.lighting.lamps import ShiningModule
from loop.lighting.marks import marks, readable
from loop.lighting.result import LightingResult
from loop.lighting.simulation import LightingSimulation
from loop.recording.video import Picture, tone_map
from loop.scenario.plant import shadow_of
from perception.camera import CameraParams, expose, luminance_of
from world.frames import pose_from_degrees
from world.light.emitters import Source, wall_illuminance

TRACKED_RGB, MASKED_RGB, FOUND_RGB, TEXT_RGB = (90, 220, 120), (255, 170, 40), (110, 130, 160), (235, 235, 235)
TARGET_RGB = (80, 170, 255)
CHARACTER = 0.47  # how wide a character is, of a line's height
WALL_DEG = (24.0, 8.0, 6.0)  # to each side, down and up, of the wall that the lamps light
WALL_SHARE = 0.3  # its width, of the picture's
WALL_M = 25.0
BRIGHT = 0.995  # quantile of the first picture's luminance that is shown as white


def white_of(luminance: Tensor | None, camera: CameraParams) -> Tensor:
    """Luminance in cd/m^2 that a run's pictures show as white, from its first one: no more than the camera can measure.

    luminance: `[height, width]`, None where nobody knows it.
    """
    most = luminance_of(expose(torch.tensor(math.inf), camera), camera)
    if luminance is None:
        return most
    bright = torch.from_numpy(np.quantile(luminance.cpu().numpy(), BRIGHT, keepdims=True)).squeeze().clamp(min=1e-6) * 1.5
    return bright.clamp(max=most)


def measured(result: LightingResult, simulation: LightingSimulation) -> Tensor:
    """Luminance `[height, width]` in cd/m^2 that the camera measures, with the noise of its frame; dark where no frame came."""
    camera = simulation.scenario.camera
    return torch.zeros(camera.height_px, camera.width_px) if result.frame is None else luminance_of(result.frame, camera)


def frame_picture(result: LightingResult, simulation: LightingSimulation, white: Tensor) -> Picture:
    """A step as a picture `[H, W, 3]` in the camera's size: boxes in green, orange where a mask keeps them dark, grey of detections, blue
    where symbols that are held shall lie."""
    picture = tone_map(measured(result, simulation), white)
    height, width = picture.shape[:2]
    line = max(height / 28, 9.0)
    for mark in readable(marks(result, simulation), CHARACTER * line, width):
        colour = TARGET_RGB if mark.target else FOUND_RGB if mark.faint else MASKED_RGB if mark.masked else TRACKED_RGB
        for a, b in mark.lines:
            cv2.line(picture, a, b, colour, 1, cv2.LINE_AA)
        at = (mark.at[0], mark.at[1] - 3)
        cv2.putText(picture, mark.text, at, cv2.FONT_HERSHEY_SIMPLEX, line / 38, colour, 1, cv2.LINE_AA)
    wall = wall_light(simulation.modules, result.lights, round(WALL_SHARE * width))
    inset, margin = tone_map(wall, wall.max().clamp(min=1e-6)), max(height // 60, 1)
    rows = slice(margin, margin + min(inset.shape[0], height - 2 * margin))
    picture[rows, width - margin - inset.shape[1] : width - margin] = inset[: rows.stop - rows.start]
    for number, text in enumerate(captions(result, simulation)):
        at = (margin, round(margin + line * (number + 1)))
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, line / 38, TEXT_RGB, 1, cv2.LINE_AA)
    return picture


def captions(result: LightingResult, simulation: LightingSimulation) -> list[str]:
    """What to know of a step, line by line."""
    base = result.plan.base
    lamps = ", ".join(f"{side} {power.flux_lm:.0f} lm" for side, power in result.powers.items())
    lines = [simulation.scenario.name, f"step {result.step}, {result.time_s:.2f} s", simulation.base(base.name), lamps]
    if shadow_of(simulation.scenario.plant) is not None:
        lines[2] = f"asked for in shadow: {lines[2]}"
    if base.bend or base.level or base.roll:
        lines[2] += f", bend {math.degrees(base.bend):+.1f}, level {math.degrees(base.level):+.1f} deg"
    if base.share < 1:
        lines[2] += f" at {100 * base.share:.0f} %"
    if result.look is not None:
        lines[3] += f", {sum(power.watts for power in result.powers.values()):.0f} W"
    if result.dark_lx_max is not None:
        lines.append(f"on what must be dark: {result.dark_lx_max:.3g} lx")
    return lines


def wall_light(modules: Sequence[ShiningModule], lights: Sequence[Tensor], columns: int) -> Tensor:
    """Illuminance `[rows, columns]` in lx of a wall 25 m before the middle of the lamps, all modules together."""
    side, down, up = WALL_DEG
    h, v = torch.linspace(-side, side, columns), torch.linspace(up, -down, round(columns * (up + down) / (2 * side)))
    lit = [
        Source(module.headlight, module.headlight.light_texture(u), module.T_world_module.double().cpu())
        for module, u in zip(modules, lights, strict=True)
        if bool(u.any())
    ]
    height = float(modules[0].T_world_module[2, 3])
    middle = pose_from_degrees((0.0, 0.0, height))
    h_deg, v_deg = torch.meshgrid(h, v, indexing="xy")
    return wall_illuminance(lit, middle, h_deg, v_deg, WALL_M)
