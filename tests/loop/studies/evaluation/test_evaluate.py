"""The evaluation: joint optima against a linear programme, jobs that resume, figures and report that get made."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from scipy.optimize import linprog

from luxloop.controllers.pixels.mrpc_tuning import part
from luxloop.loop.commands import cli
from luxloop.loop.studies import jobs
from luxloop.loop.studies.evaluation import evaluate as evaluation
from luxloop.loop.studies.evaluation import report
from luxloop.loop.studies.evaluation.evaluate import JOBS, ROWS, SETPOINTS, Evaluation, evaluate, summary
from luxloop.loop.studies.jobs import local
from luxloop.perception.metrics import mae
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.parametric import GaussianPixels, headlight
from luxloop.world.lamps.patterns import Rectangle
from luxloop.world.texels import TexelGrid

RECTANGLES = [Rectangle(0, 0, 3.75, 2), Rectangle(-5, 1, 6, 3, 15), Rectangle(2.5, -1, 1.5, 1)]


@pytest.fixture(autouse=True, scope="module")
def small() -> Iterator[Headlight]:
    """A lamp of 3 x 12 pixels on a coarse texture in the place of the real one; every search is short."""
    pixels = GaussianPixels(
        columns=12,
        left_deg=12,
        right_deg=-12,
        widening=1.0,
        column_sigma=0.45,
        row_centres_deg=(2.3, 0.1, -2.2),
        row_sigmas_deg=(1.0, 0.6, 1.0),
        peak_cd=(20_000, 40_000, 20_000),
    )
    light = headlight("small", pixels, TexelGrid.from_degrees(24, 64, 14, -14, -5, 5))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "headlight", lambda name: light)
        patch.setattr("luxloop.loop.studies.evaluation.report.headlight", lambda name: light)
        patch.setattr("luxloop.controllers.pixels.mrpc_tuning.POPULATION", 4)
        patch.setattr("luxloop.controllers.pixels.mrpc_tuning.GENERATIONS", 5)
        yield light


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("evaluation")


@pytest.fixture(scope="module")
def found(folder: Path) -> Evaluation:
    return evaluate(folder, ["hd84"], executor=local(1), setpoints=RECTANGLES, grid=2)


def test_joint_optimum_is_that_of_a_linear_programme(small):
    for rectangle in RECTANGLES:
        some = part(small, rectangle.texture(small))
        u, gap = evaluation.joint_optimum(some)
        A = some.headlight.matrix.to_scipy().astype(np.float64) / 1e4
        s = some.wanted.flatten().double().numpy() / 1e4
        one = sp.identity(len(s))
        bounds = [(0, 1)] * A.shape[1] + [(0, None)] * len(s)
        cost = np.concatenate([np.zeros(A.shape[1]), np.ones(len(s))])
        found = linprog(cost, sp.vstack([sp.hstack([A, -one]), sp.hstack([-A, -one])]), np.concatenate([s, -s]), bounds=bounds)
        least = found.fun / (s > 0).sum()
        reached = float(mae(some.headlight.light_texture(u), some.wanted))
        assert gap <= evaluation.GAP
        assert least - 1e-5 <= reached <= least * (1 + evaluation.GAP) + 1e-5  # u is rounded to float32


def test_mrpc_is_never_better_than_the_joint_optimum(found):
    assert found.failures == {}
    for row in found.setpoints:
        assert row["jpo_mae"] <= row["mrpc_mae"] * (1 + evaluation.GAP)
        assert row["options_mae"] <= row["mrpc_mae"] + 1e-9
        assert row["mrpc_mae"] <= min(row["median_mae"], row["default_mae"]) * 1.1  # a short search of the three
    values = summary(found.setpoints)
    assert values["setpoints"] == 3
    assert values["mrpc_ratio_mean"] == pytest.approx(np.mean([row["mrpc_mae"] / row["jpo_mae"] for row in found.setpoints]))
    assert values["a_x_median"] == np.median([row["a_x"] for row in found.setpoints])


def test_stored_utilisations_give_the_error(found, small):
    for row, rectangle in zip(found.setpoints, RECTANGLES, strict=True):
        for control in ("mrpc", "jpo"):
            light = torch.from_numpy(evaluation.light_of("hd84", row["pixels"], row[f"{control}_u"]))
            assert float(mae(light, rectangle.texture(small))) == pytest.approx(row[f"{control}_mae"], abs=1e-3)  # stored with 5 digits


def test_tuning_only_lowers_the_errors_of_the_tables(found):
    errors = dict(zip(ROWS, (row["mae"] for row in found.tables), strict=True))
    assert errors["exclusion"] <= errors["reference"]
    assert min(errors.values()) == pytest.approx(errors["exclusion, mapping, free shape, reduction"], rel=0.1)  # a short search


def test_an_evaluation_goes_on_where_it_was(found, folder, tmp_path, monkeypatch):
    lines = (folder / JOBS).read_text().splitlines()
    (tmp_path / JOBS).write_text("\n".join([*lines[1:], lines[0][:40]]))
    started = []
    original = jobs._call
    monkeypatch.setattr(jobs, "_call", lambda function, task: (started.append(task), original(function, task))[1])
    again = evaluate(tmp_path, ["hd84"], executor=local(1), setpoints=RECTANGLES, grid=2)
    assert len(started) == 1
    assert again == found
    assert (tmp_path / SETPOINTS).exists()


def test_a_part_that_fails_leaves_no_older_table(tmp_path, monkeypatch):
    def failing(**parameters: object) -> dict[str, object]:
        raise ValueError("no")

    tables = ("setpoints", "tables", "sensitivity")
    for table, function in zip(tables, ("setpoint", "table_row", "sensitivity_row"), strict=True):
        (tmp_path / f"{table}.parquet").write_text("older")
        monkeypatch.setattr(evaluation, function, failing)
    assert evaluate(tmp_path, ["hd84"], executor=local(1), setpoints=RECTANGLES, grid=1).failures
    assert not list(tmp_path.glob("*.parquet"))


def test_figures_and_report(found, tmp_path):
    report.write_report(found, tmp_path)
    text = (tmp_path / "report.md").read_text()
    for kind in report.CAPTIONS:
        assert f"(figures/{kind}-hd84.png)" in text
        assert (tmp_path / "figures" / f"{kind}-hd84.png").stat().st_size > 5_000
    assert "| ratio MRPC / joint |" in text and "1.081" in text
    assert "| exclusion, mapping, free shape, reduction |" in text
    assert "sensitivity" not in report.page(Evaluation(found.setpoints, [], [], {}), "")


def test_command_says_how_it_went(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(evaluation, "QUICK", [RECTANGLES[0], Rectangle(80, 0, 1, 1)])
    monkeypatch.setattr(evaluation, "ROWS", {})
    monkeypatch.setattr(evaluation, "_sensitivities", lambda name, steps: [])
    assert not report.run_evaluation(tmp_path, "hd84", True, 1)
    said = capsys.readouterr()
    assert "covers no texel" in said.err
    assert "report.md written" in said.out
    assert "hd84" in said.out


@pytest.mark.parametrize(("option", "value", "told"), [("--lamp", "hd85", "hd84"), ("--jobs", "0", "must be >= 1")])
def test_wrong_options_are_refused(option, value, told, tmp_path, capsys):
    assert cli.main(["evaluate", "--quick", "--out", str(tmp_path), option, value]) == cli.WRONG
    said = capsys.readouterr().err
    assert option in said and told in said
