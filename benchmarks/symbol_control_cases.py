"""The worlds in which benchmarks/symbol_control.py compares controllers, and the job that runs all of them side by side in one."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import pyarrow as pa
import torch

from luxloop.controllers.symbol import build_controller
from luxloop.loop.recording.files import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import AXES, column, overshoot_percent, settle_step
from luxloop.loop.run import prepare
from luxloop.loop.scenario import data
from luxloop.loop.scenario.model import Scenario, load, validate
from luxloop.loop.scenario.overrides import Override
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.simulation.simulation import Simulation

OFFSET_M = 0.03  # by which the feed-forward's road is too high, and the one that luxloop believes in at a wrong start
FEEDFORWARD = "feedforward, 3 cm off"
CONTROLLERS = ("open", "thesis_pid", "gauss_newton", "model_reference", FEEDFORWARD, "luxloop")

# Name of a scene: the shipped scenario and what changes in it.
STANDING: dict[str, tuple[str, tuple[Override, ...]]] = {
    "flat": ("flat", ()),
    "bumps": ("snowflake", ("road={kind='bumps'}",)),
    "grade + cross-fall": ("snowflake", ("road={kind='grade'}",)),
    "mixed": ("snowflake", ()),
    "speed bump": ("speed_bump", ()),
    "curb": ("curb", ()),
    "Belgian block": ("belgian_block", ()),
    "half-round bar": ("half_round_bar", ()),
    "torsion track": ("torsion_track", ("road.u_m=98",)),
    "rough course": ("rough_course", ("road.u_m=117",)),
    "box, standing": ("black_box_static", ()),
    "box, comes and goes": ("black_box_dynamic", ()),
    "two lamps": ("snowflake", ("headlight.lamps=['left', 'right']", "functions.symbol.modules=['left', 'right']")),
}
LATENCIES = (0, 1, 2, 3)

ROUGH = (15, 2, 10, 21, 18)  # seeds with which a class D road is 2.3 to 2.7 cm rough (RMS) from 8 to 70 m ahead
BELIEVED = "20 m/s, from 3 cm off"
ASIDE_M = 17.28  # where the symbol for 17 m lies when it is drawn for a road that is 3 cm higher, as both lamp and camera are over it
NODDING = "vehicle={{course=[{{speed_m_s=0}}], oscillation={{pitch_deg={}, rate_hz=1.2}}}}"
LATE = "sensors={wheels={delay_s=0.03}, gyro={delay_s=0.03}, attitude={delay_s=0.03}}"
DRIVING: dict[str, tuple[str, tuple[Override, ...]]] = {
    "5 m/s": ("driving", ("vehicle.course=[{speed_m_s=5}]",)),
    "10 m/s": ("driving", ("vehicle.course=[{speed_m_s=10}]",)),
    "20 m/s": ("driving", ()),
    BELIEVED: ("driving", (f"functions.symbol.start.x_m={ASIDE_M}",)),
    "nods by 0.2°": ("flat", (NODDING.format(0.2), LATE)),
    "nods by 1°": ("flat", (NODDING.format(1.0), LATE)),
}

FROM, UNTIL = 20, 30  # steps of a disturbance; the thesis' controller needs 20 to settle
_SPELL = f"from_step={FROM}, until_step={UNTIL}"
UNDISTURBED = "undisturbed"
DISTURBED: dict[str, tuple[str, tuple[Override, ...]]] = {
    UNDISTURBED: ("snowflake", ()),
    "glare in on frames": (
        "snowflake",
        (f"disturbances.oncoming=[{{position_m=[40, 2, 0.65], intensity_cd=500, frames='on', {_SPELL}}}]",),
    ),
    "ambient light x 4 in on frames": ("snowflake", (f"disturbances.ambient=[{{factor=4, frames='on', {_SPELL}}}]",)),
    "ambient light x 4 in off frames": ("snowflake", (f"disturbances.ambient=[{{factor=4, frames='off', {_SPELL}}}]",)),
    "half of the frames lost": ("snowflake", (f"disturbances.drops=[{{probability=0.5, {_SPELL}}}]",)),
    "noise x 10": ("snowflake", (f"disturbances.noise=[{{factor=10, {_SPELL}}}]",)),
}
SMALL = "camera={width_px=640, height_px=480}"
STEPS = 30


@dataclass(frozen=True)
class Case:
    """One world: part of the table, scene, frames' latency in steps, seed, and the scenario of which each controller gets its turn."""

    part: str
    scene: str
    latency: int
    seed: int
    scenario: Scenario

    @property
    def key(self) -> str:
        return f"{self.scene}, {self.latency} late, seed {self.seed}"

    @property
    def parameters(self) -> dict[str, Any]:
        """Of the job."""
        tables = {name: self._controller(name) for name in CONTROLLERS}
        return {"scenario": uncontrolled(self.scenario), "controllers": tables}

    def _controller(self, name: str) -> dict[str, Any]:
        if name != FEEDFORWARD:
            wrong = {"start_height_m": OFFSET_M} if name == "luxloop" and self.scene == BELIEVED else {}
            return {"name": name, **wrong}
        road = self.scenario.road.model_dump(mode="json") if self.scenario.vehicle is None else {"kind": "flat"}
        if "file" in road:
            road["file"] = str(data.locate(road["file"]))
        return {"name": "feedforward", "road": road, "offset_m": OFFSET_M}


