"""The job runner: parallel, resumable wherever it is stopped, honest about failures."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from luxloop import LuxloopError
from luxloop.loop.studies.jobs import Job, Results, local, run
from tests.refusal import refusal

ROOT = Path(__file__).parents[3]
SCRIPT = """
import signal, sys, time
from pathlib import Path
from luxloop.loop.studies.jobs import local
from luxloop.loop.studies.jobs import Job, run

def slow(x, log):
    with open(log, "a") as stream:
        stream.write(f"{x}\\n")
    time.sleep(0.1 if x < 3 else 60 if len(sys.argv) > 1 else 0)
    return {"square": x * x}

if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as the command line does
    here = Path(__file__).parent
    todo = [Job(f"job {x}", {"x": x, "log": str(here / "log")}) for x in range(6)]
    print([row["square"] for row in run(slow, todo, here / "results.jsonl", version="1", executor=local(2)).rows])
"""


def square(x: int, log: str | None = None) -> dict[str, Any]:
    if log is not None:
        with open(log, "a") as stream:
            stream.write(f"{x}\n")
    if x < 0:
        raise ValueError(f"{x} is negative")
    return {"square": x * x, "list": [x, x]}


def refuse(x: int) -> dict[str, Any]:
    raise LuxloopError("give another x")


def unwritable(x: int) -> dict[str, Any]:
    return {"object": object()}


def die(x: int) -> dict[str, Any]:
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def about(process_id: bool) -> dict[str, Any]:
    return {"pid": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


def numbers(*xs: int, **more: Any) -> list[Job]:
    return [Job(f"x {x}", {"x": x, **more}) for x in xs]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """What is really done, a line each."""
    return tmp_path / "log"


@pytest.fixture
def done(log: Path, tmp_path: Path) -> Callable[..., Results]:
    """Squares of numbers, kept in a file."""

    def done(*xs: int, version: str = "1", file: Path = tmp_path / "r.jsonl") -> Results:
        return run(square, numbers(*xs, log=str(log)), file, version=version, executor=local(1))

    return done


def squares(results: Results) -> list[int]:
    return [row["square"] for row in results.rows]


def test_results_come_in_the_order_of_jobs_with_their_parameters(done, log, tmp_path):
    results = done(3, 1, 2, file=tmp_path / "new" / "r.jsonl")
    assert results.rows == [{"key": f"x {x}", "x": x, "log": str(log), "square": x * x, "list": [x, x]} for x in (3, 1, 2)]
    assert results.failures == {}


def test_what_is_done_is_not_done_again(done, log, capsys):
    for xs in ((1, 2), (1, 2, 3), (3, 3, 2)):
        assert squares(done(*xs)) == [x * x for x in xs]
    assert log.read_text().split() == ["1", "2", "3"]
    assert "2 of 3 already done" in capsys.readouterr().err


def test_other_versions_and_parameters_are_done_anew_and_old_results_stay(done, log):
    for version, x in (("1", 1), ("2", 1), ("2", 5), ("1", 1)):
        assert squares(done(x, version=version)) == [x * x]
    assert log.read_text().split() == ["1", "1", "5"]


def test_failures_are_collected_and_tried_again(done, log, tmp_path):
    for _ in range(2):
        results = done(1, -1, 2)
        assert [row["x"] for row in results.rows] == [1, 2] and list(results.failures) == ["x -1"]
        assert results.failures["x -1"].startswith("ValueError: -1 is negative (test_jobs.py, line ")
    assert log.read_text().split() == ["1", "-1", "2", "-1"]
    refused, unwritten = (run(each, numbers(1), tmp_path / "r.jsonl", version="1").failures for each in (refuse, unwritable))
    assert refused == {"x 1": "give another x"} and "not JSON serializable" in unwritten["x 1"]


def test_processes_have_one_thread_and_their_failures_come_back(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    both = [Job(str(value), {"process_id": value}) for value in (True, False)]
    rows = run(about, both, tmp_path / "r.jsonl", version="1", executor=local(2)).rows
    assert all(row["pid"] != os.getpid() and row["threads"] == "1" for row in rows)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    with refusal(r"worker process was killed.*0 of 2 jobs are kept.*the first that are not done: x 1; x 2"):
        run(die, numbers(1, 2), tmp_path / "r.jsonl", version="1", executor=local(2))


@pytest.mark.parametrize(
    ("how", "workers_too"),
    [
        (signal.SIGINT, True),
        (signal.SIGTERM, False),
        (signal.SIGKILL, False),
        pytest.param(signal.SIGKILL, True, marks=pytest.mark.slow),
    ],
)
def test_a_run_that_is_stopped_goes_on_where_it_was(how, workers_too, tmp_path):
    """Terminals and service managers send a signal to workers, too; `kill` and `timeout` do not."""
    script, log, file = tmp_path / "script.py", tmp_path / "log", tmp_path / "results.jsonl"
    script.write_text(SCRIPT)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    # Where the tests run in the background, the shell lets them ignore Ctrl-C; a run at a terminal does not.
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    command = [sys.executable, script, "hang"]
    stopped = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=heard)
    deadline = time.monotonic() + 60
    while len(file.read_text().splitlines() if file.exists() else []) < 3 or len(log.read_text().split()) < 5:
        assert time.monotonic() < deadline and stopped.poll() is None
        time.sleep(0.02)
    (os.killpg if workers_too else os.kill)(stopped.pid, how)
    _, said = stopped.communicate(timeout=50)  # far less than the minute that a hanging job takes
    assert stopped.returncode != 0
    while alive(stopped.pid):  # far less than the minute as well
        assert time.monotonic() < deadline
        time.sleep(0.02)
    if how != signal.SIGKILL:
        assert "3 of 6 jobs are kept" in said
    assert len(file.read_text().splitlines()) == 3
    resumed = subprocess.run([sys.executable, script], env=env, capture_output=True, text=True, timeout=60)
    assert resumed.stdout == "[0, 1, 4, 9, 16, 25]\n", resumed.stderr
    started = log.read_text().split()
    assert all(started.count(x) == 1 for x in "012")
    assert all(x in started[5:] for x in "345")


def alive(group: int) -> bool:
    """Whether any process of a group is."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_line_cut_off_by_a_kill_is_done_again(done, tmp_path):
    file = tmp_path / "r.jsonl"
    done(1, 2)
    whole = file.read_bytes()
    for end in range(len(whole) - 1, whole.index(b"\n"), -7):
        file.write_bytes(whole[:end])
        assert squares(done(1, 2)) == [1, 4] and file.read_bytes() == whole


