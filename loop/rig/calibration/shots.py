"""Frames of named lights, and the camera response that linearises them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from luxloop.loop.rig.arrays import Array, Image, Mask
from luxloop.loop.rig.calibration.setups import Setup
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, content, reading, writing
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.images import decode

KNOTS = 32
RESPONSE_PIXELS = 400  # camera pixels for the fit
SMOOTH = 10.0  # weight of the curve's second difference relative to a reading
USED = (0.02, 0.98)  # range of digital numbers for the fit, as shares of the full range


def linear_response(levels: int, black: float = 0.0) -> Array:
    """Response `[levels + 1]` of a linear camera. levels: largest digital number. black: digital number without light."""
    return ((np.arange(levels + 1) - black) / (levels - black)).astype(np.float32)


def response_curve(frames: Sequence[Image], ratios: Sequence[float], levels: int) -> Array:
    """Camera response `[levels + 1]` float32: light by digital number, 0 at black and 1 at the largest.

    frames: `[height, width]` each, of one scene at lights in known ratios, by exposure time or utilisation. frames[k] has `ratios[k]` times
    the light of ratio 1, without other light; a frame of ratio 0 gives the black level. Raises LuxloopError if the frames do not suffice.
    """
    order = np.argsort(ratios)
    stack, by = np.stack([frames[k] for k in order]).astype(float), np.array([ratios[k] for k in order], float)
    black = float(np.median(stack[by == 0])) if (by == 0).any() else 0.0
    stack, by = stack[by > 0], by[by > 0]
    low, high = black + USED[0] * (levels - black), USED[1] * levels
    flat = stack.reshape(len(by), -1)
    good = (flat > low) & (flat < high)
    useful = np.flatnonzero(good.sum(0) >= 2)
    if len(by) < 3 or len(useful) < KNOTS:
        raise LuxloopError("the series says too little of the response; take at least three exposures, from dark to nearly saturated")
    by_brightness = useful[np.argsort(flat[:, useful].mean(0))]
    chosen = by_brightness[np.linspace(0, len(by_brightness) - 1, min(RESPONSE_PIXELS, len(by_brightness))).astype(int)]
    knots = np.linspace(np.log(low - black), np.log(high - black), KNOTS)
    log_light = _solve(np.log((flat[:, chosen] - black).clip(min=1e-3)), good[:, chosen], np.log(by), knots)
    numbers = np.arange(levels + 1.0)
    step = np.maximum(numbers - black, 1e-3)
    at = np.log(step)
    slopes = [(log_light[k + 1] - log_light[k]) / (knots[k + 1] - knots[k]) for k in (0, -2)]
    beyond = np.minimum(at - knots[0], 0) * slopes[0] + np.maximum(at - knots[-1], 0) * slopes[1]
    curve = np.maximum.accumulate(np.exp(np.interp(at, knots, log_light) + beyond))
    first = int(np.floor(black)) + 1
    dark = numbers < first
    curve[dark] = (numbers[dark] - black) * curve[first] / (first - black)  # noise about black keeps its sign
    return (curve / curve[-1]).astype(np.float32)


def _solve(codes: Array, good: Mask, log_by: Array, knots: Array) -> Array:
    """Logarithm of the light at knots `[n]`, from `g(z) = ln L_i + ln t_k` by least squares.

    codes: logarithms of digital numbers above black, in which a gamma response is a straight line; g is linear between knots.
    """
    k, i = np.nonzero(good)
    z = codes[k, i]
    left = ((z - knots[0]) / (knots[1] - knots[0])).astype(int).clip(0, len(knots) - 2)
    share = (z - knots[left]) / (knots[1] - knots[0])
    n, rows = len(knots), np.arange(len(z))
    weight = np.exp(0.5 * (z - knots[-1]))  # shot noise
    design = np.zeros((len(z) + n - 1, n + codes.shape[1]))
    design[rows, left], design[rows, left + 1] = weight * (1 - share), weight * share
    design[rows, n + i] = -weight
    right = np.concatenate([weight * log_by[k], np.zeros(n - 1)])
    for offset, factor in enumerate((1.0, -2.0, 1.0)):
        design[len(z) + np.arange(n - 2), np.arange(n - 2) + offset] = SMOOTH * factor
    design[-1, n - 1] = 1e3
    solved, *_ = np.linalg.lstsq(design, right, rcond=None)
    return np.asarray(solved[:n])


NOTE = "setup.json"
SATURATED = 0.98  # of the largest digital number
MOST_SATURATED = 1e-4  # accepted share of saturated pixels in a frame, for reflexes
LONGER = 4.0  # largest ratio of the second exposure, for dim pixels, to the first


@dataclass(frozen=True, eq=False)
class Shots:
    """Frames of lights on a setup, taken once and stored.

    response: as of `response_curve`. folder: of the pictures, `NAME-EXPOSURE-NUMBER.png`; None stores none. what: identifies lamp, camera
    and plan, so that frames of others are refused.
    """

    setup: Setup
    response: Array
    folder: Path | None = None
    what: str = ""

    def __post_init__(self) -> None:
        if self.folder is None:
            return
        note = {"what": self.what, "shape": list(self.setup.shape), "levels": self.setup.levels}
        path = self.folder / NOTE
        if path.is_file():
            with reading(path, "no note of kept frames", "name another folder"):
                if json.loads(content(path)) != note:
                    raise LuxloopError(f"{self.folder}: holds frames of another lamp, camera or plan; name another folder")
            return
        with writing(self.folder, "name another folder"):
            self.folder.mkdir(parents=True, exist_ok=True)
        atomic_write(path, json.dumps(note))

    def frames(self, name: str, lights: Sequence[Array], count: int, exposure_s: float) -> Image:
        """Digital numbers `[count, height, width]` of a light, read from the folder if it has them."""
        paths = [] if self.folder is None else [self.folder / f"{name}-{1e6 * exposure_s:.0f}us-{k}.png" for k in range(count)]
        if paths and all(path.is_file() for path in paths):
            return np.stack([self._read(path) for path in paths])
        frames = self.setup.frames(lights, count, exposure_s, name)
        for path, frame in zip(paths, frames, strict=False):
            atomic_write(path, cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
        return frames

    def light(self, name: str, lights: Sequence[Array], count: int, exposures_s: Sequence[float]) -> Array:
        """Mean light `[height, width]` float32 of frames at each exposure time, in units of the response at one second.

        A pixel is weighted by the exposure time. Saturated pixels count only at the shortest exposure.
        """
        total, weight = np.zeros(self.setup.shape), np.zeros(self.setup.shape)
        for k, exposure_s in enumerate(sorted(exposures_s)):
            frames = self.frames(name, lights, count, exposure_s)
            good = (frames.max(0) < SATURATED * self.setup.levels) | (k == 0)
            total += good * self.response[frames].mean(0)
            weight += good * exposure_s
        return (total / weight).astype(np.float32)

    def exposures(self, name: str, lights: Sequence[Array]) -> tuple[float, ...]:
        """The longest exposure time in s at which a light does not saturate the camera, and a longer one if the camera has it.

        Raises LuxloopError if none is short enough.
        """
        fits = []
        for exposure_s in self.setup.exposures_s:
            frame = self.frames(name, lights, 1, exposure_s)
            if np.mean(frame >= SATURATED * self.setup.levels) <= MOST_SATURATED:
                fits.append(exposure_s)
        if not fits:
            raise LuxloopError("the camera is saturated at its shortest exposure; dim the lamp, close the iris, or lower the gain")
        longer = [each for each in self.setup.exposures_s if 1 < each / fits[-1] <= LONGER]
        return (fits[-1], *longer[-1:])

    def _read(self, path: Path) -> Image:
        with reading(path, "no frame of this setup", "remove it, to have it taken again"):
            frame = decode(content(path), str(path))
            if frame is None or frame.shape != self.setup.shape or frame.max() > self.setup.levels:
                raise ValueError("another size or depth")
            return frame


def plan_digest(*parts: object) -> str:
    """Digest of a measurement plan; equal parts give equal digests."""
    return sha256(json.dumps(parts, default=str, sort_keys=True).encode()).hexdigest()[:16]


def luminous(texture: Tensor) -> Tensor:
    """Light texture `[rows, cols]` in cd of a colour texture `[3, rows, cols]` in linear sRGB; a grey texture is returned unchanged."""
    return texture if texture.ndim == 2 else torch.tensordot(texture.new_tensor(LUMINANCE), texture, 1)
