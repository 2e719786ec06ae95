"""`luxloop optimise-beam`: optimise a beam for a scenario's start, and write utilisations to play, and figures."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from pydantic import ValidationError

from luxloop.loop.recording.manifest import write_json
from luxloop.loop.recording.record import schema
from luxloop.loop.report import terminal as tables
from luxloop.loop.report.progress import progress
from luxloop.loop.run import torch_device
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.overrides import toml_key
from luxloop.loop.simulation.lamps import flux_by_side
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.beams.goal import BeamGoal, BeamJudge, Metric
from luxloop.loop.studies.beams.picture import write_picture
from luxloop.loop.studies.beams.search import Found, Lights, alike, begin, descend, sample
from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import Detector, NetworkParams, TruthParams
from luxloop.perception.detection.network import NetworkDetector
from luxloop.world.errors import LuxloopError, all_of, locate
from luxloop.world.files import output_folder, whole
from luxloop.world.validation import sentences

Method = Literal["auto", "gradient", "sampling"]
STEPS: Mapping[str, int] = {"gradient": 80, "sampling": 150}
FRAMES = 8  # with different noise, over which a detector's scores are averaged
RAW, PICTURE, SUMMARY = "raw.toml", "beam.png", "beam.json"


def optimise_beam(
    scenario: Scenario, weights: Mapping[str, Any], method: Method, steps: int | None, out: Path, device: str, played_by: str
) -> dict[str, Any]:
    """Optimise a beam, write and print it; returns its figures. weights: of a `BeamGoal`. played_by: arguments of `luxloop run`, `--set`
    last.

    Raises LuxloopError for weights below zero, scenarios without objects in sight, and, before the search, a folder that
    cannot be made.
    """
    try:
        goal = BeamGoal(**weights)
    except ValidationError as error:
        raise all_of([f"--{each}" for each in sentences(error, BeamGoal, "")]) from error
    if steps is not None and steps < 1:
        raise LuxloopError(f"--steps {steps}: too few; give 1 or more")
    scenario = scenario.model_copy(update={"functions": {}})
    simulation = Simulation.prepare(scenario, torch_device(device))
    with locate(scenario.source):
        judge = BeamJudge.prepare(simulation, goal, _detector(scenario, goal.metric, simulation.device))
    method = _method(method, judge)
    start, number = begin(judge), steps or STEPS[method]
    search = descend if method == "gradient" else sample
    with output_folder(out), progress("searching", number) as advance:
        found = search(judge, start, number, lambda step, loss: advance())
        lm = sum(flux_by_side(simulation.modules, found.lights).values())
        as_dim = alike(start, [module.flux for module in simulation.modules], lm)
        beams = {"before": start, "before, as much flux": as_dim, "found": found.lights}
        summary = _summary(judge, method, found, beams)
        _write(out, judge, found, beams, summary)
    _tell(summary, f"{played_by} {shlex.quote(str(out / RAW))}")
    return summary


def _detector(scenario: Scenario, metric: Metric, device: torch.device) -> Detector | None:
    if metric != "detector":
        return None
    given = scenario.detector
    return detector(NetworkParams() if given is None or isinstance(given, TruthParams) else given, device)


def _method(asked: Method, judge: BeamJudge) -> Literal["gradient", "sampling"]:
    smooth = judge.detector is None or isinstance(judge.detector, NetworkDetector)
    if asked == "gradient" and not smooth:
        raise LuxloopError(
            "--method gradient: only luxloop's own network can be differentiated; take --method sampling for other detectors"
        )
    if asked != "auto":
        return asked
    return "gradient" if smooth else "sampling"


def _summary(judge: BeamJudge, method: str, found: Found, beams: Mapping[str, Lights]) -> dict[str, Any]:
    return {
        "metric": judge.goal.metric,
        "method": method,
        "weights": judge.goal.model_dump(exclude={"metric"}),
        "steps": len(found.losses),
        "loss_first": found.losses[0],
        "loss_last": min(found.losses) if method == "sampling" else found.losses[-1],
        "beams": {name: _figures(judge, lights) for name, lights in beams.items()},
    }


@torch.no_grad()
def _figures(judge: BeamJudge, lights: Lights) -> dict[str, Any]:
    seen = [judge.judged(lights, step) for step in range(FRAMES)]
    scores = torch.stack([each.scores.double().cpu() for each in seen]).mean(0).tolist()
    eyes = judge.scene.light(lights)[0][judge.scene.eyes]
    return {
        "flux_lm": sum(flux_by_side(judge.simulation.modules, lights).values()),
        "scores": dict(zip(judge.masks, scores, strict=True)),
        "score_mean": sum(scores) / len(scores),
        "eyes_lx_max": float(eyes.max()) if len(eyes) else None,
    }


def _write(out: Path, judge: BeamJudge, found: Found, beams: Mapping[str, Lights], summary: dict[str, Any]) -> None:
    entries = []
    for module, u in zip(judge.simulation.modules, found.lights, strict=True):
        file = out / f"{module.name.replace(' ', '-')}.npz"
        with whole(file) as part, part.open("wb") as stream:
            np.savez_compressed(stream, u=u.cpu().numpy().reshape(module.headlight.pixel_rows, module.headlight.pixel_cols))
        entries.append(f'  {{ file = "./{file.name}", modules = ["{module.name}"] }},\n')
    cleared = "".join(f"{toml_key(key)} = {{}}\n" for key in _gone(judge.simulation))
    with whole(out / RAW) as part:
        part.write_text(f"{cleared}\n[lighting]\nraw = [\n{''.join(entries)}]\n", "utf-8")
    write_json(out / SUMMARY, summary)
    write_picture(out / PICTURE, judge, beams, found.losses, summary)


def _gone(simulation: Simulation) -> list[str]:
    """Keys that mean nothing without functions, of a simulation that has none."""
    scenario, known = simulation.scenario, set(schema(simulation).names) - {"dark_lx_max"}
    spells = {key: getattr(scenario.disturbances, key) for key in ("oncoming", "ambient")}
    return [
        *("functions", "off_share", "detector_frames"),
        *(f"checks.{name}" for name, each in scenario.checks.items() if each.metric not in known or each.compare == "open_loop"),
        *(f"disturbances.{key}[{k}]" for key, each in spells.items() for k, spell in enumerate(each) if spell.frames == "off"),
    ]


def _tell(summary: dict[str, Any], played_by: str) -> None:
    beams = summary["beams"]
    rows = [("flux", *(f"{each['flux_lm']:.0f} lm" for each in beams.values()))]
    rows += (
        (f"{summary['metric']}: {key}", *(f"{each['scores'][key]:.2f}" for each in beams.values())) for key in beams["found"]["scores"]
    )
    rows += [("on eyes", *(tables.number(each["eyes_lx_max"], ".2f", " lx") for each in beams.values()))]
    tables.show(tables.plain(("", *beams), rows))
    print(f"to see it: luxloop run {played_by}")
