"""`luxloop run --rig` of a scenario with a digitised module, on a rig in a process of its own whose pictures are as bright as its light."""

import json
import socket
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.calibration.calibrate import Calibration, save
from luxloop.loop.rig.calibration.shots import linear_response
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.frames import image_file, read_image
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.truth import LampModule
from luxloop.world.lamps.presets import idealised
from tests.loop.conftest import assert_one_sentence
from tests.loop.rig.conftest import Process, free_port
from tests.loop.rig.live.walls import calibration, module, wall

PIXELS = 332 * 64
GIVEN = ("--no-report", "--no-video", "--set", "modules.left.source=digitised")


def of_lamp(lux: float | None = 100.0) -> Calibration:
    """Of a camera of 64 x 48 px and 8 bits that sees the whole lamp."""
    lamp: LampModule = module(idealised(332, 64))
    camera = wall(width_px=64, height_px=48, hfov_deg=40.0, yaw_deg=0.0).camera
    return replace(calibration(camera, lamp), response=linear_response(255), lux=lux)


def rig_file(process: Process, folder: Path, more: str = "") -> str:
    return process.file(folder, '[calibration]\nfile = "rig.npz"\n' + more)


def test_a_real_lamp_lights_the_simulated_world(small_rig, lux, tmp_path):
    save(tmp_path / "rig.npz", of_lamp())
    port = free_port(socket.SOCK_DGRAM)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as platform:
        platform.bind(("127.0.0.1", port))
        platform.settimeout(0.1)
        file = rig_file(small_rig(PIXELS), tmp_path, f'[platform]\nhost = "127.0.0.1"\nport = {port}\n')
        code, out, error = lux("run", "small.toml", "--rig", file, "--arm", "--frames", "--out", "runs/live", *GIVEN)
        assert code == 0, error
        poses = [json.loads(platform.recv(4096)) for _ in range(6)]
    assert [each["number"] for each in poses] == list(range(6)) and {each["pitch_deg"] for each in poses} == {0.0}
    assert "light to texture" in out and "6 of 6 exposures" in out and "sees 100.0% of its texels" in out
    told = json.loads((tmp_path / "runs/live/rig.json").read_text())
    assert told["armed"] and not told["lost"] and told["live"]["module"] == "left matrix"
    assert 20 < told["live"]["light_to_texture_ms"]["median"] < 300
    assert (tmp_path / "runs/live/beam.png").read_bytes().startswith(b"\x89PNG")
    summary = json.loads((tmp_path / "runs/live/summary.json").read_text())
    assert summary["frames"] == {"asked": 6, "came": 6, "unknown": 0}

    code, _, error = lux("replay", "runs/live")
    assert code == 2 and "modules.left: is digitised from a real lamp; run it with" in error
    code, _, error = lux("run", "runs/live", "--plant", "recording", "--out", "runs/again", "--no-report", "--no-video")
    assert code == 0, error


def test_the_night_is_as_bright_as_the_picture(small_rig, lux, tmp_path):
    """All pixels of the lamp on: 200 of 255 digital numbers more than in the dark, of which 255 are 100 lx; `I = E d^2 / cos`."""
    save(tmp_path / "rig.npz", of_lamp())
    keys = ("lighting.base={beam='full'}", "functions={}", "steps=2")
    given = ("--rig", rig_file(small_rig(PIXELS), tmp_path), "--out", "runs/live", *GIVEN, *keys, "--frames")
    code, _, error = lux("run", "small.toml", *given, "--arm")
    assert code == 0, error
    simulation = prepare(load("small.toml", [*GIVEN[3:], *keys]))
    plant, light = simulation.plant, simulation.modules[0].headlight
    y, z = light.tangents()
    cd = 200 / 255 * 100 * 5.95**2 * (1 + y**2 + z[:, None] ** 2) ** 1.5  # of a screen square to the lamp's axis
    u = torch.ones(light.n_pixels)
    plant.measured.keep(u, cd)
    wanted = plant.night.show((), Exposure(0, 0.0, 1 / 30, (Utilisation(u),)))[1].frames[0].image
    assert wanted is not None
    found = read_image(image_file(tmp_path / "runs/live", 0), simulation.scenario.camera, wanted)
    bright = wanted > 0.2 * wanted.max()
    assert float(found[bright].mean() / wanted[bright].mean()) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("more", "scale", "told"),
    [
        ("", None, "rig.npz: has no scale; run `luxloop rig calibrate` again with a reading of a luxmeter, --lux LUX@U,V"),
        ("[mark]\nu_px = 1\nv_px = 1\nwidth_px = 9\nheight_px = 9\n", 100.0, "mark: lies in the light that is digitised"),
    ],
)
def test_what_does_not_fit_is_told_in_a_sentence(small_rig, lux, tmp_path, more, scale, told):
    save(tmp_path / "rig.npz", of_lamp(scale))
    code, _, error = lux("run", "small.toml", "--rig", rig_file(small_rig(PIXELS), tmp_path, more), "--arm", "--out", "runs/live", *GIVEN)
    assert code == 2 and told in error and not (tmp_path / "runs/live").exists()
    assert_one_sentence(error)
