"""With a detector the loop is closed: frames are looked through, objects tracked, light planned from tracks, and all of it recorded."""

import json
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from luxloop import Detections, Simulation, run
from luxloop.loop.commands import cli
from luxloop.loop.recording.record import row
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.world import LitScene
from tests.loop.conftest import scenario_of, simulated, toml
from tests.refusal import sentence

CLOSED = """
name = "closed"
steps = 8
renderer = "raycast"
headlight.model = "hd84"
surface.grain = 0.0
detector.kind = "truth"
lighting.base.beam = "low"
functions = { object_light.kind = "object_based", guard.kind = "glare_free" }
camera = { width_px = 320, height_px = 180, pitch_deg = 1.5, oversampling = 1, saturation_e = 2000 }
[[objects]]
kind = "pedestrian"
name = "walker"
seed = 3
path = { points_m = [[15, -2, 0], [15, 2, 0]], speed_m_s = 1.4 }
[[objects]]
kind = "car"
name = "oncoming"
track = [{ position_m = [30, 3, 0], yaw_deg = 180 }]
"""
PARKED = {"kind": "car", "name": "parked", "category": None, "lit": False, "track": [{"position_m": [22, -5, 0]}]}  # seen, not reported
OBJECTS = [*toml(CLOSED)["objects"], PARKED]


def closed(*overrides: str, **changes: Any) -> Simulation:
    return simulated(CLOSED, *overrides, **{"objects": OBJECTS, **changes})


def results(*overrides: str, **changes: Any) -> list[StepResult]:
    return list(closed(*overrides, **changes).evaluations())


def test_everyone_is_found_tracked_placed_and_recorded(tmp_path):
    out = tmp_path / "run"
    summary = run(scenario_of(CLOSED, objects=OBJECTS), out, video=False).summary
    table = pq.read_table(out / "trajectory.parquet")
    confirmed = 2  # a track is reported after its third frame
    for name in ("walker", "oncoming", "parked"):
        track = table[f"objects.{name}.track"].to_pylist()
        assert track[:confirmed] == [None, None] and len(set(track[confirmed:])) == 1, name
        assert table[f"objects.{name}.confidence"].to_pylist() == [0.0] * confirmed + [1.0] * (8 - confirmed)
        assert table[f"objects.{name}.score"].to_pylist() == [1.0] * 8
        assert summary["objects"][name]["tracks"] == 1 and summary["objects"][name]["confidence_final"] == pytest.approx(6 / 8)
    assert table["false_positives"].to_pylist() == [0] * 8 and table["tracks"].to_pylist() == [0, 0, 3, 3, 3, 3, 3, 3]
    flux = sum(np.array(table[f"lamp.{side}.flux_lm"].to_pylist()) for side in ("left", "right"))
    power = np.array(table["power_w"].to_pylist())
    np.testing.assert_allclose(power, 2 * 5.0 + flux / 40.0)
    assert summary["energy_j"] == pytest.approx(power.sum() / 30)
    assert table["eyes_lx_max"].to_pylist()[0] > 0
    assert json.loads((out / "manifest.json").read_text())["scenario"]["detector"]["kind"] == "truth"
    assert cli.main(["replay", str(out)]) == cli.OK
    assert (out / "report.png").stat().st_size > 10_000


def test_masks_follow_tracks_and_darken_them():
    first, *_, last = results("steps=6", "lighting.base.beam=full", functions={"guard": {"kind": "glare_free"}})
    assert not first.masked and first.objects["oncoming"].lx_max > 1
    assert {name for name, each in last.objects.items() if each.masked} == {"oncoming", "parked"}
    assert last.objects["oncoming"].lx_mean < 0.1 * first.objects["oncoming"].lx_mean


def test_late_frames_make_tracks_late():
    late, in_time = results("camera.latency_steps=2", "steps=7"), results("steps=5")
    assert [each.frame is None for each in late] == [True, True] + [False] * 5
    assert [each.detections is not None and len(each.detections.tracks) for each in late] == [0, 0, 0, 0, 3, 3, 3]
    assert late[2].frame.equal(in_time[0].frame)  # no function has anything to do before a track is confirmed


