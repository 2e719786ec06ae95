"""Carrier sense by light: cars agree by their cameras alone on who draws on a stretch of road.

Carrier sense with collision detection and truncated exponential back-off, as Ethernet's (IEEE 802.3), with light for the carrier. A car
listens in frames without its own light on the stretch. While it draws, it pauses for one of each `pause_every` frames, chosen by lot: then
it hears others, and they hear that it draws, since only light that comes and goes is a carrier. Low beams, street lamps and paint are none.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.functions.zone import box_region
from luxloop.controllers.situation import CameraImage, Situation
from luxloop.world.caches import Part
from luxloop.world.frames import View, transform
from luxloop.world.params import Params

Turn = Literal["idle", "waits", "draws"]
QUIET: Final = 3  # frames without a carrier after which a stretch is free: pauses of a car last two frames at most
WINDOW: Final = 4  # frames, of the first back-off; doubled with each further collision
DOUBLINGS: Final = 4  # at most
REST: Final = 16  # free frames after the own turn, so that a waiting car comes first
SURROUNDINGS: Final = 2.0  # length and width of the stretch with its surroundings, relative to the stretch


@dataclass(frozen=True)
class CarrierState:
    """State. since_s: when the car began or ceased to draw; frames taken until then show what was before. silent: contrasts in cd/m^2 of
    the last frames without own light. free: number of these frames since the carrier or the own turn. wait: free frames before the next
    turn. collisions: since the last turn that ended without one.
    """

    turn: Turn = "idle"
    since_s: float = -math.inf
    silent: tuple[float, ...] = ()
    free: int = 0
    wait: int = QUIET
    collisions: int = 0


class CarrierSenseParams(Params):
    """Takes turns with other cars on a stretch of road, by the camera."""

    threshold_cd_m2: float = Field(
        0.05, gt=0, le=1e4, description="change of the stretch's mean luminance, relative to its surroundings, that is another car's light"
    )
    pause_every: int = Field(8, ge=2, le=100, description="frames, in one of which the car pauses to listen while it draws")
    turn_s: float = Field(5.0, gt=0, le=1e4, description="longest time for which the car draws before others have their turn")

    def step(self, state: CarrierState, now: Situation, contrast: float, wanted: bool) -> CarrierState:
        """The state after the frame `now.seen`. contrast: of the stretch (`stretch_contrast`). wanted: whether the car wants to draw."""
        busy, seen = False, None if math.isnan(contrast) else now.seen
        if seen is not None and seen.time_s > state.since_s and not self.lights(state, now, seen.time_s):
            silent = (*state.silent, contrast)[-4 * self.pause_every :]
            busy = contrast - min(silent) > self.threshold_cd_m2
            state = replace(state, silent=silent, free=0 if busy else state.free + 1)
        if state.turn == "draws":
            return self._after_drawing(state, now, busy, wanted)
        if seen is None:
            return state
        if busy:
            state = replace(state, wait=_wait(now, 0))
        if wanted and state.free >= state.wait and len(state.silent) >= 2 * self.pause_every:
            return replace(state, turn="draws", since_s=now.time_s)
        return replace(state, turn="waits" if wanted else "idle")

    def lights(self, state: CarrierState, now: Situation, time_s: float) -> bool:
        """Whether the car's own light is on the stretch in an exposure that begins at a time, in its present turn."""
        return state.turn == "draws" and not self._pauses(now, time_s)

    def _after_drawing(self, state: CarrierState, now: Situation, busy: bool, wanted: bool) -> CarrierState:
        """The state after a frame of the own turn, which ends with a collision, its time, or the wish."""
        if not busy and wanted and now.time_s - state.since_s < self.turn_s:
            return state
        collisions = state.collisions + 1 if busy else 0
        wait = _wait(now, collisions) if busy else REST
        return replace(state, turn="waits" if wanted else "idle", since_s=now.time_s, free=0, wait=wait, collisions=collisions)

    def _pauses(self, now: Situation, time_s: float) -> bool:
        """Whether a frame is the one of its `pause_every` frames in which the car pauses."""
        cycle, frame = divmod(round(time_s * now.rate_hz), self.pause_every)
        return frame == np.random.default_rng((now.seed, cycle)).integers(self.pause_every)


def _wait(now: Situation, collisions: int) -> int:
    """Free frames before the next turn, drawn by lot. collisions: in a row."""
    lots = np.random.default_rng((now.seed, round(now.time_s * now.rate_hz), collisions))
    return QUIET + int(lots.integers(WINDOW << min(collisions, DOUBLINGS)))


def stretch_contrast(seen: CameraImage, T_ground_stretch: Tensor, length_m: float, width_m: float) -> float:
    """Mean luminance of a rectangle in cd/m^2 less that of its surroundings, which ambient light changes alike; NaN out of the image.

    T_ground_stretch: `[4, 4]`, pose of its centre, x along its length, y across its width.
    """
    high = torch.tensor([length_m / 2, width_m / 2, 0.0], dtype=torch.float64)
    part = _part_around(seen.view, T_ground_stretch, SURROUNDINGS * high)
    view, luminance = seen.view.within(*part), seen.luminance[part].double()
    inside, whole = (box_region(view, T_ground_stretch, -scale * high, scale * high).to(luminance.device) for scale in (1.0, SURROUNDINGS))
    return float(luminance[inside].mean() - luminance[whole & ~inside].mean())


def _part_around(view: View, T: Tensor, high: Tensor) -> Part:
    """Rows and columns of the image around a rectangle; all of them if part of it is behind the camera."""
    corners = torch.cartesian_prod(*torch.stack([-high, high]).T[:2]).T
    uv, depth = view.project(transform(T, torch.cat([corners, torch.zeros_like(corners[:1])])))
    if bool((depth <= 0).any()):
        return view.whole
    (left, top), (right, bottom) = uv.amin(-1).clamp(min=0).long().tolist(), (uv.amax(-1) + 1).clamp(min=0).long().tolist()
    return slice(min(top, view.height), min(bottom, view.height)), slice(min(left, view.width), min(right, view.width))