@pytest.mark.parametrize(
    "junk", [b"\0" * 40, b'{"id": "ab\0\0\n', b"\xff\xfe\n", b'{"key": 1}\n', b'{"id": "a", "result": 5}\n', b"[", b"\n"]
)
def test_junk_in_the_last_line_costs_that_line(junk, done, log, tmp_path):
    file = tmp_path / "r.jsonl"
    done(1, 2)
    whole = file.read_bytes()
    for content, again in ((whole + junk, 0), (whole[: whole.index(b"\n") + 1] + junk, 1)):
        file.write_bytes(content)
        log.write_text("")
        assert squares(done(1, 2)) == [1, 4]
        assert file.read_bytes() == whole and len(log.read_text().split()) == again


@pytest.mark.parametrize("content", [b"notes\n", b'{"a": 1}\n', b"[1]\n", b"a file of mine"])
def test_files_of_another_kind_are_left_alone(content, done, tmp_path):
    file = tmp_path / "mine.txt"
    file.write_bytes(content)
    with refusal(r"mine\.txt: holds something other than job results"):
        done(1, file=file)
    assert file.read_bytes() == content


def test_folders_that_cannot_be_written_are_said_so(tmp_path):
    (tmp_path / "file").write_text("")
    with refusal("cannot be"):
        run(square, numbers(1), tmp_path / "file" / "r.jsonl", version="1", executor=local(1))


def test_parquet(tmp_path):
    file = tmp_path / "r.parquet"
    run(square, numbers(1, 2), tmp_path / "r.jsonl", version="1", executor=local(1)).write(file)
    assert pq.read_table(file).to_pylist() == [{"key": f"x {x}", "x": x, "square": x * x, "list": [x, x]} for x in (1, 2)]
    with refusal("cannot be written"):
        Results([{"a": 1}], {}).write(file / "r.parquet")
    with refusal("results make no table"):
        Results([{"a": 1}, {"a": "one"}], {}).write(file)
