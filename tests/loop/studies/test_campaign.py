"""Campaigns: a file becomes a table, a run is done once, failures are rows, and Dask's workers do the same as this machine's."""

import json
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import luxloop
from luxloop.loop.commands import cli
from luxloop.loop.studies import campaign, jobs
from luxloop.loop.studies.campaign import JOBS, TABLE, TRAJECTORIES, read, run_campaign
from luxloop.loop.studies.campaign_report import page, write_report
from luxloop.loop.studies.jobs import Results, dask, local
from luxloop.loop.studies.runs import figures
from tests.loop.conftest import assert_refused
from tests.refusal import refusal

ROOT = Path(__file__).parents[3]
SMALL = """
[set]
steps = 3
headlight.model = "hd84"
camera = { width_px = 160, height_px = 90, oversampling = 1 }
functions.symbol = { width_m = 4.0, length_m = 8.0 }
"""

HELD = 'functions.symbol = { kind = "symbol", image = "chevrons", controller = "thesis_pid" }\n'


def written(folder: Path, text: str, name: str = "night.toml") -> Path:
    file = folder / name
    file.write_text(text + SMALL)
    return file


def test_a_grid_and_a_list_become_runs_with_their_scenarios(tmp_path):
    (tmp_path / "mine.toml").write_text(f'name = "m"\n{HELD}')
    runs = read(
        written(
            tmp_path,
            'scenarios = ["snowflake", "mine.toml"]\ncontrollers = ["open", "thesis_pid"]\nseeds = [4, 5]\n'
            'variants.soon = {}\nvariants.late.camera.latency_steps = 2\nruns = [{ scenario = "chevrons", seed = 9 }]\n',
        )
    )
    assert len(runs) == 17
    assert len({run.key for run in runs}) == 17
    assert runs[-1].key == "chevrons, thesis_pid, seed 9"
    late = next(run for run in runs if run.key == "mine, open, late, seed 5")
    assert (late.scenario.camera.latency_steps, late.scenario.seed, late.scenario.steps) == (2, 5, 3)
    assert next(run for run in runs if run.key == "mine, open, soon, seed 5").scenario.camera.latency_steps == 0


DRAWN = """
scenarios = ["flat"]
controllers = ["open", "thesis_pid"]
seeds = [0, 1, 2]
draw.functions.symbol.start.x_m = "14.0:20.0"
draw.camera.read_noise_e = [1.0, 2.0]
"""


def test_a_seed_draws_the_same_world_for_all_controllers(tmp_path):
    runs = read(written(tmp_path, DRAWN))
    starts = {(run.row["controller"], run.params.seed): run.scenario.functions["symbol"].start.x_m for run in runs}
    assert all(starts["open", seed] == starts["thesis_pid", seed] for seed in range(3))
    assert len({*starts.values()}) == 3 and all(14.0 <= each <= 20.0 for each in starts.values())
    assert all(run.scenario.camera.read_noise_e == run.row["draw.camera.read_noise_e"] in (1.0, 2.0) for run in runs)
    without = read(written(tmp_path, DRAWN.replace("draw.camera.read_noise_e = [1.0, 2.0]", "")))
    assert [run.drawn["functions.symbol.start.x_m"] for run in without] == [run.drawn["functions.symbol.start.x_m"] for run in runs]


def test_a_controller_may_come_with_its_keys_and_a_label(tmp_path):
    tables = '["thesis_pid", { name = "thesis_pid", label = "slow", x_rate_m = 0.5 }]'
    fast, slow = read(written(tmp_path, f'scenarios = ["flat"]\ncontrollers = {tables}\n'))
    assert [fast.row["controller"], slow.row["controller"]] == ["thesis_pid", "slow"]
    assert (fast.scenario.symbol.controller.x_rate_m, slow.scenario.symbol.controller.x_rate_m) == (1.5, 0.5)


