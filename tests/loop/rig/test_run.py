"""`luxloop run --rig`: a scenario on a rig process, from the command line."""

import json
import signal
import subprocess
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from luxloop.loop.commands.rig import write_timing
from luxloop.loop.rig.camera import Camera
from luxloop.loop.rig.cameras import opener
from luxloop.loop.rig.rectification import grey
from luxloop.loop.scenario.model import load
from luxloop.loop.simulation.frames import image_file, read_light, twin_file
from luxloop.loop.simulation.lamps import lamp_modules, mount
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.simulated import simulated_plant
from luxloop.world.arrays import read_parquet
from tests.loop.conftest import assert_one_sentence
from tests.loop.rig.conftest import ENVIRONMENT, FILE, PROGRAM, eventually
from tests.refusal import refusal

PIXELS = 332 * 64
PASSWORD = "Tr0ub4dor"
SECRET = f"http://someone:{PASSWORD}@127.0.0.1:{{camera}}/camera?pwd={PASSWORD}"


def test_a_scenario_runs_on_a_rig_and_is_recorded_with_its_twin(small_rig, lux, tmp_path):
    process, folder = small_rig(PIXELS, width=320, height=180), tmp_path / "runs/rig"
    given = ("--rig", process.file(tmp_path, url=SECRET), "--arm", "--out", "runs/rig", "--set", "camera.bits=8", "--no-video", "--twin")
    code, out, error = lux("run", "small.toml", *given)
    assert code == 0, error
    for words in ("control rate", "light to frame", "the rig's own camera", "6 of 6 exposures", "twin, on frames", "twin, off frames"):
        assert words in out
    told = json.loads((folder / "rig.json").read_text())
    assert told["armed"] and not told["lost"] and told["rig"]["light"]["kind"] == "ddp"
    assert 20 < told["light_to_frame_ms"]["median"] < 150 and 1 < told["control_rate_hz"] < 20
    assert told["rig"]["camera"]["url"] == f"http://***@127.0.0.1:{process.camera}/camera?pwd=***"
    assert not [file for file in folder.rglob("*") if file.is_file() and PASSWORD.encode() in file.read_bytes()]
    assert json.loads((folder / "summary.json").read_text())["frames"] == {"asked": 6, "came": 6, "unknown": 0}

    rows = read_parquet(folder / "twin.parquet").to_pylist()
    assert told["twin"]["exposures"] == 6 and [row["number"] for row in rows] == list(range(6)) and (folder / "twin.png").is_file()
    for row in rows:  # figures are those of the frames that are kept, and these are the simulated plant's
        rig, simulated = (cv2.imread(str(each(folder, row["number"])), -1).astype(float) for each in (image_file, twin_file))
        assert row["mae"] == pytest.approx(np.abs(rig - simulated).mean())
        assert row["rmse"] == pytest.approx(np.sqrt(np.square(rig - simulated).mean()))
        assert (row["mean_rig"], row["mean_simulated"]) == pytest.approx((rig.mean(), simulated.mean()))
        assert -1 <= row["ssim"] <= 1
    assert told["twin"]["on"]["mean_simulated"] > told["twin"]["off"]["mean_simulated"]
    scenario = load("small.toml", overrides=["camera.bits=8", "camera.noise=false"])
    modules = lamp_modules(mount(scenario.headlight))
    light = read_light(folder / "frames/light_00000000.npz", [each.headlight.n_pixels for each in modules], torch.device("cpu"))[0]
    shown = simulated_plant(scenario, modules).show((), Exposure(0, 0.0, 1 / scenario.rate_hz / 2, light))[1].frames[0].image
    assert shown is not None and np.array_equal(shown[:, :].numpy(), cv2.imread(str(twin_file(folder, 0)), -1))

    code, _, error = lux("run", "small.toml", "--plant", "runs/rig", "--out", "runs/again", "--set", "camera.bits=8", "--no-report")
    assert code == 0, error
    code, _, error = lux("replay", "runs/rig")
    assert code == 2 and "no rig is connected" in error
    code, out, _ = lux("run", "small.toml", *given[:2], "--out", "runs/rig", "--set", "camera.bits=8", "--no-report", "--no-video")
    assert code == 0 and "dry run: the lamp stays dark" in out and not json.loads((folder / "rig.json").read_text())["armed"]
    assert not list(folder.glob("**/*twin*"))


