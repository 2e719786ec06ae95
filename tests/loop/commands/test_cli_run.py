"""`luxloop run` and `luxloop replay`: what is written, what differs, and what is kept of a run that was interrupted or has failed."""

import json
import re
from pathlib import Path

import av
import pandas as pd
import pytest

from luxloop import LuxloopError, Simulation
from tests.loop.conftest import FILE

FILES = {"manifest.json", "trajectory.parquet", "summary.json", "report.png", "video.mp4"}


def test_run_replay_and_what_differs(lux, tmp_path):
    code, out, error = lux("run", "small.toml", "--steps", "4", "--seed", "7", "--set", "camera.bits=8", "camera.gamma=2.2")
    assert (code, error) == (0, "")
    folder = tmp_path / "runs" / "small"
    assert {path.name for path in folder.iterdir()} == FILES
    for part in ("settle step", "centroid error", "IoU", "overshoot", "lost steps", "ms", "runs/small"):
        assert part in out
    manifest = json.loads((folder / "manifest.json").read_text())
    assert (manifest["seed"], manifest["scenario"]["steps"], manifest["scenario"]["camera"]["bits"]) == (7, 4, 8)
    summary = json.loads((folder / "summary.json").read_text())["functions"]["symbol"]
    assert summary["iou_open"] == pytest.approx(1, abs=0.01)  # a flat road needs no control
    with av.open(str(folder / "video.mp4")) as video:
        assert video.streams.video[0].frames == 4

    code, out, _ = lux("replay", "runs/small")
    assert code == 0 and "4 steps agree" in out
    code, out, _ = lux("replay", "runs/small", "--csv", "steps.csv")
    assert code == 0 and "agree" not in out
    assert list(pd.read_csv("steps.csv")["step"]) == [0, 1, 2, 3]

    code, out, _ = lux("report", "runs/small")
    assert code == 0 and out == "runs/small/report.pdf written\n" and (folder / "report.pdf").read_bytes().startswith(b"%PDF")
    assert lux("report", "runs/small", "--out", "page.svg")[0] == 0 and "</svg>" in (tmp_path / "page.svg").read_text()
    code, _, error = lux("report", "runs/small", "--out", "page.doc")
    assert code == 2 and "page.doc" in error and ".pdf" in error and not (tmp_path / "page.doc").exists()

    manifest["scenario"]["functions"]["symbol"]["start"]["x_m"] = 18.5
    (folder / "manifest.json").write_text(json.dumps(manifest))
    code, out, _ = lux("replay", "runs/small", "--compare")
    assert code == 1
    assert "edited" in out and re.search(r"x_m +0 +18 +18.5 ", out)
    assert lux("run", "small.toml", "--steps", "1", "--no-video", "--no-report")[0] == 0
    assert not [*folder.glob("report.*")], "the page of the run before goes with it"


def test_controller_starts_with_its_defaults_and_set_comes_on_top(lux, tmp_path):
    (tmp_path / "small.toml").write_text(FILE.replace('"luxloop"', '{ name = "thesis_pid", x_rate_m = 0.1 }'))
    arguments = ["run", "small.toml", "--no-video", "--steps", "1", "--out", "a"]
    assert lux(*arguments, "--controller", "thesis_pid", "--set", "functions.symbol.controller.y_rate_m=0.2")[0] == 0
    controller = json.loads((tmp_path / "a" / "manifest.json").read_text())["scenario"]["functions"]["symbol"]["controller"]
    assert (controller["x_rate_m"], controller["y_rate_m"]) == (1.5, 0.2)
    assert {path.name for path in (tmp_path / "a").iterdir()} == FILES - {"video.mp4"}


def test_interrupt_keeps_the_steps_that_were_done(lux, tmp_path, monkeypatch):
    steps = Simulation.run

    def run(simulation: Simulation):  # type: ignore[no-untyped-def]
        for result in steps(simulation):
            if result.step == 2:
                raise KeyboardInterrupt
            yield result

    monkeypatch.setattr(Simulation, "run", run)
    code, _, error = lux("run", "small.toml")
    assert code == 130
    assert error == "interrupted: 2 of 3 steps are kept in runs/small\n"
    folder = tmp_path / "runs" / "small"
    assert {path.name for path in folder.iterdir()} == FILES
    assert json.loads((folder / "manifest.json").read_text())["status"] == "interrupted"
    assert len(pd.read_parquet(folder / "trajectory.parquet")) == 2


def test_interrupt_before_the_first_step(lux, monkeypatch):
    def prepare(*_: object) -> Simulation:
        raise KeyboardInterrupt

    monkeypatch.setattr("luxloop.loop.run.prepare", prepare)
    assert lux("run", "small.toml") == (130, "", "interrupted: nothing was recorded\n")
    assert not Path("runs").exists()


def test_failure_in_the_midst_keeps_the_steps_and_says_why(lux, tmp_path, monkeypatch):
    steps = Simulation.run

    def run(simulation: Simulation):  # type: ignore[no-untyped-def]
        yield next(steps(simulation))
        raise LuxloopError("the lamp is broken; correct it")

    monkeypatch.setattr(Simulation, "run", run)
    assert lux("run", "small.toml", "--no-video") == (2, "", "error: the lamp is broken; correct it\n")
    assert len(pd.read_parquet(tmp_path / "runs" / "small" / "trajectory.parquet")) == 1


def test_probes_of_the_command_line_become_columns(lux, tmp_path):
    arguments = ["run", "small.toml", "--steps", "1", "--no-video", "--no-report"]
    assert lux(*arguments, "--probe", "eye=20,0.5,1.1", "--probe", "edge=18,-1.7,0.25")[0] == 0
    table = pd.read_parquet(tmp_path / "runs" / "small" / "trajectory.parquet")
    assert {"probes.eye.lx", "probes.edge.lx"} <= set(table.columns) and table["probes.edge.lx"].notna().all()
    for wrong in ("eye=20,0.5", "a.b=1,2,3", "=1,2,3", "eye=1,2,three"):
        code, _, error = lux(*arguments, "--probe", wrong)
        assert code == 2 and f"--probe {wrong}:" in error