def test_steps_and_comparisons_of_drawn_worlds_are_written(tmp_path):
    file = written(tmp_path, DRAWN + "trajectories = true\n")
    found = luxloop.campaign(file, tmp_path / "out", jobs=1)
    assert not found.failures
    steps = pq.read_table(tmp_path / "out" / TRAJECTORIES)
    assert steps.num_rows == 6 * 3 and set(steps["controller"].to_pylist()) == {"open", "thesis_pid"}
    for row in found.rows:
        mine = steps.filter((pc.field("controller") == row["controller"]) & (pc.field("seed") == row["seed"]))
        assert mine["iou"].to_numpy().mean() == pytest.approx(row["iou_mean"]) == row["functions.symbol.iou_mean"]
    assert (tmp_path / "out" / "responses.png").stat().st_size > 5_000
    text = (tmp_path / "out" / "report.md").read_text()
    assert "| IoU, at the last step | flat | thesis_pid | open | 3 |" in text and "## Limits" in text


def test_a_failed_run_counts_in_the_mean():
    rows = [{"scenario": "a", "controller": "c", "variant": "", "seed": k, "steps": 10, "error": ""} for k in range(2)]
    rows[0] |= {"iou_mean": 0.8, "settle_step": 4}
    rows[1] |= {"error": "lost"}
    text = page("it", Results(rows, {"a, c, seed 1": "lost"}))
    (line,) = (each for each in text.splitlines() if each.startswith("| a |"))
    assert [each.strip() for each in line.split("|")[4:9]] == ["2", "1", "1 of 2", "7 [4, 10] (10)", "0.4 [0, 0.8] (0)"]


def test_controllers_of_ones_own_are_found_beside_the_campaign(tmp_path):
    (tmp_path / "beside_it.py").write_text("")
    (run,) = read(written(tmp_path, 'scenarios = ["flat"]\ncontrollers = ["beside_it:Law"]\n'), allow_code=True)
    assert run.scenario.symbol.controller is not None and run.scenario.symbol.controller.name == f"{tmp_path}/beside_it:Law"


@pytest.mark.parametrize(("name", "said"), [("absent_law:Law", "No module named 'absent_law'"), ("law_here:Low", "did you mean 'Law'")])
def test_a_controller_that_is_not_there_is_refused_before_the_first_run(name, said, tmp_path):
    (tmp_path / "law_here.py").write_text("class Law: ...\n")
    file = written(tmp_path, f'scenarios = ["flat"]\ncontrollers = ["thesis_pid", "{name}"]\n')
    with refusal(rf"night\.toml: functions\.symbol\.controller\.name: .*{said}"):
        run_campaign(file, tmp_path / "out", executor=local(1), allow_code=True)
    assert not (tmp_path / "out").exists()


