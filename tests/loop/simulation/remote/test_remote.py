"""Another process as the plant: the loop's own world behind the protocol, and the game engine of the examples."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from luxloop import RunResult, run, validate
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import SMALL, toml
from tests.loop.simulation.remote.conftest import free_port

ROOT = Path(__file__).parents[4]
SIMULATOR = ROOT / "tests/loop/simulation/remote/simulator.py"
ENGINE = ROOT / "scenarios/examples/game_engine.py"
DRIVES: dict[str, Any] = {
    **SMALL,
    "steps": 4,
    "headlight": {"model": SMALL_LAMP},
    "functions": {
        "symbol": SMALL["functions"]["symbol"] | toml("{ controller.name = 'luxloop', modules = ['left'] }"),
        "dimmed": toml("{ kind = 'command', modules = ['right'], intensity = 0.5 }"),
        "patch": toml("{ kind = 'primitive', modules = ['right'], x_m = 20.0 }"),
    },
    "vehicle": toml("{ course = [{ speed_m_s = 10.0, curvature_1_m = 0.01 }] }"),
    "road": {"kind": "bumps"},
    "sensors": {"gyro": {"rate_hz": 100}},
    "camera": SMALL["camera"] | {"latency_spread_steps": 1, "drop_probability": 0.2},
}
MASKS: dict[str, Any] = {
    **SMALL,
    "steps": 5,
    "headlight": {"model": "ssl-hd-lores", "lamps": ["left"]},
    "lighting": {"base": {"beam": "full"}},
    "functions": toml("{ mask = { kind = 'glare_free', categories = ['pedestrian'], fade_out_s = 0.2 } }"),
}


@contextmanager
def process(program: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A program in a process of its own."""
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    started = subprocess.Popen([sys.executable, str(program), *arguments], env=env, stdout=subprocess.PIPE, text=True)
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def run_on(simulator: str, folder: Path, data: dict[str, Any], **plant: Any) -> RunResult:
    """A run on the test simulator. simulator: what it is told beside the address."""
    address = f"127.0.0.1:{free_port()}"
    scenario = validate({**data, "plant": {"kind": "remote", "address": address, "timeout_s": 60, **plant}}, "remote")
    with process(SIMULATOR, f"ws://{address}", *simulator.split()) as started:
        result = run(scenario, folder, frames=True, video=False, report=False, device="cpu")
        out, _ = started.communicate(timeout=20)
    assert json.loads(out.replace("'", '"')) == {"type": "end"}
    return result


def frames_in(folder: Path) -> dict[str, bytes]:
    """Of a recording, by the names of their files."""
    return {each.name: each.read_bytes() for each in (folder / "frames").glob("*.png")}


def commanded(table: pa.Table) -> dict[str, list[Any]]:
    """What the controller saw and asked for."""
    evaluated = ("iou", "ssim", "length", "shear", "centroid_error", "steady")
    names = [name for name in table.column_names if name.startswith(("functions.", "ego.")) and not any(each in name for each in evaluated)]
    return {name: table[name].to_pylist() for name in names}


@pytest.mark.slow
def test_a_run_on_another_process_is_the_same_bit_for_bit(tmp_path):
    remote = run_on("", tmp_path / "remote", DRIVES)
    here = run(validate(DRIVES, "here"), tmp_path / "here", frames=True, video=False, report=False, device="cpu")
    assert commanded(remote.trajectory) == commanded(here.trajectory)
    frames = frames_in(tmp_path / "here")
    assert frames and frames_in(tmp_path / "remote") == frames


@pytest.mark.slow
def test_objects_that_it_tells_of_are_masked_and_recorded_and_played_again(tmp_path):
    """A pedestrian is there for 0.1 s, and the mask fades out thereafter."""
    told = run_on("objects=0.1", tmp_path / "told", MASKS)
    flux = told.trajectory["lamp.left.flux_lm"].to_pylist()
    rows = pq.read_table(tmp_path / "told/frames/exposures.parquet")["objects"].to_pylist()
    (walker,), (last,) = json.loads(rows[0]), json.loads(rows[-1])
    assert (walker["name"], walker["until_s"], walker["T_ground_object"][3]) == ("walker", None, 30.0)
    assert 0.1 <= last["until_s"] < 0.14
    shadow = validate({**MASKS, "plant": {"kind": "recording", "folder": str(tmp_path / "told")}}, "shadow")
    again = run(shadow, tmp_path / "shadow", video=False, report=False, device="cpu")
    assert again.trajectory["lamp.left.flux_lm"].to_pylist() == flux and len(set(flux)) > 2


@pytest.mark.slow
def test_the_game_engine_of_the_examples_closes_the_loop(tmp_path):
    """It drives by its own, while its body pitches by 0.23 deg, which moves light at 17 m by a metre; a pixel is 11 cm there."""
    address = f"127.0.0.1:{free_port()}"
    camera = toml("{ width_px = 640, height_px = 360, bits = 8, gamma = 2.2 }")
    plant = {"kind": "remote", "address": address, "sends": "texture", "timeout_s": 60}
    scenario = validate({**SMALL, "steps": 16, "camera": camera, "plant": plant}, "engine")
    with process(ENGINE, f"ws://{address}") as engine:
        result = run(scenario, tmp_path / "run", video=False, report=False, device="cpu")
        run(scenario.model_copy(update={"steps": 1}), tmp_path / "once_more", video=False, report=False, device="cpu")
        engine.kill()
        out, _ = engine.communicate()
    assert out.splitlines() == ["the run is over"] * 2
    errors = {name: result.trajectory[f"functions.symbol.{name}"].to_pylist() for name in ("e_x", "e_y", "loss")}
    assert errors["loss"] == [""] * 16 and abs(errors["e_x"][0]) > 20
    assert all(abs(each) < 3 for name in ("e_x", "e_y") for each in errors[name][12:]), "px; it swings by 10 px"
