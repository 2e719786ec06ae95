"""What real signals, full disks and second processes do to the commands: nothing half-written, a clear last line, no lock left behind."""

import json
import os
import pty
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import optuna
import pyarrow.parquet as pq
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from loop.study import FINISHED, STUDY

ROOT = Path(__file__).parents[2]
SMALL = """
name = "small"
steps = 100_000
renderer = "raycast"
symbol.image = "snowflake"
surface.grain = 0.0
camera = { width_px = 320, height_px = 180 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With small.toml in it, which takes minutes."""
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


def start(folder: Path, *arguments: str, prepare: Callable[[], Any] | None = None, **more: Any) -> "subprocess.Popen[str]":
    """A command line in a folder."""

    def begin() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # ignored where tests run in the background
        if prepare is not None:
            prepare()

    command = [sys.executable, "-m", "loop.cli", *arguments]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, cwd=folder, env=env, text=True, preexec_fn=begin, **{"stderr": subprocess.PIPE, **more})


def ended(process: "subprocess.Popen[str]") -> tuple[int, str]:
    """Exit code and what was said on stderr."""
    _, said = process.communicate(timeout=120)
    return process.returncode, said


def wait_for(file: Path, process: "subprocess.Popen[str]") -> None:
    deadline = time.monotonic() + 120
    while not file.exists():
        assert time.monotonic() < deadline and process.poll() is None, process.communicate()
        time.sleep(0.02)


def status(out: Path) -> str:
    return str(json.loads((out / "manifest.json").read_text())["status"])


def half_written(folder: Path) -> list[Path]:
    return list(folder.rglob("*.part"))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_with_all_its_files(folder: Path, how: signal.Signals) -> None:
    """At a terminal, which shows what is still being done."""
    ours, theirs = pty.openpty()
    process = start(folder, "run", "small.toml", "--out", "out", stderr=theirs)
    os.close(theirs)
    wait_for(folder / "out" / "trajectory.parquet", process)
    while pq.read_table(folder / "out" / "trajectory.parquet").num_rows < 3:
        time.sleep(0.02)
    process.send_signal(how)
    said = b""
    try:
        while more := os.read(ours, 4096):
            said += more
    except OSError:  # the other end is closed
        pass
    assert process.wait(60) == 130
    steps = pq.read_table(folder / "out" / "trajectory.parquet").num_rows
    kept = re.search(r"interrupted: (\d+) of 100000 steps are kept in out", said.decode())
    assert kept and 0 <= steps - int(kept[1]) <= 1  # the last one may have been half a step
    assert "small: writing report and video" in said.decode()
    files = {"manifest.json", "trajectory.parquet", "summary.json", "report.png", "video.mp4"}
    assert {file.name for file in (folder / "out").iterdir()} == files
    assert status(folder / "out") == "interrupted"


@pytest.mark.parametrize(("largest", "option"), [("trajectory.parquet", "--no-video"), ("video.mp4", "--video")])
def test_a_file_that_cannot_grow_ends_a_run_as_failed(folder: Path, largest: str, option: str) -> None:
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (30_000, 30_000))  # a fifth more than the table of one step has
    code, said = ended(start(folder, "run", "small.toml", "--out", "out", option, prepare=limit))
    assert code == 2 and said.startswith(f"error: out/{largest}: cannot be written (") and "File too large" in said, said
    assert said.count("\n") == 1
    assert status(folder / "out") == "failed" and not half_written(folder)
    assert pq.read_table(folder / "out" / "trajectory.parquet").num_rows > 0


