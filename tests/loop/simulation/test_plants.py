"""Lighting functions on any plant: one that does not know the truth, and a recording, on which they work in shadow."""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import pyarrow.parquet as pq
import pytest
from rich.console import Console
from torch import Tensor

from luxloop import Simulation, run, validate
from luxloop.loop.recording.record import row
from luxloop.loop.report.run_table import summary_table
from luxloop.loop.simulation.result import StepResult
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import toml
from tests.refusal import refusal, sentence

OWN = """
import torch
from luxloop import Detections, simulated_plant

class Blind:
    def __init__(self, scenario, modules):
        self.inner = simulated_plant(scenario, modules)
        self.names = [module.name for module in modules]
    def start(self):
        return self.inner.start()
    def show(self, state, exposure):
        assert len(exposure.lights) == len(self.names)
        return self.inner.show(state, exposure)

class Knowing(Blind):
    @property
    def truth(self):
        return self.inner.truth

class Brightest:
    classes = ("car",)
    def __init__(self, device):
        pass
    def detect(self, images):
        found = []
        for image in images:
            lit = (image > 0.5 * image.max()).nonzero()
            (v0, u0), (v1, u1) = lit.amin(0).tolist(), lit.amax(0).tolist()
            found.append(Detections(torch.tensor([[u0, v0, u1 + 1, v1 + 1]]).float(), torch.tensor([[0.9]])))
        return found
"""
WORLD: dict[str, Any] = toml("""
name = "lit"
steps = 8
headlight = { model = "hd84", lamps = ["left"] }
camera = { width_px = 160, height_px = 90, latency_steps = 1, exposure_s = 0.004 }
light.ambient_lx = 0.5
vehicle = { course = [{ speed_m_s = 8.0 }], oscillation.pitch_deg = 0.5 }
functions.near = { kind = "zone", centre_m = [15, 0, 0.1], size_m = [6, 3, 0.2], luminance_cd_m2 = 0.2 }
""")
CAR = toml("{ kind = 'car', name = 'parked', category = 'car', track = [{ position_m = [25, -2, 0] }] }")
SEES = {"detector": {"kind": "own:Brightest"}, "objects": [CAR], "functions": WORLD["functions"] | {"guard": {"kind": "glare_free"}}}
BLIND = {"kind": "own:Blind"}


def simulation(**changes: Any) -> Simulation:
    return Simulation.prepare(validate(WORLD | changes, "lit"))


def lights(results: Sequence[StepResult]) -> list[Tensor]:
    return list(chain.from_iterable(each.lights for each in results))


@pytest.mark.usefixtures("own")
def test_without_truth_the_light_is_the_same_and_nobody_says_where_it_lies():
    known, blind = list(simulation(**SEES).evaluations()), list(simulation(**SEES, plant=BLIND).evaluations())
    assert all(a.equal(b) for a, b in zip(lights(known), lights(blind), strict=True))
    assert [each.zones["near"].lx for each in known] == [each.zones["near"].lx for each in blind]
    for each in blind:
        assert each.illuminance is None and each.luminance is None and not each.objects
        assert row(each)["functions.near.luminance"] is None and row(each)["dark_lx_max"] is None
    assert any(len(each.detections.tracks) for each in blind if each.detections is not None), "the detector works on the frames"


@pytest.mark.usefixtures("own")
def test_a_symbol_is_held_on_a_plant_without_truth():
    flake = toml("{ kind = 'symbol', image = 'snowflake', controller = 'thesis_pid', start.x_m = 18.0 }")
    lamp = {"model": SMALL_LAMP, "lamps": ["left"]}
    held = {"headlight": lamp, "camera": {"width_px": 320, "height_px": 180}, "functions": {"flake": flake}, "vehicle": None}
    known, blind = list(simulation(**held, judge_every=3).evaluations()), list(simulation(**held, plant=BLIND).evaluations())
    assert all(a.held["flake"].pose.equal(b.held["flake"].pose) for a, b in zip(known, blind, strict=True))
    assert all(each.held["flake"].metrics is None for each in blind)
    assert [each.held["flake"].metrics is not None for each in known] == [step % 3 == 0 for step in range(8)]


@pytest.mark.usefixtures("own")
def test_a_run_without_truth_is_recorded_reported_and_repeated(lux, tmp_path):
    summary = run(validate(WORLD | SEES | {"plant": BLIND}, "lit"), tmp_path / "blind", device="cpu").summary
    console = Console(record=True, width=160)
    console.print(summary_table(summary, "blind"))
    assert "boxes a step" in (told := console.export_text()) and "nothing" not in told
    assert summary["dark_lx_max"] is None and summary["objects"] == {} and summary["shadow_of"] is None
    assert {each.name for each in (tmp_path / "blind").iterdir()} >= {"report.png", "video.mp4", "summary.json"}
    assert lux("replay", "blind", "--compare", "--allow-code")[0] == 0


