"""What real signals, full disks and second processes do to the commands: nothing half-written, a clear last line, no lock left behind."""

import json
import multiprocessing
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
from pathlib import Path

import optuna
import pyarrow.parquet as pq
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from luxloop.loop.commands import cli
from luxloop.loop.studies.tune import FINISHED, STUDY

ROOT = Path(__file__).parents[3]
SMALL = """
name = "small"
steps = 100_000
renderer = "raycast"
camera = { width_px = 160, height_px = 90, oversampling = 1 }
headlight = { model = "hd84", lamps = ["left"] }
functions.symbol = { kind = "symbol", image = "snowflake", width_m = 4.0, length_m = 8.0, controller = "luxloop" }
"""
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    ["luxloop.loop.commands.cli", "luxloop.loop.commands.runs", "luxloop.loop.simulation.simulation", "luxloop.loop.studies.tune"]
)  # imported once for all processes: seconds


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With small.toml in it, which takes hours."""
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


class Command:
    """A command line at work in a folder, in a process of its own."""

    def __init__(self, folder: Path, *arguments: str, terminal: str | None = None, largest_file: int = resource.RLIM_INFINITY) -> None:
        self.stderr = terminal or str(folder / f"{time.monotonic_ns()}.txt")
        self.process = FORKS.Process(target=begin, args=(folder, arguments, self.stderr, largest_file), daemon=True)
        self.process.start()

    def send(self, how: signal.Signals) -> None:
        assert self.process.pid and self.process.is_alive()
        os.kill(self.process.pid, how)

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for something that it does."""
        deadline = time.monotonic() + 120
        while not condition():
            assert time.monotonic() < deadline and self.process.is_alive(), Path(self.stderr).read_text()
            time.sleep(0.02)

    def ended(self) -> tuple[int | None, str]:
        """Exit code and what was said on stderr."""
        self.process.join(120)
        return self.process.exitcode, Path(self.stderr).read_text()


def begin(folder: Path, arguments: tuple[str, ...], stderr: str, largest_file: int) -> None:
    os.chdir(folder)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(stderr, os.O_WRONLY | os.O_CREAT), 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
    sys.exit(cli.main(arguments))


def steps_kept(out: Path) -> int:
    file = out / "trajectory.parquet"
    return pq.read_metadata(file).num_rows if file.exists() else 0  # in one reading: a run replaces the file


def status(out: Path) -> str:
    return str(json.loads((out / "manifest.json").read_text())["status"])


def half_written(folder: Path) -> list[Path]:
    return list(folder.rglob("*.part"))


