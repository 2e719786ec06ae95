"""A small, fast simulation that the tests of recordings share, and a command line in a folder of its own."""

import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.commands import cli
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import overridden
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulated import SimulatedPlant
from luxloop.loop.simulation.simulation import Simulation
from tests.lamps import SMALL_LAMP

SMALL: dict[str, Any] = tomllib.loads(f"""
name = "small"
steps = 12
renderer = "raycast"
camera = {{ width_px = 320, height_px = 180 }}
surface.grain = 0.0
headlight = {{ model = "{SMALL_LAMP}", lamps = ["left"] }}
[functions.symbol]
kind = "symbol"
image = "snowflake"
start = {{ x_m = 19.0, y_m = 1.0, roll_deg = 5.0, pitch_deg = -2.0 }}
controller.name = "thesis_pid"
""")

FILE = f"""
name = "small"
steps = 3
renderer = "raycast"
[surface]
grain = 0.0
[camera]
width_px = 320
height_px = 180
[headlight]
model = "{SMALL_LAMP}"
lamps = ["left"]
[functions.symbol]
kind = "symbol"
image = "chevrons"
controller = "luxloop"
start = {{ x_m = 18.0, roll_deg = 2.0 }}
"""

Lux = Callable[..., tuple[int, str, str]]
newest: list[Simulation] = []


def simulation_of(scenario: Scenario) -> Simulation:
    """The simulation of a scenario, with the lamps and the world of the one before where they are the same."""
    newest[:] = [prepare(scenario, "cpu", *newest)]
    return newest[0]


def toml(text: str) -> dict[str, Any]:
    """Plain data of the lines of a TOML table, or of one in braces."""
    return tomllib.loads(f"it = {text}")["it"] if text.startswith("{") else tomllib.loads(text)


def scenario_of(base: str, *overrides: str, **changes: Any) -> Scenario:
    """The scenario of a TOML text with other tables, and values as of `--set`."""
    return validate(overridden(tomllib.loads(base) | changes, overrides), "test")


def simulated(base: str, *overrides: str, **changes: Any) -> Simulation:
    """The simulation of that scenario."""
    return simulation_of(scenario_of(base, *overrides, **changes))


def box(name: str, size_m: Sequence[float], *places: tuple[float, float, float], **more: Any) -> dict[str, Any]:
    """A box that is at one place (x, y in m, heading in deg) after the other, a second each."""
    track = [{"time_s": float(k), "position_m": (x, y, 0.0), "yaw_deg": yaw_deg} for k, (x, y, yaw_deg) in enumerate(places)]
    return {"kind": "box", "name": name, "size_m": size_m, "track": track} | more


def van(*places: tuple[float, float, float], **more: Any) -> dict[str, Any]:
    return box("van", (4.5, 1.8, 1.9), *places, category="car", **more)


@pytest.fixture(scope="module", autouse=True)
def only_of_this_file() -> Iterator[None]:
    """No simulation outlives the tests of its file."""
    yield
    newest.clear()


@pytest.fixture(scope="session")
def small_scenario() -> Scenario:
    """320 x 180 px, twelve steps on a flat road."""
    return validate(SMALL, "small")


@pytest.fixture(scope="session")
def small_simulation(small_scenario: Scenario) -> Simulation:
    return Simulation.prepare(small_scenario)


@pytest.fixture(scope="session")
def small_results(small_simulation: Simulation) -> list[StepResult]:
    return list(small_simulation.evaluations())


@pytest.fixture
def own(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test's `OWN`, the text of a module that a user wrote, can be named in scenarios as `own`."""
    newest.clear()
    (tmp_path / "own.py").write_text(request.module.OWN)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.fixture
def lux(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lux:
    """Run a command line in a folder that has small.toml; gives exit code, stdout and stderr."""
    (tmp_path / "small.toml").write_text(FILE)
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        code = cli.main(arguments)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def frames_of(plant: SimulatedPlant, lights: Sequence[Utilisation], step: int = 0) -> tuple[Tensor, Tensor] | None:
    """On and off frame of lights that are shown in a step, None where they are lost."""
    state, _ = plant.start()
    images = []
    dark = tuple(Utilisation(0 * light.u, slice(0, 0)) for light in lights)
    for part, shown in enumerate((tuple(lights), dark)):
        exposure = Exposure(2 * step + part, (step + part / 2) * plant.period_s, plant.period_s / 2, shown)
        state, arrivals = plant.show(state, exposure)
        images += [frame.image for frame in arrivals.frames]
    on, off = images
    return None if on is None or off is None else (on, off)


def assert_one_sentence(error: str) -> None:
    assert error.startswith("error: ")
    assert error.count("\n") == 1 and error.endswith("\n")
    assert "Traceback" not in error and not re.search(r"\.\s+[A-Z]", error)


def assert_refused(done: tuple[int, str, str], *words: str) -> None:
    """A command line ends with one sentence that has all words."""
    code, _, error = done
    assert code == cli.WRONG and all(word in error for word in words), error
    assert_one_sentence(error)
