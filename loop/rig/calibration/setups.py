"""Measuring setups that show a light and return frames of it: a scenario's simulated world, or a rig."""

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import scipy.sparse as sp
import torch

from luxloop.loop.rig.arrays import Array, Grids, Image
from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.rectification import grey
from luxloop.loop.rig.rig import CAMERA_S, Rig, open_rig
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.simulated import simulated_plant
from luxloop.loop.simulation.truth import LampModule
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import CameraParams, expose
from luxloop.perception.noise import FrameNoise
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.light.illumination import Transport

BAND = 256  # rows rendered at once
OVERSAMPLING = 4  # samples along each side of a camera pixel


@dataclass(frozen=True, eq=False)
class SimulatedSetup:
    """A scenario's simulated world and a camera at rest; one sparse matrix per module maps lamp pixels to camera pixels.

    transports: `[height * width, n_p]`, cd/m^2 at full utilisation. base: `[height, width]` cd/m^2 of other light. seed: of the noise.
    exposures_s: available exposure times, ascending; one if the camera is locked.
    """

    transports: tuple[sp.csr_array, ...]
    base: Array
    camera: CameraParams
    seed: int
    exposures_s: tuple[float, ...]

    @property
    def shape(self) -> tuple[int, int]:
        return self.camera.height_px, self.camera.width_px

    @property
    def levels(self) -> int:
        """Largest digital number."""
        return 2**self.camera.bits - 1

    def luminance(self, lights: Sequence[Array]) -> Array:
        """Luminance `[height, width]` in cd/m^2. lights: utilisations `[n_p]` in 0..1 of each module."""
        light = sum(transport @ u.astype(np.float32) for transport, u in zip(self.transports, lights, strict=True))
        return np.asarray(self.base + np.reshape(light, self.shape))

    def frames(self, lights: Sequence[Array], count: int, exposure_s: float, name: str = "") -> Image:
        """Digital numbers `[count, height, width]` of frames. lights: utilisations `[n_p]` in 0..1 of each module.

        name: of the measurement. The noise depends on it, so that a resumed measurement gets the same noise.
        """
        camera = self.camera.model_copy(update={"exposure_s": exposure_s})
        image = torch.from_numpy(self.luminance(lights).astype(np.float32))
        key = crc32(b"".join([f"{name} {exposure_s:g}".encode(), *(u.tobytes() for u in lights)]))
        noise = (FrameNoise.of(self.seed, key, k) for k in range(count))
        return np.stack([expose(image, camera, each).numpy().astype(np.uint16) for each in noise])


def simulated_setup(scenario: Scenario, modules: Sequence[LampModule]) -> SimulatedSetup:
    """Setup of a scenario's world. Raises LuxloopError if something in the world moves."""
    plant = simulated_plant(scenario, modules)
    camera = plant.world.camera
    if plant.world.moving or plant.world.metered:
        raise LuxloopError(f"{scenario.source}: calibration needs a world that stands still; take out vehicle, detector and moving objects")
    sampled = camera.model_copy(update={"oversampling": OVERSAMPLING})
    world = World(plant.world.scene, plant.world.modules, sampled, plant.world.source, given=plant.world.given)
    bases, columns = [], []
    for start in range(0, camera.height_px, BAND):
        lit = world.lit(0.0).within((slice(start, min(start + BAND, camera.height_px)), slice(0, camera.width_px)))
        bases.append(lit.base.numpy())
        columns.append([_spread(transport, lit.base.numel()) for transport in lit.transports])
    transports = tuple(sp.csr_array(sp.vstack(each, format="csr")) for each in zip(*columns, strict=True))
    exposures_s = tuple(camera.exposure_s * 2.0**k for k in (-4, -3, -2, -1, 0))
    return SimulatedSetup(transports, np.concatenate(bases).astype(np.float64), camera, scenario.seed, exposures_s)


def _spread(transport: Any, n: int) -> sp.csr_matrix:
    """Transport matrix with a row for each of the picture's n pixels."""
    assert isinstance(transport, Transport)
    index = transport.index.numpy()
    rows = sp.csr_matrix((np.ones(len(index), np.float32), (index, np.arange(len(index)))), shape=(n, len(index)))
    return rows @ transport.matrix.to_scipy()


TRIES = 20  # exposures for one frame, and for light that the rate limit delays


@dataclass(frozen=True, eq=False)
class RigSetup:
    """An open, armed rig as a setup. The camera's only exposure time is unknown and set to 1 s, since it cancels out."""

    rig: Rig
    grids: Grids
    shape: tuple[int, int]
    levels: int
    numbers: Iterator[int]
    exposures_s: tuple[float, ...] = (1.0,)

    def frames(self, lights: Sequence[Array], count: int, exposure_s: float, name: str = "") -> Image:
        """Frames as of `SimulatedSetup.frames`. Raises LuxloopError if a limit dims the light, or frames do not arrive."""
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


Setup = SimulatedSetup | RigSetup


@contextmanager
def rig_setup(file: Path, params: RigParams, grids: Grids, ready: Callable[[Rig], None]) -> Iterator[RigSetup]:
    """Open an armed rig as a setup. ready: waits for lamp and camera. Raises LuxloopError if a device cannot be opened, or no picture
    arrives.
    """
    if params.mark is not None:
        raise LuxloopError(f"{file}: mark: lies in the light that is to be measured; take it out to calibrate")
    with locate(str(file)), open_rig(params, grids, None, armed=True) as rig:
        ready(rig)
        picture = rig.picture(time.monotonic() + CAMERA_S)
        if picture is None:
            raise LuxloopError("camera: sends no picture; see `luxloop rig check`")
        first = grey(picture.data)
        rig.rectify = lambda data: grey(data).astype(np.float32)
        bits = params.camera.bits or 8 * first.dtype.itemsize
        height, width = first.shape
        yield RigSetup(rig, tuple(grids), (height, width), 2**bits - 1, itertools.count(1))
