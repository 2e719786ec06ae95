"""A small bench on a flat road, and how to make others. Its renderer is at home in all threads."""

from collections.abc import Callable

import numpy as np
import pytest

from luxloop.loop.rig.simulated.faults import FaultParams, read
from luxloop.loop.rig.simulated.scene import LitBench
from luxloop.loop.rig.wire.ddp import LightFrame
from luxloop.loop.scenario.model import Scenario, load

SIZE = ("camera.width_px=160", "camera.height_px=120", "camera.oversampling=1", "camera.hfov_deg=40")
SIZE = ("camera.width_px=160", "camera.height_px=120", "camera.oversampling=1", "camera.hfov_deg=40")
KEYS = ("renderer=raycast", "headlight.model=ssl-hd-lores", *SIZE)
DARK = ("light.ambient_lx=0", "camera.noise=false")


def scenario_of(*keys: str) -> Scenario:
    return load("flat", [*KEYS, *keys])


def faults_of(*keys: str) -> FaultParams:
    return read(None, [f"faults.{key}" for key in keys])


def light(codes: np.ndarray, *timecodes: int) -> LightFrame:
    return LightFrame(codes, timecodes or (0,))


@pytest.fixture(scope="session")
def bench() -> LitBench:
    return LitBench(scenario_of(), faults_of())


@pytest.fixture(scope="session")
def pattern(bench: LitBench) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, bench.pixels, np.uint8)


@pytest.fixture
def image_with(bench: LitBench, pattern: np.ndarray) -> Callable[..., np.ndarray]:
    """What the lens sees of the pattern on a bench with faults."""
    return lambda *keys: LitBench(scenario_of(), faults_of(*keys)).light(light(pattern), 0.0)
