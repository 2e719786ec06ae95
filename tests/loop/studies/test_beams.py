"""A beam that is optimised is better at its goal, honest about glare and energy, and can be played."""

import json
import math
import re
import tomllib
from typing import Any

import pytest
import torch

from luxloop import Simulation, load, prepare, validate
from luxloop.loop.commands import cli
from luxloop.loop.scenario.text import scenario_text
from luxloop.loop.studies.beams import BeamEvaluator, BeamGoal, _method, alike, begin, descend, sample
from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import HogParams, NetworkParams
from tests.loop.conftest import assert_refused
from tests.refusal import refusal

SCENE: dict[str, Any] = tomllib.loads("""
name = "beam"
headlight.model = "hd84"
camera = { width_px = 320, height_px = 180, oversampling = 1, saturation_e = 2000, pitch_deg = 1.5 }
light.ambient_lx = 0.02
surface.grain = 0.0
lighting.base.beam = "low"
renderer = "raycast"
[[objects]]
kind = "pedestrian"
name = "eva"
seed = 5
track = [{ position_m = [14, 0.5, 0] }]
""")


def evaluator(goal: BeamGoal, params: NetworkParams | HogParams | None = None, **changes: Any) -> BeamEvaluator:
    scenario = validate(SCENE | changes, "beam")
    simulation = Simulation.prepare(scenario)
    return BeamEvaluator.prepare(simulation, goal, None if params is None else detector(params, simulation.device))


def test_the_gradient_goes_through_lamps_scene_camera_and_network():
    found = evaluator(BeamGoal(), NetworkParams())
    lights = tuple(torch.full_like(u, 0.1).requires_grad_(True) for u in begin(found))
    with torch.enable_grad():
        loss = found.evaluate(lights).loss
        loss.backward()
    slopes = torch.cat([u.grad for u in lights])
    assert bool(slopes.isfinite().all()) and bool((slopes != 0).any())
    # along the gradient, the loss rises as the gradient says; float32, and a network with kinks
    step = 1e-3 / float(slopes.norm())
    losses = []
    for sign in (1, -1):
        moved = tuple((u + sign * step * u.grad).detach().requires_grad_(True) for u in lights)
        losses.append(float(found.evaluate(moved).loss.detach()))
    assert losses[0] - losses[1] == pytest.approx(2 * step * float(slopes.square().sum()), rel=0.1)


def test_light_in_fog_counts_and_the_gradient_goes_through_it():
    found = evaluator(BeamGoal(metric="weber_contrast"), air=[{"visibility_m": 30.0}])
    lights = tuple(u.clone().requires_grad_(True) for u in begin(found))
    with torch.enable_grad():
        result = found.evaluate(lights)
        (sky,) = torch.autograd.grad(result.luminance[:20].sum(), lights[:1])
    frame = found.simulation.at(0).luminance
    torch.testing.assert_close(result.luminance.detach(), frame, rtol=1e-4, atol=1e-4)  # texels or pixels of light: float32
    assert bool((sky > 0).any()), "what is above the horizon is lit by the air alone"


def test_descent_raises_a_metric_or_saves_energy():
    found = evaluator(BeamGoal(metric="weber_contrast"))
    start = begin(found)
    first, last = found.evaluate(start), found.evaluate(descend(found, start, 8)[0])
    assert float(last.loss) < float(first.loss) - 0.05
    assert float(last.share) < float(first.share) or float(last.scores.mean()) > float(first.scores.mean())


def test_what_has_no_gradient_is_sampled_and_never_gets_worse():
    found = evaluator(BeamGoal(), HogParams())
    lights, losses = sample(found, begin(found), 4)
    assert min(losses) <= losses[0] and all(float(u.min()) >= 0 and float(u.max()) <= 1 for u in lights)


def test_a_beam_is_dimmed_to_as_much_flux():
    lights, flux = (torch.tensor([0.5, 1.0]),), (torch.tensor([10.0, 20.0]),)
    assert float((alike(lights, flux, 5.0)[0] * flux[0]).sum()) == pytest.approx(5.0)


