"""The examples of parts of one's own keep their contracts and do what docs/python.md says of them."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from luxloop import ProjectionCommand, check_controller
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load

EXAMPLES = Path(__file__).parents[2] / "scenarios" / "examples"
SETTLED = 10  # steps


@pytest.fixture(autouse=True)
def examples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for file in EXAMPLES.glob("*.py"):
        shutil.copy(file, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


def ious(scenario: str, controller: str, steps: int, *more: str) -> list[float]:
    prepared = prepare(load(scenario, [f"steps={steps}", f"functions.symbol.controller={{name='{controller}'}}", *more]), "cpu")
    return [float(result.symbol.metrics.iou) for result in prepared.evaluations() if result.symbol.metrics is not None]


@pytest.mark.parametrize("name", ["motion_compensation:MotionCompensation", "visual_servo:VisualServo", "lqg:Lqg"])
def test_controllers_keep_the_contract(name):
    module, _, controller = name.partition(":")
    check_controller(getattr(__import__(module), controller))


@pytest.mark.slow
def test_what_is_drawn_for_the_body_s_motion_lies_better_than_a_correction_of_the_past():
    moving, late = (ious("driving", each, 16) for each in ("motion_compensation:MotionCompensation", "model_reference"))
    assert sum(moving[SETTLED:]) > 2 * sum(late[SETTLED:]), "0.73 to 0.26 over the whole drive"


@pytest.mark.slow
def test_the_interaction_matrix_is_learnt_in_five_steps():
    assert min(ious("snowflake", "visual_servo:VisualServo", 9)[5:]) > 0.88, "0.91 over three seeds; a frame of noise costs 0.01"


@pytest.mark.slow
@pytest.mark.parametrize("latency", [0, 2])
def test_lqg_settles_at_any_latency(latency):
    after = ious("snowflake", "lqg:Lqg", 14, f"camera.latency_steps={latency}")[8:]
    assert min(after) > 0.8 and max(after) - min(after) < 0.05, "it stands, as far as four numbers can straighten a symbol"


def test_what_the_body_s_motion_explains_of_a_pose_error_is_taken_out_as_interfaces_md_shows():
    (code,) = re.findall(r"^```python\n(.*?)^```", (EXAMPLES.parents[1] / "docs" / "interfaces.md").read_text("utf-8"), re.M | re.S)
    shown: dict[str, Any] = {}
    exec(code, shown)
    changes = ["steps=8", "road.kind=flat", "vehicle.oscillation={pitch_deg=0.1, rate_hz=1.2}", "sensors={fitted=['wheels', 'attitude']}"]
    simulation = prepare(load("driving", changes), "cpu")
    seen: list[torch.Tensor] = []

    class Still:
        def start(self, pose: torch.Tensor) -> torch.Tensor:
            return pose

        def projection(self, state: torch.Tensor, ego: Any) -> ProjectionCommand:
            return ProjectionCommand(state)

        def step(self, state: torch.Tensor, observation: Any) -> torch.Tensor:
            own = shown["ground_error"](simulation.symbol.sensor, observation)
            seen.append(torch.stack([own, observation.measurement.pose_error])[:, 0])
            return state

    truth = [float(step.symbol.metrics.centroid_percent[0]) / 100 for step in simulation.with_controller(Still()).evaluations()]
    off = (torch.stack(seen) / simulation.symbol.projector.params.length_m - torch.tensor(truth)[:, None]).abs().amax(0)
    assert off[0] < 0.04 and off[1] > 3 * off[0], f"share of the symbol's length: its own motion is left out, {off}"


@pytest.mark.slow
def test_the_tracker_keeps_whom_the_detector_finds():
    scenario = load("obl", ["steps=12", "tracker.kind=alpha_beta:AlphaBeta", "detector={kind='truth'}"])
    *_, last = prepare(scenario, "cpu").evaluations()
    followed = {name: each.track for name, each in last.detections.recognised.items()}
    assert len(followed) == 4 and None not in followed.values() and len(set(followed.values())) == 4, followed