def test_the_example_is_what_the_docs_show():
    example = ROOT / "scenarios" / "examples" / "night.toml"
    assert len(read(example)) == 17
    (shown,) = re.findall(r"^```\n(scenarios.*?)^```", (ROOT / "docs" / "campaigns.md").read_text(), re.M | re.S)
    assert tomllib.loads(shown) == tomllib.loads(example.read_text())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "names no runs"),
        ('scenarios = ["snowflak"]', "did you mean 'snowflake'"),
        ('scenario = ["snowflake"]', "unknown key; did you mean 'scenarios'"),
        ('scenarios = ["snowflake"]\nvariants.a.camera.bit = 8', r"variants\.a: .*camera.bit: unknown key; did you mean 'bits'"),
        ('runs = [{ scenario = "snowflake", variant = "b" }]', "there is no variant 'b'"),
        (f'scenarios = ["flat"]\nseeds = {list(range(100_001))}', "names 100,001 runs, more than 100,000; split it"),
        ('scenarios = ["nul\\u0000"]', "a text has a NUL character"),
        ('scenarios = ["flat"]\nseeds = [-1]', r"seeds\[0\]: -1 should be greater than or equal to 0"),
        ('scenarios = ["flat"]\ndraw.camera.read_noise_e = 3.0', r"draw\.camera\.read_noise_e: 3\.0 is neither a range nor a list"),
        ('scenarios = ["flat"]\ncontrollers = [{ label = "a" }]', "controllers: a table lacks the name"),
        ('scenarios = ["flat"]\ncontrollers = ["open", { name = "open" }]', "two have the same name or label"),
        ('scenarios = ["flat"]\ndraw.camera.read_nois_e = "1:2"', r"draw .*read_nois_e"),
        ('scenarios = ["flat", "./flat.toml"]', "two different runs are both called 'flat, thesis_pid, seed 0'"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_sentence(text, said, tmp_path):
    (tmp_path / "flat.toml").write_text(f'name = "mine"\n{HELD}')
    with refusal(rf"night\.toml.*{said}"):
        read(written(tmp_path, text))


def test_all_errors_of_a_file_and_of_a_scenario_are_listed(tmp_path):
    with refusal(r"night\.toml: 3 errors\n  runs\[0\]\.seed: .*\n  scenario: .*\n  seeds\[0\]: ") as caught:
        read(written(tmp_path, 'scenario = ["flat"]\nseeds = [-1]\nruns = [{ scenario = "flat", seed = 2026-01-01 }]'))
    assert len(caught.value.args) == 4
    with refusal(r"night\.toml: variants\.wet: .*flat\.toml with these changes: 2 errors\n  camera\.bit: .*\n  steps: "):
        read(written(tmp_path, 'scenarios = ["flat"]\nvariants.wet = { camera.bit = 8, steps = 0 }'))


def test_table_report_and_failures(tmp_path, monkeypatch):
    # Light that comes down behind the camera's sight is found only when the run begins.
    file = written(
        tmp_path,
        'scenarios = ["flat"]\ncontrollers = ["open", "thesis_pid"]\nvariants.here = {}\nvariants.off.functions.symbol.y_m = 15.0\n',
    )
    out = tmp_path / "out"
    found = run_campaign(file, out, executor=local(1))
    assert [row["variant"] for row in found.rows] == ["here", "off"] * 2
    assert list(found.failures) == ["flat, open, off, seed 0", "flat, thesis_pid, off, seed 0"]
    assert "outside of the camera's view" in found.rows[1]["error"]
    table = pq.read_table(out / TABLE).to_pylist()
    assert table == found.rows
    assert table[0]["iou_final"] == table[0]["iou_open"] and table[1]["iou_final"] is None
    write_report("night", found, out)
    text = (out / "report.md").read_text()
    assert text == page("night", found)
    assert "4 runs, 2 failed" in text and "- flat, open, off, seed 0: flat: functions.symbol: the target" in text
    assert (out / "report.png").stat().st_size > 5_000

    started = []
    original = jobs._call
    monkeypatch.setattr(jobs, "_call", lambda function, task: (started.append(task), original(function, task))[1])
    assert run_campaign(file, out, executor=local(1)) == found
    assert len(started) == 2  # those that failed
    monkeypatch.setattr(campaign, "digest_of_code", lambda: "other code")
    run_campaign(file, out, executor=local(1))
    assert len(started) == 2 + 4


def test_a_campaign_whose_runs_all_fail_says_why(lux, tmp_path):
    fails = "def __init__(self, *given):\n        raise ValueError('no gain')\n    start = projection = step = __init__\n"
    (tmp_path / "wrong.py").write_text(f"class Controller:\n    {fails}")
    file = written(tmp_path, 'scenarios = ["flat"]\ncontrollers = ["wrong:Controller"]\n')
    code, out, error = lux("campaign", str(file), "--jobs", "1", "--out", "new/folder", "--allow-code")
    assert code == cli.DIFFERS
    for said in (out + error, Path("new/folder/report.md").read_text()):
        assert "no gain" in said
    assert pq.read_table(tmp_path / "new" / "folder" / TABLE).num_rows == 1


def test_runs_that_differ_in_numbers_are_done_together(tmp_path, capsys):
    file = written(
        tmp_path,
        'scenarios = ["flat"]\ncontrollers = ["thesis_pid"]\nseeds = [0, 1]\n'
        "variants.soon = {}\nvariants.late.camera.latency_steps = 1\nvariants.lit.lighting.base.beam = 'low'\n",
    )
    found = run_campaign(file, tmp_path / "out", executor=local(1))
    assert "6 of 6 runs in batches of up to 2" in capsys.readouterr().err
    assert [key for key in found.failures if "lit" not in key] == [] and len(found.failures) == 2, "each has its own reason"
    assert all("cannot be distinguished" in why for why in found.failures.values())
    for run, row in zip(read(file), found.rows, strict=True):
        if run.params.variant == "lit":
            continue
        expected = figures(run.scenario, "cpu")
        for key in ("iou_final", "residual_percent", "flux_lm_mean", "lamps.left.power_share_max", "utilisation_mean"):
            assert row[key] == pytest.approx(expected[key], rel=1e-3, abs=1e-3)
    again = run_campaign(file, tmp_path / "out", executor=local(1))
    assert again.rows == found.rows and "2 of 2 runs" in capsys.readouterr().err, "what failed is tried again, and nothing else"


def test_files_of_others_stay(lux, tmp_path):
    file = str(written(tmp_path, 'scenarios = ["flat"]\n'))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    assert_refused(lux("campaign", file, "--jobs", "1", "--out", "mine"), "mine: holds files that are no campaign", "--out")
    assert [each.name for each in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_command(lux, tmp_path):
    file = str(written(tmp_path, 'scenarios = ["flat"]\n'))
    assert lux("campaign", file, "--jobs", "1")[0] == 0 and (tmp_path / "runs" / "night" / TABLE).exists()
    for wrong, words in (
        ("--jobs 0", "for --jobs; must be >= 1"),
        ("--jobs 2 --scheduler tcp://x:1", "one of the two"),
        ("--scheduler nonsense://x", "no answer"),
    ):
        code, _, error = lux("campaign", file, *wrong.split())
        assert code == cli.WRONG and words in error


@pytest.mark.slow
def test_patterns_of_light_are_compared(tmp_path, monkeypatch, capsys):
    text = (ROOT / "scenarios" / "examples" / "patterns.toml").read_text("utf-8").replace("seeds = [0, 1]", "seeds = [0]")
    small = 'steps = 6\nrenderer = "raycast"\ndetector.kind = "truth"\ncamera = { width_px = 320, height_px = 180, oversampling = 1 }\n'
    (tmp_path / "patterns.toml").write_text(f"{text}[set]\n{small}")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["campaign", "patterns.toml", "--jobs", "1", "--device", "cpu"]) == cli.OK
    rows = {row["variant"]: row for row in pq.read_table(tmp_path / "runs" / "patterns" / TABLE).to_pylist()}
    assert list(rows) == ["even", "stripes", "checks"]
    for row in rows.values():
        assert row["confidence_final_min"] <= row["confidence_final_mean"] <= 1.0
        assert row["flux_lm_mean"] == pytest.approx(row["lamps.left.flux_lm_mean"] + row["lamps.right.flux_lm_mean"])
        assert row["flux_lm_mean"] <= rows["even"]["flux_lm_mean"]  # a half is dark, and the base beam the same for who is always sure
    assert rows["stripes"]["flux_lm_mean"] < 0.98 * rows["even"]["flux_lm_mean"]
    told = capsys.readouterr().out
    assert "flux of all lamps, lm" in told and "confidence at the end" in told


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler and its two workers, each a process of its own."""
    file = tmp_path / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    started = [subprocess.Popen([*command, "--scheduler-file", str(file)], stderr=subprocess.DEVNULL)]
    try:
        deadline = time.monotonic() + 60
        while not file.exists() or not file.read_text().endswith("}"):
            assert time.monotonic() < deadline and started[0].poll() is None
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        started += [subprocess.Popen(worker, cwd=ROOT, stderr=subprocess.DEVNULL) for _ in range(2)]
        yield address, started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_worker_killed_midway_costs_no_run(scheduler, tmp_path):
    address, workers = scheduler
    file = written(tmp_path, 'scenarios = ["flat"]\nseeds = [0, 1, 2, 3, 4, 5, 6, 7]\n')
    execute = dask(address)

    def killing(function, tasks):  # type: ignore[no-untyped-def]
        for number, result in enumerate(execute(function, tasks)):
            if number == 1:
                workers[0].send_signal(signal.SIGKILL)
            yield result

    far = run_campaign(file, tmp_path / "far", executor=killing)
    assert workers[0].wait(10) == -signal.SIGKILL
    assert not far.failures
    assert far == run_campaign(file, tmp_path / "near", executor=local(1))
    assert len((tmp_path / "far" / JOBS).read_text().splitlines()) == 8


def test_an_input_that_never_ends_is_refused(tmp_path):
    (tmp_path / "pipe").symlink_to("/dev/zero")
    (tmp_path / "c.toml").write_text('scenarios = ["flat"]\n[set.functions.symbol]\nimage = "./pipe"\n')
    with refusal(r"/dev/zero: cannot be read \(it is no regular file\)"):
        run_campaign(tmp_path / "c.toml", tmp_path / "out")
