"""The bench of a real rig: its lamp and camera, with unprocessed pictures."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count as counted
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from luxloop.loop.rig.calibration.bench import Array, Image
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.rectified import Rectifier, grey
from luxloop.loop.rig.rig import CAMERA_S, Rig, opened
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError, locate

TRIES: Final = 20  # of one frame, or of light that a limit slows down


@dataclass(frozen=True, eq=False)
class Codes(Rectifier):
    """Unprocessed pictures, in the camera's digital numbers."""

    def image(self, data: bytes | NDArray[np.generic]) -> NDArray[np.float32]:
        return grey(data).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LiveBench:
    """An open, armed rig. Its camera has one exposure time, which is unknown and set to 1 s, since it cancels out."""

    rig: Rig
    grids: tuple[tuple[int, int], ...]
    shape: tuple[int, int]
    levels: int
    numbers: Iterator[int]
    exposures_s: tuple[float, ...] = (1.0,)

    def frames(self, lights: Sequence[Array], count: int, exposure_s: float, name: str = "") -> Image:
        """As `Bench.frames`. Raises LuxloopError if a limit dims the light, or frames do not arrive."""
        pictures = tuple(u.reshape(grid).astype(np.float32) for u, grid in zip(lights, self.grids, strict=True))
        found: list[Image] = []
        for _ in range(TRIES * count):
            given, taken = self.rig.expose(Shine(next(self.numbers), pictures), 0.0)
            if given.dimmed < 1:
                raise LuxloopError(
                    f"limits: dim this light to {given.dimmed:.0%}, which would falsify it; raise power, and dim the lamp itself"
                )
            if given.slowed < 1 or taken.image is None:
                reason = taken.reason or "limits.change_per_s is too low for the light to get there"
                continue
            if taken.image.shape != self.shape:
                raise LuxloopError("the camera's pictures have changed their size; let it run with one setting")
            if taken.image.max() > self.levels:
                raise LuxloopError(
                    f"camera.bits: a picture has the number {taken.image.max():.0f}, more than the largest, {self.levels}; correct it, "
                    "or leave it out"
                )
            found.append(taken.image.astype(np.uint16))
            if len(found) == count:
                return np.stack(found)
        raise LuxloopError(f"{len(found)} of {count} frames came in {TRIES * count} tries: {reason}; see `luxloop rig check`")


@contextmanager
def live_bench(
    file: Path, params: RigParams, camera: CameraParams, grids: Sequence[tuple[int, int]], ready: Callable[[Rig], None]
) -> Iterator[LiveBench]:
    """Open an armed rig. ready: waits until it is ready. Raises LuxloopError if a device cannot be opened, or no picture arrives."""
    if params.mark is not None:
        raise LuxloopError(f"{file}: mark: lies in the light that is to be measured; take it out to calibrate")
    with locate(str(file)), opened(params, grids, None, armed=True) as rig:
        ready(rig)
        if params.triggered:
            rig.camera.trigger()
        picture = rig.camera.next(time.monotonic() + CAMERA_S)
        if picture is None:
            raise LuxloopError("camera: sends no picture; see `luxloop rig check`")
        first = grey(picture.data)
        rig.rectifier = Codes(params.camera, camera, None, None)
        bits = params.camera.bits or 8 * first.dtype.itemsize
        height, width = first.shape
        yield LiveBench(rig, tuple(grids), (height, width), 2**bits - 1, counted(1))
