"""The examples of parts of one's own keep their contracts and do what docs/examples.md says of them."""

import shutil
from pathlib import Path

import pytest

from loop.run import prepare
from loop.scenario.model import load
from luxloop import check_controller

EXAMPLES = Path(__file__).parents[2] / "scenarios" / "examples"
SETTLED = 10  # steps


@pytest.fixture(autouse=True)
def examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for file in EXAMPLES.glob("*.py"):
        shutil.copy(file, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


def ious(scenario: str, controller: str, steps: int, *more: str) -> list[float]:
    prepared = prepare(load(scenario, [f"steps={steps}", f"functions.symbol.controller={{name='{controller}'}}", *more]), "cpu")
    return [float(result.symbol.verdict.iou) for result in prepared.run() if result.symbol.verdict is not None]


@pytest.mark.parametrize("name", ["motion_compensation:MotionCompensation", "visual_servo:VisualServo"])
def test_controllers_keep_the_contract(name: str) -> None:
    module, _, controller = name.partition(":")
    check_controller(getattr(__import__(module), controller))


def test_what_is_drawn_for_the_body_s_motion_lies_better_than_a_correction_of_the_past() -> None:
    moving, late = (ious("driving", each, 16) for each in ("motion_compensation:MotionCompensation", "model_reference"))
    assert sum(moving[SETTLED:]) > 2 * sum(late[SETTLED:]), "0.73 to 0.26 over the whole drive"


def test_the_interaction_matrix_is_learnt_in_five_steps() -> None:
    assert min(ious("snowflake", "visual_servo:VisualServo", 9)[5:]) > 0.88, "0.91 over three seeds; a frame of noise costs 0.01"


def test_the_tracker_keeps_whom_the_detector_finds() -> None:
    scenario = load("obl", ["steps=12", "tracker.kind=alpha_beta:AlphaBeta", "detector={kind='truth'}"])
    *_, last = prepare(scenario, "cpu").run()
    followed = {name: each.track for name, each in last.look.recognised.items()}
    assert len(followed) == 4 and None not in followed.values() and len(set(followed.values())) == 4, followed
