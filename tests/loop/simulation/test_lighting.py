"""Scenarios run, are recorded as they went, and replay."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

from luxloop.loop.commands import cli
from luxloop.loop.recording.record import schema
from luxloop.loop.report.page import lit_part
from luxloop.loop.report.picture import camera_luminance, white_of
from luxloop.loop.report.views import BIRDSEYE_X_M, BIRDSEYE_Y_M
from luxloop.loop.run import run
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.camera import noise_std
from luxloop.world.errors import LuxloopError
from luxloop.world.lamps import archive
from luxloop.world.lamps.presets import lamp

BOX = {
    "kind": "box",
    "name": "van",
    "category": "car",
    "size_m": [4.5, 1.8, 1.9],
    "track": [{"time_s": 0, "position_m": [40, 3, 0], "yaw_deg": 180}, {"time_s": 1, "position_m": [30, 3, 0], "yaw_deg": 180}],
}
CAMERA = {"width_px": 160, "height_px": 90}
GLARE_FREE = {"kind": "glare_free"}
SYMBOL = {"kind": "symbol", "image": "snowflake"}


def scenario(**changes: Any) -> Scenario:
    base = {
        "name": "lit",
        "steps": 3,
        "rate_hz": 5,
        "headlight": {"model": "hd84"},
        "camera": CAMERA,
        "surface": {"grain": 0.0},
        "objects": [BOX],
        "lighting": {"base": {"beam": "high"}},
        "functions": {"guard": GLARE_FREE},
        "renderer": "raycast",
    }
    return validate(base | changes, "lit")


def test_objects_on_a_road_are_seen_and_tracked_at_its_height() -> None:
    """On 5 % from 10 m on after a curve of 4 m, 40 m ahead is 1.4 m up, and the van sinks by 0.5 m on its way of 10 m."""
    road = {"kind": "grade", "grade_percent": 5.0, "crossfall_percent": 0.0, "start_x_m": 10.0}
    simulation = Simulation.prepare(scenario(road=road, objects=[BOX | {"on_road": True}]))
    assert not torch.equal(simulation.world.scene.at(0.0).placed[1].T_world_body, simulation.world.scene.at(1.0).placed[1].T_world_body)
    for t_s, height_m in ((0.0, 1.4), (1.0, 0.9)):
        (van,) = simulation.situation(t_s).objects
        foot = simulation.world.scene.at(t_s).placed[1].corners[..., 2].min()
        assert float(van.T_world_object[2, 3]) == pytest.approx(height_m, abs=1e-9) == float(foot)
    (sunk,) = Simulation.prepare(scenario(road=road)).situation(0.0).objects
    assert float(sunk.T_world_object[2, 3]) == 0


def test_a_run_is_recorded_filmed_and_reported(tmp_path: Path) -> None:
    out = tmp_path / "lit"
    steps: list[int] = []
    summary = run(scenario(), out, on_step=lambda result: steps.append(result.step)).summary
    assert {path.name for path in out.iterdir()} == {"manifest.json", "trajectory.parquet", "summary.json", "report.png", "video.mp4"}
    assert steps == [0, 1, 2] and summary == json.loads((out / "summary.json").read_text())
    table = pq.read_table(out / "trajectory.parquet")
    assert table.num_rows == 3 and table["objects.van.masked"].to_pylist() == [True] * 3
    assert table["dark_lx_max"].to_pylist() == [0.0] * 3 and table["objects.van.pixels"][0].as_py() > 20
    assert table["lamp.left.flux_lm"][0].as_py() > 50 and table["lamp.left.power_factor"].to_pylist() == [1.0] * 3
    assert json.loads((out / "manifest.json").read_text())["status"] == "complete"


def test_pictures_have_the_cameras_noise_and_measured_light_has_none() -> None:
    noisy, other, still = (Simulation.prepare(scenario(**each)) for each in ({}, {"seed": 1}, {"camera": {**CAMERA, "noise": False}}))
    result, camera = noisy.at(1), noisy.scenario.camera
    assert torch.equal(result.luminance, other.at(1).luminance) and torch.equal(result.illuminance, other.at(1).illuminance)
    image, exact = camera_luminance(result, noisy), result.luminance
    assert torch.equal(image, camera_luminance(result, noisy)) and not torch.equal(image, camera_luminance(other.at(1), other))
    lit = (exact > 0.03) & (exact < 0.8)  # ten standard deviations of the read noise from black, and as far from saturation
    z = ((image - exact) / noise_std(exact, camera))[lit]
    assert len(z) > 1000 and float(z.mean()) == pytest.approx(0, abs=5 / len(z) ** 0.5)  # five standard errors, as the next
    assert float(z.std()) == pytest.approx(1, abs=5 / (2 * len(z)) ** 0.5)
    level = 1.34 / (2**camera.bits - 1)  # cd/m^2
    torch.testing.assert_close(camera_luminance(still.at(1), still)[lit], exact[lit], rtol=0, atol=0.51 * level)


def test_the_road_from_above_is_cut_to_its_light() -> None:
    light = np.zeros((400, 1060))  # texels of 10 cm from 20 m left and -6 m ahead on
    light[150:251, 160:361] = 0.2
    (x0, x1), (y0, y1) = lit_part(light)
    assert (x0, x1, y0, y1) == pytest.approx((10 - 2, 30 + 2, -5 - 2, 5 + 2), abs=0.1)  # 2 m around it
    assert lit_part(np.zeros((400, 1060))) == (BIRDSEYE_X_M, BIRDSEYE_Y_M)


def test_a_report_of_one_step_in_the_dark_without_objects(tmp_path: Path) -> None:
    run(scenario(steps=1, objects=[], lighting={"base": {"beam": "off"}}), tmp_path / "dark", video=False)
    image = cv2.imread(str(tmp_path / "dark" / "report.png"))
    assert image.shape[1] > 1000 and float(image.std()) > 10


def test_functions_without_effect_are_told(tmp_path: Path) -> None:
    far = {"kind": "symbol", "image": "snowflake", "y_m": 60.0}  # beside all light
    late = {"kind": "glare_free", "categories": ["truck"]}
    told = run(
        scenario(steps=1, functions={"guard": GLARE_FREE, "far": far, "late": late}), tmp_path / "lit", video=False, report=False
    ).summary
    assert told["idle_functions"] == ["functions.far (symbol)", "functions.late (glare_free)"]


def test_pictures_of_light_beyond_the_camera_are_white_and_not_black() -> None:
    simulation = Simulation.prepare(scenario())
    saturation = 1000 / (0.015 * 50_000)  # cd/m^2, of the camera's defaults
    bright, dim = (replace(simulation.at(0), luminance=torch.full((9, 16), each)) for each in (25.0, 0.2))
    assert float(white_of(bright, simulation)) == pytest.approx(saturation)
    assert float(white_of(dim, simulation)) == pytest.approx(0.3)  # half as much again as the scene


def test_the_recording_replays_and_a_changed_one_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "lit"
    run(scenario(steps=2), out, video=False, report=False)
    assert cli.main(["replay", str(out)]) == cli.OK
    assert cli.main(["replay", str(out), "--csv", str(tmp_path / "lit.csv")]) == cli.OK
    assert "objects.van.lx_max" in (tmp_path / "lit.csv").read_text()
    table = pq.read_table(out / "trajectory.parquet")
    names = table.column_names
    brighter = table.set_column(names.index("dark_lx_max"), table.schema.field("dark_lx_max"), [[0.001, 0.0]])
    pq.write_table(brighter, out / "trajectory.parquet")
    assert cli.main(["replay", str(out)]) == cli.DIFFERS
    assert "dark_lx_max" in capsys.readouterr().out


def test_what_is_interrupted_is_kept(tmp_path: Path) -> None:
    def stop(result: Any) -> None:
        if result.step == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(scenario(), tmp_path / "lit", video=False, on_step=stop)
    assert pq.read_table(tmp_path / "lit" / "trajectory.parquet").num_rows == 2
    assert json.loads((tmp_path / "lit" / "manifest.json").read_text())["status"] == "interrupted"
    assert (tmp_path / "lit" / "report.png").stat().st_size > 10_000


def test_the_command_line_lists_and_checks(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list"]) == cli.OK
    listed = capsys.readouterr().out
    assert "glare_free" in listed and "thesis_pid" in listed
    assert cli.main(["check", "gfhb", "--set", "headlight.model=hd84", "renderer=raycast"]) == cli.OK
    assert "high beam, functions guard_traffic (glare_free), 5 objects, no detector" in capsys.readouterr().out
    assert cli.main(["check", "zones", "--set", "detector.kind=truth", "renderer=raycast"]) == cli.OK
    assert (
        "low beam, functions black_cloth (zone), concrete (zone), crossing (zone), white_plaster (zone), 3 objects, detector truth ("
        in capsys.readouterr().out
    )


def test_light_on_an_object_is_that_of_the_law_of_distances() -> None:
    """An upright plate far ahead, in the full beam of one lamp: E = I / d^2 within what its extent makes of it."""
    plate = BOX | {"name": "plate", "size_m": [0.02, 0.2, 0.2], "track": [{"position_m": [20, 0, 0.65]}]}
    simulation = Simulation.prepare(
        scenario(
            headlight={"model": "hd84", "lamps": ["left"], "distance_m": 0.0},
            objects=[plate],
            lighting={"base": {"beam": "full"}},
            functions={},
            camera={"width_px": 320, "height_px": 180, "hfov_deg": 3, "pitch_deg": 1.7},
        )
    )
    light = simulation.at(0).objects["plate"]
    module = simulation.modules[0]
    ahead = module.headlight.intensity(module.headlight.light_texture(torch.ones(84)), torch.tensor([[1.0], [0.0], [0.0]]))
    assert light.pixels > 50 and not light.masked
    assert light.lx_mean == pytest.approx(float(ahead) / 19.99**2, rel=0.05)  # the beam's slope over 0.6 deg
    assert light.lx_min <= light.lx_mean <= light.lx_max


def test_an_object_appears_to_the_tracker_when_it_does_in_the_scene() -> None:
    simulation = Simulation.prepare(scenario(objects=[BOX | {"appears_s": 0.3, "vanishes_s": 0.5}], steps=4))
    results = list(simulation.run())
    assert [result.objects["van"].pixels > 0 for result in results] == [False, False, True, False]
    assert [result.objects["van"].masked for result in results] == [False, False, True, False]
    assert results[0].dark_lx_max is None


def test_what_stands_still_is_rendered_once() -> None:
    simulation = Simulation.prepare(scenario(objects=[]))
    assert simulation.world.lit(0.0) is simulation.world.lit(5.0)
    torch.testing.assert_close(simulation.at(0).illuminance, simulation.at(2).illuminance)


def test_conditions_hold_until_the_next() -> None:
    timeline = scenario(conditions=[{"time_s": 1, "wet": True}, {"time_s": 3, "street_lit": True}])
    assert [timeline.conditions_at(time_s).wet for time_s in (0.0, 1.0, 2.9, 3.0, 9.0)] == [True, True, True, False, False]


WRONG = {
    "module": ({"functions": {"own": {"kind": "lane", "modules": ["hires"]}}}, ["functions.own.modules", "'hires'", "left"]),
    "object": ({"functions": {"own": GLARE_FREE | {"names": ["bus"]}}}, ["functions.own.names", "'bus'", "van"]),
    "image": ({"functions": {"guard": GLARE_FREE, "sign": SYMBOL | {"image": "snowflak"}}}, ["functions.sign.image", "'snowflake'"]),
    "image file": ({"functions": {"own": SYMBOL | {"image": "/no.png"}}}, ["functions.own.image", "/no.png"]),
    "observer": ({"functions": {"own": SYMBOL | {"observer": {"name": "x"}}}}, ["functions.own.observer.name", "'x'", "van"]),
    "when": ({"functions": {"own": SYMBOL | {"when": {"names": ["x"]}}}}, ["functions.own.when.names", "'x'", "van"]),
    "unless": ({"functions": {"own": SYMBOL | {"unless": {"names": ["x"]}}}}, ["functions.own.unless.names", "'x'", "van"]),
    "picture": ({"functions": {"own": SYMBOL | {"observer": {"centre_m": [10, 0, 2]}}}}, ["functions.own: ", "lower the picture"]),
    "lamp": ({"headlight": {"model": "hd84", "modules": ["lores"]}}, ["headlight.modules", "'hd84'", "'lores'", "matrix"]),
    "movement": ({"headlight": {"model": "hd84", "swivel_deg": 5.0}}, ["headlight.swivel_deg", "matrix", "can turn"]),
    "beam of the lamp's modules": ({"headlight": {"model": "hd84", "modules": ["hires"]}}, ["'hires'", "matrix"]),
}


@pytest.mark.parametrize(("changes", "named"), WRONG.values(), ids=WRONG.keys())
def test_what_is_not_there_is_named_in_a_sentence(changes: dict[str, Any], named: list[str]) -> None:
    with pytest.raises(LuxloopError) as caught:
        Simulation.prepare(scenario(**changes))
    assert all(part in str(caught.value) for part in named), caught.value


@pytest.mark.parametrize(("beam", "lacking"), [("auto", "motorway"), ("high", "high")])
def test_every_beam_that_may_come_is_asked_for_beforehand(tmp_path: Path, beam: str, lacking: str) -> None:
    """Not on the motorway, after minutes of town."""
    hd84 = lamp("hd84")
    archive.save(tmp_path / "own.npz", replace(hd84, beams={name: hd84.beam("full") for name in ("low", "town", "adverse")}))
    with pytest.raises(LuxloopError, match=f"no beam '{lacking}'; it has low, town"):
        Simulation.prepare(scenario(headlight={"model": str(tmp_path / "own.npz")}, lighting={"base": {"beam": beam}}))


def test_columns_are_described() -> None:
    for field in schema(Simulation.prepare(scenario())):
        assert field.metadata[b"description"], field.name


def test_what_waits_for_the_indicator_is_dark_and_not_called_idle(tmp_path: Path) -> None:
    carpet = {"kind": "lane", "indicated": "left"}
    waits = run(scenario(functions={"carpet": carpet}), tmp_path / "waits", report=False, video=False)
    assert waits.summary["idle_functions"] == []
    lights = {
        each: Simulation.prepare(scenario(functions={"carpet": carpet}, lighting={"indicator": each})).lights_at(0.0)[0]
        for each in ("off", "left", "right", "hazard")
    }
    assert not any(bool(u.any()) for side in ("off", "right") for u in lights[side])
    assert any(bool(u.any()) for u in lights["left"])
    assert all(torch.equal(a, b) for a, b in zip(lights["left"], lights["hazard"], strict=True))
