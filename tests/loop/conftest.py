"""A small, fast simulation that the tests of recordings share."""

from typing import Any

import pytest

from loop.scenario import Scenario, validate
from loop.simulation import Simulation, StepResult

SMALL: dict[str, Any] = {
    "name": "small",
    "steps": 12,
    "symbol": {"image": "snowflake"},
    "start": {"x_m": 19.0, "y_m": 1.0, "roll_deg": 5.0, "pitch_deg": -2.0},
    "camera": {"width_px": 320, "height_px": 180},
    "surface": {"grain": 0.0},
    "controller": {"name": "thesis_pid"},
    "renderer": "raycast",
}


@pytest.fixture(scope="session")
def small_scenario() -> Scenario:
    """320 x 180 px, twelve steps on a flat road."""
    return validate(SMALL, "small")


@pytest.fixture(scope="session")
def small_simulation(small_scenario: Scenario) -> Simulation:
    return Simulation.prepare(small_scenario)


@pytest.fixture(scope="session")
def small_results(small_simulation: Simulation) -> list[StepResult]:
    return list(small_simulation.run())