@pytest.mark.parametrize("how", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_a_signal_ends_a_run_with_all_its_files(folder, how):
    """At a terminal, which shows what is still being done."""
    ours, theirs = pty.openpty()
    run = Command(folder, "run", "small.toml", "--out", "out", terminal=os.ttyname(theirs))
    run.until(lambda: steps_kept(folder / "out") > 2)
    os.close(theirs)
    run.send(how)
    said = b""
    try:
        while more := os.read(ours, 4096):
            said += more
    except OSError:  # the other end is closed
        pass
    run.process.join(60)
    assert run.process.exitcode == 130
    kept = re.search(r"interrupted: (\d+) of 100000 steps are kept in out", said.decode())
    assert kept and 0 <= steps_kept(folder / "out") - int(kept[1]) <= 1  # the last one may have been half a step
    assert "small: writing report and video" in said.decode()
    files = {"manifest.json", "trajectory.parquet", "summary.json", "report.png", "video.mp4"}
    assert {file.name for file in (folder / "out").iterdir()} == files
    assert status(folder / "out") == "interrupted"


@pytest.mark.parametrize(
    ("largest", "room", "options"),
    [
        ("trajectory.parquet", 28_200, ["--no-video"]),  # the table of one step has some 27 500 bytes, and each further step 200
        pytest.param("video.mp4", 30_000, ["--video", "--set", "camera.width_px=320", "camera.height_px=180"], marks=pytest.mark.slow),
    ],
)
def test_a_file_that_cannot_grow_ends_a_run_as_failed(folder, largest, room, options):
    code, said = Command(folder, "run", "small.toml", "--out", "out", *options, largest_file=room).ended()
    last = said.splitlines()[-1]
    assert code == 2 and last.startswith(f"error: out/{largest}: cannot be written (File too large)"), said
    assert said.count("error") == 1
    assert status(folder / "out") == "failed" and not half_written(folder)
    assert steps_kept(folder / "out") > 0


def test_a_frame_that_has_no_room_ends_a_run_as_failed(folder):
    options = ["--no-video", "--frames", "--set", "camera.width_px=640", "camera.height_px=360"]  # frames of 280 000 bytes
    code, said = Command(folder, "run", "small.toml", "--out", "out", *options, largest_file=60_000).ended()
    error = "error: out/frames/frame_00000000.png: cannot be written (File too large); check the folder, its permissions and the room left"
    assert code == 2 and said.splitlines()[-1] == error, said
    assert said.count("error") == 1 and status(folder / "out") == "failed" and not half_written(folder)


def test_a_full_disk_ends_a_run_as_failed(folder):
    """A disk on which not one page is left."""
    (folder / "disk").mkdir()
    namespace = ["unshare", "-Urm", "sh", "-c"]
    if not shutil.which("unshare") or subprocess.run([*namespace, "mount -t tmpfs none disk"], cwd=folder, capture_output=True).returncode:
        pytest.skip("this system mounts no file systems for users")
    script = (
        "mount -t tmpfs -o size=200k none disk && { while [ ! -e disk/out/summary.json ] && [ ! -e disk/full ]; do sleep 0.05; "
        "[ -e disk/out/trajectory.parquet ] && cat /dev/zero > disk/full; done 2> /dev/null & } && "
        f"{sys.executable} -m luxloop.loop.commands.cli run small.toml --no-video --out disk/out; echo $? > code; cp -a disk/out seen"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    run = subprocess.run([*namespace, script], cwd=folder, env=env, capture_output=True, text=True, timeout=120)
    assert run.stderr == (
        "error: disk/out/trajectory.parquet: cannot be written (No space left on device); "
        "check the folder, its permissions and the room left\n"
    )
    assert (folder / "code").read_text() == "2\n"
    assert status(folder / "seen") == "failed" and not half_written(folder)
    assert steps_kept(folder / "seen") > 0


def test_one_run_has_a_folder_for_itself_until_it_is_killed(folder):
    first = Command(folder, "run", "small.toml", "--out", "out")
    first.until((folder / "out" / "trajectory.parquet").exists)
    code, said = Command(folder, "run", "small.toml", "--out", "out", "--steps", "1").ended()
    assert code == 2 and said == ("error: out: another process writes into it; wait until that ends, or give another folder with --out\n")
    first.send(signal.SIGKILL)
    first.ended()
    assert status(folder / "out") == "running"
    code, said = Command(folder, "run", "small.toml", "--out", "out", "--steps", "1", "--no-video").ended()
    assert (code, said) == (0, "")
    assert status(folder / "out") == "complete" and not half_written(folder)


TUNE = ("tune", "small.toml", "--key", "functions.symbol.controller.position.kp=0.1:2", "--objective", "iou", "--jobs", "1", "--out", "out")
QUICK = ("--set", "steps=3", "functions.symbol.controller.name=thesis_pid")


def study(folder: Path) -> optuna.Study:
    storage = JournalStorage(JournalFileBackend(str(folder / "out" / STUDY)))
    return optuna.load_study(study_name="tune", storage=storage)


@pytest.mark.slow
def test_two_tunes_share_the_trials_asked_for(folder):
    both = [Command(folder, *TUNE, "--trials", "5", *QUICK) for _ in range(2)]
    assert [each.ended()[0] for each in both] == [0, 0]
    trials = study(folder).trials
    assert [trial.state in FINISHED for trial in trials] == [True] * 5
    assert len({trial.params["functions.symbol.controller.position.kp"] for trial in trials}) == 5
    assert "5 trials" in (folder / "out" / "report.md").read_text()


@pytest.mark.slow
def test_a_tune_that_was_killed_goes_on_at_once(folder):
    """From a journal that is locked, a trial that never ends and a line that was cut off."""
    journal = folder / "out" / STUDY
    killed = Command(folder, *TUNE, "--trials", "1000", *QUICK)
    killed.until(lambda: journal.exists() and journal.read_bytes().count(b"\n") >= 12)
    code, said = Command(folder, "run", "small.toml", "--out", "out").ended()
    assert code == 2 and "another process writes into it" in said
    killed.send(signal.SIGKILL)
    killed.ended()
    (folder / "out" / f"{STUDY}.lock").unlink(missing_ok=True)
    (folder / "out" / f"{STUDY}.lock").symlink_to(STUDY)
    with journal.open("ab") as stream:
        stream.write(b'{"op_code":8,"worker')
    done = journal.read_bytes()
    code, said = Command(folder, *TUNE, "--trials", "6", *QUICK).ended()
    assert code == 0 and " of 6 already done" in said
    assert journal.read_bytes().startswith(done[: done.rindex(b"\n") + 1])
    assert sum(trial.state in FINISHED for trial in study(folder).trials) >= 6
    assert not any(trial.state == TrialState.RUNNING for trial in study(folder).trials)


@pytest.mark.slow
def test_training_that_is_stopped_leaves_nothing_half_done(folder):
    out, rows = folder / "out", folder / "out" / "scenes.jsonl"

    def train(epochs: str) -> Command:
        options = ("--out", "out", "--scenes", "2", "--held-out", "1", "--jobs", "1", "--wide", "0", "--epochs", epochs)
        return Command(folder, "train-detector", *options)

    drawing = train("1000000")
    drawing.until(rows.exists)
    drawing.send(signal.SIGTERM)
    code, said = drawing.ended()
    assert code == 130 and re.search(r"interrupted: . of . scenes [a-z ]+ are kept in out/scenes.jsonl, the same command goes on", said)
    for how in (signal.SIGINT, signal.SIGKILL):
        training = train("1000000")
        training.until(lambda: rows.read_bytes().count(b"\n") == 3)
        time.sleep(5)  # until it trains
        assert "out: another process writes into it" in train("1").ended()[1]
        training.send(how)
        code, said = training.ended()
        if how == signal.SIGINT:
            assert code == 130 and said.endswith("all scenes are stored in out, the same command trains from its start\n"), said
        assert {file.name for file in out.iterdir()} == {"scenes.jsonl", "scenes"} and not half_written(out)
    before = {file: file.stat().st_mtime_ns for file in (out / "scenes").iterdir()}
    assert len(before) == 3
    assert train("1").ended()[0] == 0
    assert (out / "detector.pt").exists() and (out / "report.json").exists() and not half_written(out)
    assert {file: file.stat().st_mtime_ns for file in (out / "scenes").iterdir()} == before