PLAYED = """
name = "beam"
steps = 1
off_share = 0.47
detector_frames = "both"
detector.kind = "truth"
objects = [{ kind = "pedestrian", name = "eva", seed = 5, track = [{ position_m = [14, 0.5, 0] }] }]
headlight.model = "hd84"
camera = { width_px = 320, height_px = 180, oversampling = 1 }
lighting.base.beam = "low"
disturbances.ambient = [{ factor = 2, frames = "off" }, { factor = 2, frames = "on" }]
functions.flake = { kind = "symbol", image = "snowflake", controller = "open" }
functions.guard.kind = "glare_free"
[checks]
iou = { metric = "functions.flake.iou", at_least = 0 }
dark = { metric = "dark_lx_max", at_least = 0 }
held = { metric = "objects.eva.lx_max", at_least = 0, compare = "open_loop" }
eva = { metric = "objects.eva.lx_max", at_least = 0 }
dimmer = { metric = "lamp.left.flux_lm", at_least = 0, compare = "full_light" }
"""


def test_the_command_leaves_what_a_scenario_plays(tmp_path, capsys):
    file = tmp_path / "beam.toml"
    file.write_text(PLAYED)
    out = tmp_path / "out"
    assert cli.main(["optimise-beam", str(file), "--metric", "edges", "--steps", "3", "--out", str(out), "--device", "cpu"]) == 0
    assert {each.name for each in out.iterdir()} == {"raw.toml", "beam.json", "beam.png", "left-matrix.npz", "right-matrix.npz"}
    summary = json.loads((out / "beam.json").read_text())
    assert summary["beams"]["before, as much flux"]["flux_lm"] == pytest.approx(summary["beams"]["found"]["flux_lm"], rel=1e-4)
    assert all(math.isfinite(score) for each in summary["beams"].values() for score in each["scores"].values())
    raw = load(str(file), [str(out / "raw.toml")])
    assert [*raw.checks] == ["eva", "dimmer"] and not raw.functions, "checks of functions that are left out go with them"
    assert (raw.off_share, raw.detector_frames) == (0.5, "on"), "nor are there off frames without a symbol that is held"
    assert [spell.frames for spell in raw.disturbances.ambient] == ["on"]
    played = prepare(raw, "cpu").at(0)
    lm = sum(power.flux_lm for power in played.powers.values())
    assert lm == pytest.approx(summary["beams"]["found"]["flux_lm"], rel=1e-4)
    assert f"luxloop run {file} --set {out / 'raw.toml'}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("gfhb --energy -1", "for --energy; must be >= 0"),
        ("gfhb --steps 0", "for --steps; must be >= 1"),
        ("zones --metric edges", "zones.toml: objects: none with a category"),
        (f"gfhb --metric edges --out {__file__}/beam", "beam: cannot be written (Not a directory)"),
    ],
)
def test_what_cannot_be_optimised_is_told(line, words, lux):
    assert_refused(lux("optimise-beam", *line.split(), "--device", "cpu"), words)


DETECTOR = """
class Detector:
    classes = ("pedestrian",)
    def __init__(self, device):
        pass
    def detect(self, frames):
        raise RuntimeError("never")
"""


@pytest.mark.parametrize("there", [False, True])
def test_a_search_that_fails_leaves_no_folder_but_one_that_was_there(there, lux, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "detects_never.py").write_text(DETECTOR)
    own = SCENE | {"detector": {"kind": "detects_never:Detector"}}
    (tmp_path / "beam.toml").write_text(scenario_text(validate(own, "beam")))
    out = tmp_path / "out"
    if there:
        out.mkdir()
    given = ["optimise-beam", "beam.toml", "--method", "sampling", "--steps", "1", "--out", "out", "--device", "cpu"]
    assert_refused(lux(*given), "--allow-code")
    code, _, error = lux(*given, "--allow-code")
    assert code == 2 and re.search(r"error: .*detects_never:Detector: detect fails at .*\.py, line 7 \(RuntimeError: never\)", error)
    assert out.exists() == there


def test_only_the_network_has_a_gradient_and_somebody_must_be_there():
    with refusal("sampling"):
        _method("gradient", evaluator(BeamGoal(), HogParams()))
    with refusal("none with a category"):
        evaluator(BeamGoal(metric="edges"), objects=[])
