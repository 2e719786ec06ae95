"""Arrival of the frames of a simulated camera, computed for a whole run in advance."""

from collections.abc import Iterator

import numpy as np

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.simulated import LATENCY_KEY, LOSS_KEY

Arrival = int | None  # step in which the frames were taken, None for lost ones


def arrivals(scenario: Scenario) -> list[list[Arrival]]:
    """Whose frames arrive in each of a run's steps, in order; None stands for those that are lost, and for none."""
    found: list[list[Arrival]] = [[] for _ in range(scenario.steps)]
    for step, due in enumerate(_due(scenario)):
        if due < scenario.steps:
            found[due].append(None if _lost(scenario, step) else step)
    return [each or [None] for each in found]


def _due(scenario: Scenario) -> Iterator[int]:
    """The step in which the frames of each step arrive, never before earlier ones."""
    latest, camera = 0, scenario.camera
    for step in range(scenario.steps):
        spread = (
            int(_draw(scenario, step, LATENCY_KEY).integers(camera.latency_spread_steps, endpoint=True))
            if camera.latency_spread_steps
            else 0
        )
        latest = max(latest, step + camera.latency_steps + spread)
        yield latest


def _lost(scenario: Scenario, step: int) -> bool:
    p = scenario.disturbances.loss_probability(step, scenario.camera.drop_probability)
    return p > 0 and bool(_draw(scenario, step, LOSS_KEY).random() < p)


def _draw(scenario: Scenario, step: int, key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(scenario.seed, spawn_key=(step, key)))
