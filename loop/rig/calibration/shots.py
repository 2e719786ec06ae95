"""Frames of named lights: kept as pictures, from which an interrupted measurement resumes, and read as light."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from luxloop.loop.rig.calibration.bench import Array, Bench, Image
from luxloop.loop.rig.calibration.response import Response
from luxloop.world.errors import LuxloopError
from luxloop.world.files import content, reading, whole
from luxloop.world.images import decode

NOTE: Final = "bench.json"
SATURATED: Final = 0.98  # of the largest digital number
MOST_SATURATED: Final = 1e-4  # share of a frame's pixels, reflexes say
LONGER: Final = 4.0  # of exposures that are taken besides, for dim pixels


@dataclass(frozen=True, eq=False)
class Shots:
    """Frames of lights on a bench, each taken once.

    folder: of the pictures, `NAME-EXPOSURE-NUMBER.png`; None keeps none. what: identifies lamp, camera and plan, so that frames of
    others are refused. dark: light `[height, width]` without the lamp, which is subtracted from all.
    """

    bench: Bench
    response: Response
    folder: Path | None = None
    what: str = ""

    def __post_init__(self) -> None:
        if self.folder is None:
            return
        note = {"what": self.what, "shape": list(self.bench.shape), "levels": self.bench.levels}
        path = self.folder / NOTE
        if path.is_file():
            with reading(path, "no note of kept frames", "name another folder"):
                if json.loads(content(path)) != note:
                    raise LuxloopError(f"{self.folder}: holds frames of another lamp, camera or plan; name another folder")
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise LuxloopError(f"{self.folder}: cannot be made ({error.strerror}); name another folder") from error
        with whole(path) as part:
            part.write_text(json.dumps(note), "utf-8")

    def frames(self, name: str, lights: Sequence[Array], count: int, exposure_s: float) -> Image:
        """Digital numbers `[count, height, width]` of a light, from the folder if it has them."""
        paths = [] if self.folder is None else [self.folder / f"{name}-{1e6 * exposure_s:.0f}us-{k}.png" for k in range(count)]
        if paths and all(path.is_file() for path in paths):
            return np.stack([self._read(path) for path in paths])
        frames = self.bench.frames(lights, count, exposure_s, name)
        for path, frame in zip(paths, frames, strict=False):
            with whole(path) as part:
                part.write_bytes(cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
        return frames

    def light(self, name: str, lights: Sequence[Array], count: int, exposures_s: Sequence[float]) -> Array:
        """Mean light `[height, width]` float32 of a few frames at each exposure time, in units of the response at one second.

        A pixel counts in proportion to the exposure, and not where it is saturated in all frames but those of the shortest.
        """
        total, weight = np.zeros(self.bench.shape), np.zeros(self.bench.shape)
        for k, exposure_s in enumerate(sorted(exposures_s)):
            frames = self.frames(name, lights, count, exposure_s)
            good = (frames.max(0) < SATURATED * self.bench.levels) | (k == 0)
            total += good * self.response.light(frames).mean(0)
            weight += good * exposure_s
        return (total / weight).astype(np.float32)

    def exposures(self, name: str, lights: Sequence[Array]) -> tuple[float, ...]:
        """The longest exposure at which a light does not saturate the camera, and a longer one if the camera has it.

        Raises LuxloopError if none is short enough.
        """
        fits = []
        for exposure_s in self.bench.exposures_s:
            frame = self.frames(name, lights, 1, exposure_s)
            if np.mean(frame >= SATURATED * self.bench.levels) <= MOST_SATURATED:
                fits.append(exposure_s)
        if not fits:
            raise LuxloopError("the camera is saturated at its shortest exposure; dim the lamp, close the iris, or lower the gain")
        longer = [each for each in self.bench.exposures_s if 1 < each / fits[-1] <= LONGER]
        return (fits[-1], *longer[-1:])

    def _read(self, path: Path) -> Image:
        with reading(path, "no frame of this bench", "remove it, to have it taken again"):
            frame = decode(content(path), str(path))
            if frame is None or frame.shape != self.bench.shape or frame.max() > self.bench.levels:
                raise ValueError("another size or depth")
            return frame


def plan_digest(*parts: object) -> str:
    """Digest that identifies a plan of measurement, equal for equal parts."""
    return sha256(json.dumps(parts, default=str, sort_keys=True).encode()).hexdigest()[:16]