@pytest.mark.parametrize("death", ["light goes to another port", "killed in mid-run"])
def test_a_run_on_a_dead_rig_fails_and_is_kept(small_rig, lux, tmp_path, death):
    process = small_rig(PIXELS, width=320, height=180)
    if death == "killed in mid-run":
        frames = tmp_path / "runs/rig/frames"
        threading.Thread(target=lambda: eventually(lambda: len(list(frames.glob("*.png"))) > 4, 60) and process.kill()).start()
    else:
        process.light = 9
    file = process.file(tmp_path, "wait_s = 0.2\n", SECRET)
    given = ("--rig", file, "--arm", "--out", "runs/rig", "--set", "camera.bits=8", "--steps", "20", "--frames", "--no-report")
    code, out, error = lux("run", "small.toml", *given, "--no-video")
    told = json.loads((tmp_path / "runs/rig/rig.json").read_text())
    came = 40 - sum(told["lost"].values())
    assert code == 2 and f"{file}: frames of only {came} of 40 exposures came" in error
    assert_one_sentence(error)
    assert PASSWORD not in out + error
    if metrics := told["judged"].get("symbol"):
        assert f"at step {metrics['exposure'] // 2}," in out and metrics["exposure"] <= 40 - told["silent"]


def test_a_rig_check_fails_where_the_pictures_do_not_fit(small_rig, lux, tmp_path):
    code, out, error = lux("rig", "check", small_rig(PIXELS).file(tmp_path), "--scenario", "small.toml")  # 64 x 48 px
    assert code == 2 and "64 x 48 px at" in out and "64 x 48 px, where" in error
    assert_one_sentence(error)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "small.toml", "--rig", "rig.toml", "--twin"), "give --rig FILE and --arm as well"),
        (("run", "small.toml", "--rig", "rig.toml", "--plant", "runs/a"), "give one of the two"),
        (("run", "small.toml", "--set", "plant.kind=rig"), "no rig is connected; run it with `luxloop run NAME --rig FILE`"),
        (("run", "small.toml", "--rig", "rig.toml", "--arm"), "Connection refused"),
    ],
)
def test_what_cannot_run_says_so(lux, tmp_path, monkeypatch, arguments, words):
    monkeypatch.setattr("luxloop.loop.rig.rig.await_camera.__defaults__", (0.5,))
    Path("rig.toml").write_text(FILE.format(light=4048, url="http://127.0.0.1:9/camera"))
    code, _, error = lux(*arguments)
    assert code == 2 and words in error
    assert_one_sentence(error)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("kind", "url"),
    [
        ("http", f"http://a:{PASSWORD}/@#x@host/"),
        ("http", f"https://a:{PASSWORD}{70 * 'x'}@host/"),
        ("stream", f"rtsp://a:{PASSWORD}@127.0.0.1:9/"),
    ],
)
def test_no_message_tells_a_password(lux, monkeypatch, kind, url):
    monkeypatch.setattr("luxloop.loop.rig.rig.await_camera.__defaults__", (0.5,))
    Path("rig.toml").write_text(FILE.format(light=4048, url=url).replace("http", kind, 1))
    code, out, error = lux("rig", "check", "rig.toml", "--scenario", "small.toml")
    assert code == 2 and "camera" in error and PASSWORD not in out + error


@pytest.mark.parametrize(
    "wrong", ["[light]\nx = 1\n  [timing]\nwait_s = 2\n", "timing = { wait_s = 2 }\n[light]\nx = 1\n", "timing.wait_s = 2\n"]
)
def test_values_are_put_into_a_table_timing_or_nowhere(tmp_path, wrong):
    file = tmp_path / "rig.toml"
    file.write_text("[timing]  # mine\nwait_s = 2\njitter_s = 0.5  # measured\n\n[light]\nx = 1\n")
    write_timing(file, {"latency_s": 0.03, "jitter_s": 0.02})
    assert file.read_text() == "[timing]  # mine\nlatency_s = 0.03\nwait_s = 2\njitter_s = 0.02\n\n[light]\nx = 1\n"
    file.write_text(wrong)
    with refusal(r"timing: is not written as a table"):
        write_timing(file, {"latency_s": 0.03})
    assert file.read_text() == wrong


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGHUP])
def test_a_loop_that_ends_leaves_the_lamp_dark(end, small_rig, lux, tmp_path):
    """A killed loop by the lamp's own time-out of 0.1 s; one whose terminal closes by dark packets, which a lamp without it needs."""
    process = small_rig(PIXELS, width=320, height=180, dark_s=60.0 if end == signal.SIGHUP else 0.1)
    command = [*PROGRAM, "run", "small.toml", "--rig", process.file(tmp_path), "--arm", "--steps", "2000"]
    loop = subprocess.Popen(command, cwd=tmp_path, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    camera = Camera(opener(process.params().camera), 1.0)

    def lit() -> bool:
        picture = camera.next(time.monotonic() + 0.5)
        return picture is not None and bool(grey(picture.data)[0, :8].any())

    try:
        assert eventually(lit, 60)
        loop.send_signal(end)
        killed_s = time.monotonic()
        camera.forget()
        assert eventually(lambda: not lit(), 5)
        # With a period and the latency of the camera, by which it sees it; Python ends a step before it answers a signal.
        assert time.monotonic() - killed_s < (0.2 + 0.05 if end == signal.SIGKILL else 3)
    finally:
        loop.kill()
        camera.close()