@pytest.mark.usefixtures("own")
def test_functions_work_in_shadow_on_the_frames_of_a_recording(tmp_path):
    """The same functions ask for the same light again; others see what was lit then, not what they ask for."""
    folder = tmp_path / "recorded"
    run(validate(WORLD | SEES, "lit"), folder, frames=True, video=False, report=False, device="cpu")
    recording = {"plant": {"kind": "recording", "folder": str(folder)}}
    again = list(simulation(**SEES, **recording).evaluations())
    table = pq.read_table(folder / "trajectory.parquet")
    for key in ("functions.near.lx", "lamp.left.flux_lm", "speed_m_s", "tracks"):
        assert [row(each)[key] for each in again] == table[key].to_pylist(), f"{key}, bit for bit"
    changed = SEES | toml("{ functions.far = { kind = 'zone', centre_m = [30, 0, 0.1], size_m = [9, 3, 0.2], luminance_cd_m2 = 5.0 } }")
    other = list(simulation(**changed, **recording).evaluations())
    assert not lights(other)[-1].equal(lights(again)[-1])
    for a, b in zip(again, other, strict=True):
        assert (a.frame is None) == (b.frame is None) and (a.frame is None or a.frame.equal(b.frame))
    summary = run(validate(WORLD | SEES | recording, "lit"), tmp_path / "shadow", video=False, report=False, device="cpu").summary
    assert summary["shadow_of"] == str(folder)


NEEDS = {
    "probes": {"probes": {"eye": {"position_m": [20, 0, 1]}}},
    "judge_projections": toml("{ judge_projections = true, functions.flake = { kind = 'symbol', image = 'snowflake' } }"),
    "objects": {"objects": [CAR]},
    "detector.kind": {"detector": {"kind": "truth"}},
    "lighting.shadow_rays": {"lighting": {"shadow_rays": True}},
    "functions.stone": toml("{ functions.stone = { kind = 'material', lights = [{ materials = ['asphalt'], lx = 2.0 }] } }"),
}


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("key", NEEDS)
def test_what_needs_the_truth_is_refused_without_it(key):
    with sentence(f"lit: {key}: needs the truth, which the plant own:Blind does not know"):
        simulation(**NEEDS[key], plant=BLIND)


UNREACHABLE = toml("""
lit = { metric = "objects.parked.lx_max", at_least = 0.0 }
zone = { metric = "functions.near.luminance", at_least = 0.0 }
dark = { metric = "dark_lx_max", at_most = 0.0 }
flux = { metric = "lamp.left.flux_lm", at_least = 0.0 }
saved = { metric = "lamp.left.flux_lm", at_most = 0.5, compare = "full_light" }
""")


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(("plant", "refused"), [("Blind", ["lit", "zone", "dark", "saved"]), ("Knowing", ["saved"])])
def test_all_checks_that_a_plant_cannot_be_held_to_are_named_with_their_remedies(plant, refused):
    with refusal("checks.saved.compare: needs the simulated world") as error:
        simulation(checks=UNREACHABLE, plant={"kind": f"own:{plant}"}, objects=[CAR], detector={"kind": "own:Brightest"})
    assert [name for name in UNREACHABLE if f"--set checks.{name}={{}}" in str(error.value)] == refused
    assert len(str(error.value).splitlines()) == len(refused) + (len(refused) > 1)


def test_a_recording_of_other_exposures_or_of_held_symbols_is_refused(tmp_path):
    folder = tmp_path / "recorded"
    run(validate(WORLD | {"steps": 4}, "lit"), folder, frames=True, video=False, report=False, device="cpu")
    recording = {"plant": {"kind": "recording", "folder": str(folder)}, "steps": 4}
    with refusal(r"exposures of 33.33 ms, but those of this scenario take 20 ms"):
        simulation(**recording, rate_hz=50.0)
    with refusal("shows none of the symbols that are held here, flake, but none"):
        simulation(**recording, functions=toml("{ flake = { kind = 'symbol', image = 'snowflake', controller = 'luxloop' } }"))
    assert lights(list(simulation(**recording).evaluations()))[-1].equal(lights(list(simulation(steps=4).evaluations()))[-1])