def test_a_full_disk_ends_a_run_as_failed(folder: Path) -> None:
    """A disk on which not one page is left."""
    (folder / "disk").mkdir()
    namespace = ["unshare", "-Urm", "sh", "-c"]
    if not shutil.which("unshare") or subprocess.run([*namespace, "mount -t tmpfs none disk"], cwd=folder, capture_output=True).returncode:
        pytest.skip("this system mounts no file systems for users")
    script = (
        "mount -t tmpfs -o size=200k none disk && { while [ ! -e disk/out/summary.json ] && [ ! -e disk/full ]; do sleep 0.05; "
        "[ -e disk/out/trajectory.parquet ] && cat /dev/zero > disk/full; done 2> /dev/null & } && "
        f"{sys.executable} -m loop.cli run small.toml --no-video --out disk/out; echo $? > code; cp -a disk/out seen"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    run = subprocess.run([*namespace, script], cwd=folder, env=env, capture_output=True, text=True, timeout=120)
    assert run.stderr == (
        "error: disk/out/trajectory.parquet: cannot be written (No space left on device); "
        "check the folder, its permissions and the room left\n"
    )
    assert (folder / "code").read_text() == "2\n"
    assert status(folder / "seen") == "failed" and not half_written(folder)
    assert pq.read_table(folder / "seen" / "trajectory.parquet").num_rows > 0


def test_one_run_has_a_folder_for_itself_until_it_is_killed(folder: Path) -> None:
    first = start(folder, "run", "small.toml", "--out", "out")
    wait_for(folder / "out" / "trajectory.parquet", first)
    code, said = ended(start(folder, "run", "small.toml", "--out", "out", "--steps", "1"))
    assert code == 2 and said == ("error: out: another process writes into it; wait until that ends, or give another folder with --out\n")
    assert first.poll() is None
    first.kill()
    first.communicate()
    assert status(folder / "out") == "running"
    code, said = ended(start(folder, "run", "small.toml", "--out", "out", "--steps", "1", "--no-video"))
    assert (code, said) == (0, "")
    assert status(folder / "out") == "complete" and not half_written(folder)


TUNE = ("tune", "small.toml", "--key", "controller.position.kp=0.1:2", "--objective", "iou", "--jobs", "1", "--out", "out")
QUICK = ("--set", "steps=3", "controller.name=thesis_pid")


def study(folder: Path) -> optuna.Study:
    storage = JournalStorage(JournalFileBackend(str(folder / "out" / STUDY)))
    return optuna.load_study(study_name="tune", storage=storage)


def test_two_tunes_share_the_trials_asked_for(folder: Path) -> None:
    both = [start(folder, *TUNE, "--trials", "9", *QUICK, stdout=subprocess.DEVNULL) for _ in range(2)]
    assert [ended(each)[0] for each in both] == [0, 0]
    trials = study(folder).trials
    assert [trial.state in FINISHED for trial in trials] == [True] * 9
    assert len({trial.params["controller.position.kp"] for trial in trials}) == 9
    assert "9 trials" in (folder / "out" / "report.md").read_text()


def test_a_tune_that_was_killed_goes_on_at_once(folder: Path) -> None:
    """From a journal that is locked, a trial that never ends and a line that was cut off."""
    killed = start(folder, *TUNE, "--trials", "1000", *QUICK)
    wait_for(folder / "out" / STUDY, killed)
    while (folder / "out" / STUDY).read_bytes().count(b"\n") < 12:
        time.sleep(0.02)
    code, said = ended(start(folder, "run", "small.toml", "--out", "out"))
    assert code == 2 and "another process writes into it" in said
    killed.kill()
    killed.communicate()
    (folder / "out" / f"{STUDY}.lock").unlink(missing_ok=True)
    (folder / "out" / f"{STUDY}.lock").symlink_to(STUDY)
    with (folder / "out" / STUDY).open("ab") as stream:
        stream.write(b'{"op_code":8,"worker')
    done = (folder / "out" / STUDY).read_bytes()
    code, said = ended(start(folder, *TUNE, "--trials", "12", *QUICK, stdout=subprocess.DEVNULL))
    assert code == 0 and " of 12 done before" in said
    assert (folder / "out" / STUDY).read_bytes().startswith(done[: done.rindex(b"\n") + 1])
    assert sum(trial.state in FINISHED for trial in study(folder).trials) >= 12
    assert not any(trial.state == TrialState.RUNNING for trial in study(folder).trials)


@pytest.mark.slow
def test_training_that_is_stopped_leaves_nothing_half_done(folder: Path) -> None:
    def train(epochs: str) -> "subprocess.Popen[str]":
        options = ("--out", "out", "--scenes", "2", "--held-out", "1", "--jobs", "1", "--epochs", epochs)
        return start(folder, "train-detector", *options, stdout=subprocess.DEVNULL)

    out = folder / "out"
    drawing = train("1000000")
    wait_for(out / "scenes.jsonl", drawing)
    drawing.send_signal(signal.SIGTERM)
    code, said = ended(drawing)
    assert code == 130 and re.search(r"interrupted: . of . scenes [a-z ]+ are kept in out/scenes.jsonl, the same command goes on", said)
    for how in (signal.SIGINT, signal.SIGKILL):
        training = train("1000000")
        while (out / "scenes.jsonl").read_bytes().count(b"\n") < 3:
            time.sleep(0.02)
        time.sleep(15)  # until it trains
        assert "out: another process writes into it" in ended(train("1"))[1]
        training.send_signal(how)
        code, said = ended(training)
        if how == signal.SIGINT:
            assert code == 130 and said.endswith("interrupted: all scenes are kept in out, the same command trains from its start\n")
        assert {file.name for file in out.iterdir()} == {"scenes.jsonl", "scenes"} and not half_written(out)
    before = {file: file.stat().st_mtime_ns for file in (out / "scenes").iterdir()}
    assert len(before) == 3
    assert ended(train("1"))[0] == 0
    assert (out / "detector.pt").exists() and (out / "report.json").exists() and not half_written(out)
    assert {file: file.stat().st_mtime_ns for file in (out / "scenes").iterdir()} == before