def test_light_is_computed_once_however_late_its_frame_is_read(monkeypatch):
    computed, light = list[LitScene](), LitScene.light

    def counted(lit: LitScene, *given: Any) -> tuple[torch.Tensor, torch.Tensor]:
        if lit.view.height > 1:  # not of objects alone
            computed.append(lit)
        return light(lit, *given)

    monkeypatch.setattr(LitScene, "light", counted)
    *_, last = results("camera.latency_steps=3", "steps=6")
    assert last.frame is not None and len(computed) == 3  # the last three frames have not come


def test_a_track_is_predicted_where_frames_are_lost():
    *_, last = results("disturbances.drops=[{ from_step=4, until_step=6 }]", "steps=6")
    assert last.frame is None and len(last.detections.found) == 0 and len(last.detections.tracks) == 3
    made = last.detections.recognised["walker"]  # whose track goes on as he does: they still overlap
    assert made.track is not None and made.score == 0.0


@pytest.mark.parametrize("late", ["camera.latency_steps=1", "disturbances.drops=[{ until_step=1 }]"])
def test_what_no_frame_shows_is_recorded_as_unknown(late):
    lit = "functions.matter={ kind='material', lights=[{ materials=['asphalt'], lx=5.0 }], road_m=[5, 30] }"
    first, *_, last = map(row, results(late, lit, "steps=3", functions={}))
    assert first["functions.matter.asphalt.lx"] is None and last["functions.matter.asphalt.lx"] > 0
    assert "detections" not in first and "objects.walker.score" not in first and last["detections"] == 3


def test_tracks_are_where_objects_are():
    *_, last = results()
    true = {each.name: each for each in closed(detector=None).situation(last.time_s).objects}
    # A pixel of this camera's image is 0.6 m of the road at 15 m, and 1.9 m at 30 m; lengths are those of the class
    for name, length_m, most_m in (("walker", 0.5, 1.0), ("oncoming", 4.0, 3.0)):
        found = next(each for each in last.now.objects if each.name == f"track_{last.detections.recognised[name].track}")
        assert float((found.T_world_object[:2, 3] - true[name].T_world_object[:2, 3]).norm()) < most_m
        assert found.category == true[name].category and found.size_m[0] == length_m
        assert found.size_m[2] == pytest.approx(true[name].size_m[2], rel=0.15)


def test_a_state_taken_up_again_goes_on_as_the_run_did_and_a_time_has_its_lights():
    simulation = closed()
    state = simulation.start()
    for _ in range(5):
        before = state
        state, first = simulation.step(state)
    _, again = closed().step(before)
    for lights in (again.lights, simulation.lights_at(4 / 30)[0]):
        assert all(torch.equal(a, b) for a, b in zip(first.lights, lights, strict=True))
    assert first.step == 4 and torch.equal(first.frame, again.frame)


def test_a_base_beam_is_dimmed_as_functions_ask():
    half = toml("{ kind = 'object_based', method = 'constant', share = 0.5, setpoint_lx = 0.0 }")
    asked = ({}, {"half": half}, {"half": half, "most": half | {"share": 0.8}})
    bright, dim, both = (closed(objects=[], functions=functions).at(0) for functions in asked)
    for full, one, two in zip(bright.lights, dim.lights, both.lights, strict=True):
        torch.testing.assert_close(one, 0.5 * full)
        torch.testing.assert_close(two, 0.8 * full)  # the least dimmed wins


class Numpy:
    """A detector that gives arrays in place of tensors."""

    classes = ("car",)

    def __init__(self, device: torch.device) -> None: ...

    def detect(self, frames: torch.Tensor) -> list[Detections]:
        return [Detections(np.zeros((1, 4)), np.zeros((1, 1)))] * len(frames)  # type: ignore[arg-type]


def test_what_ones_own_detector_gives_wrong_ends_a_run_and_leaves_nothing(tmp_path):
    with sentence("detector.kind: ", "reading what detect gives", "AttributeError"):
        run(scenario_of(CLOSED, detector={"kind": f"{__name__}:Numpy"}, objects=[]), tmp_path / "runs" / "closed")
    assert not list(tmp_path.iterdir())