def cases(seeds: int, quick: bool) -> Iterator[Case]:
    """All worlds but those whose road was measured and is not here."""
    for seed in range(seeds):
        for scene, (name, changes) in STANDING.items():
            steps = {"steps": STEPS} if load(name).steps == 40 else {}  # boxes need the time that they are given
            for latency in (0, 2) if quick else LATENCIES:
                scenario = load(name, (SMALL, *changes, f"camera.latency_steps={latency}"), seed=seed, **steps)
                if scenario.road.kind != "opencrg" or data.present(scenario.road.file) is not None:
                    yield Case("standing", scene, latency, seed, scenario)
        for scene, (name, changes) in DRIVING.items():
            rough = ("road.roughness_class='D'", f"road.seed={ROUGH[seed]}") if name == "driving" else ()
            yield Case("driving", scene, 0, seed, load(name, (SMALL, *rough, *changes), seed=seed, steps=STEPS))
        for scene, (name, changes) in DISTURBED.items():
            yield Case("disturbed", scene, 0, seed, load(name, (SMALL, *changes), seed=seed, steps=50))


def uncontrolled(scenario: Scenario) -> dict[str, Any]:
    """Plain data of a scenario whose symbol lacks its controller."""
    return scenario.model_dump(mode="json", exclude={"functions": {"symbol": {"controller"}}})


def controlled(scenario: Mapping[str, Any], controller: Mapping[str, Any]) -> Scenario:
    """The scenario of such data, with a controller."""
    symbol = {**scenario["functions"]["symbol"], "controller": controller}
    return validate({**scenario, "functions": {"symbol": symbol}}, str(scenario["name"]))


def trajectories(scenario: Mapping[str, Any], controllers: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """A job: what the judge says of each controller at each step, and when it settled."""
    torch.set_num_threads(1)  # wherever the job runs
    found = {}
    for name, table in side_by_side(*shared(scenario, controllers)).items():
        judged = {column_name: [finite(value) for value in column(table, column_name)] for column_name in (*AXES, "iou")}
        found[name] = {"settle_step": settle_step(table), "overshoot_percent": overshoot_percent(table), **judged}
    return {"judged": found}


def shared(scenario: Mapping[str, Any], controllers: Mapping[str, Mapping[str, Any]]) -> tuple[Simulation, dict[str, Scenario]]:
    """The world of a scenario, which is prepared once, and the scenario with each of the controllers."""
    own = {name: controlled(scenario, table) for name, table in controllers.items()}
    return prepare(next(iter(own.values())), "cpu"), own


def side_by_side(simulation: Simulation, own: Mapping[str, Scenario]) -> dict[str, pa.Table]:
    """What recordings have of the symbol in the steps of each controller.

    All go through the same world step by step, so each view of it is rendered once, and their frames have the same noise.
    """
    sensor = simulation.symbol.sensor
    controllers = (build_controller(each.symbol.controller, sensor) for each in own.values())
    runs = [replace(simulation.with_controller(each), scenario=own[name]).run() for name, each in zip(own, controllers, strict=True)]
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in own}
    for results in zip(*runs, strict=True):
        for name, result in zip(own, results, strict=True):
            rows[name].append(row(result))
    columns = schema(simulation)
    return {name: of_one(table_of(each, columns), "symbol") for name, each in rows.items()}


def finite(value: float) -> float | None:
    """To four digits, as JSON can hold it."""
    return round(float(value), 4) if math.isfinite(value) else None
