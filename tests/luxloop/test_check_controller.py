"""The contract of symbol controllers: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

import luxloop
from luxloop import ExtractionStatus, Observation, ProjectionCommand, SymbolSensor, check_controller
from luxloop.controllers.symbol.sensing.projection import Warp
from tests.luxloop.variants import assert_refused, variant
from tests.refusal import refusal


@dataclass(frozen=True)
class State:
    pose: Tensor
    steps: int = 0


class Halfway:
    def __init__(self, sensor, share=0.5):
        self.share, self.memory = share, [0]

    def start(self, pose):
        return State(pose)

    def projection(self, state, ego):
        return ProjectionCommand(state.pose)

    def step(self, state, observation):
        usable = observation.measurement.code == ExtractionStatus.SEEN
        return State(torch.where(usable, state.pose - self.share * observation.measurement.pose_error, state.pose), state.steps + 1)


class NeedsFrames(Halfway):
    def step(self, state, observation):
        on, _ = observation.frames
        return replace(super().step(state, observation), steps=int(on.max()))


class NeedsSymbol(Halfway):
    def step(self, state, observation):
        rows = observation.measurement.symbol.sum(1).argmax() if observation.frames is not None else 0
        return replace(super().step(state, observation), steps=int(rows) + [0][observation.measurement.code == ExtractionStatus.NOTHING])


class InPlace(Halfway):
    def step(self, state, observation):
        state.pose.sub_(self.share * observation.measurement.pose_error.nan_to_num())
        return state


class SpoilsTheLook(Halfway):
    def step(self, state, observation):
        observation.measurement.pose_error.nan_to_num_()
        return state


class Counting(Halfway):
    def step(self, state, observation):
        self.memory[0] += 1
        return replace(super().step(state, observation), steps=self.memory[0])


class Buffered(Halfway):
    buffer = torch.zeros(4)

    def step(self, state, observation):
        pose = super().step(state, observation).pose
        self.memory[0] += 1
        return State(self.buffer.copy_(pose + self.memory[0]))


class Silent:
    def __init__(self, sensor): ...

    def start(self, pose):
        return pose

    def projection(self, state, ego):
        return ProjectionCommand(state)


def pitched(self: Halfway, state: State, ego: Any) -> ProjectionCommand:
    return ProjectionCommand(torch.cat([state.pose[:3], state.pose[3:] - ego.attitude[2]]) if ego else state.pose)


def starting(start: Callable[[Tensor], Any]) -> type:
    return variant(Halfway, start=lambda self, pose: start(pose))


def stepping(pose: Callable[[State, Any], Tensor]) -> type:
    return variant(Halfway, step=lambda self, state, observation: State(pose(state, observation.measurement)))


def projecting(projection: Callable[[State], Any]) -> type:
    return variant(Halfway, projection=lambda self, state, ego: projection(state))


BROKEN = {
    "has no method step": Silent,
    "step takes (state": variant(Halfway, step=lambda self, state: state),
    "roll 2 and pitch -1 rad": starting(lambda pose: State(torch.cat([pose[:2], pose[2:].rad2deg()]))),
    "pose is float64 [4]": starting(lambda pose: State(pose.double())),
    "pose is float32 [1, 4]": starting(lambda pose: State(pose[None])),
    "start gives a state that cannot be saved": variant(Halfway, start=lambda self, pose: {"pose": pose, "law": self}),
    "more than 45 deg": stepping(lambda state, seen: state.pose + 10 * seen.errors.nan_to_num()),
    "moves the symbol away": stepping(lambda state, seen: state.pose + 0.5 * seen.pose_error.nan_to_num()),
    "pose is not finite, [nan, nan, nan, nan]": stepping(lambda state, seen: state.pose - 0.5 * seen.pose_error),
    "where no lamp can draw": projecting(lambda state: ProjectionCommand(state.pose + torch.tensor([100.0, 100, 0, 0]).to(state.pose))),
    "projection gives another projection.pose": projecting(
        lambda state: ProjectionCommand(state.pose + 0.01 * torch.randn(4).to(state.pose))
    ),
    "projection: gives a Tensor": projecting(lambda state: state.pose),
    "z is float32 [3]": projecting(lambda state: ProjectionCommand(state.pose, z=torch.zeros(3).to(state.pose))),
    "warp.dimming reaches from 2 to 2": projecting(
        lambda state: ProjectionCommand(
            state.pose, warp=Warp(torch.zeros(1, 2, 4, 4).to(state.pose), 2 * torch.ones(1, 4, 4).to(state.pose), (4.0, 2.0))
        ),
    ),
    "on a car that moves: ": variant(
        Halfway, projection=lambda self, state, ego: ProjectionCommand(state.pose - ego[0] if ego else state.pose)
    ),
    "pose is not finite": variant(Halfway, projection=pitched),
    "in a step without frames (observation.frames is None)": NeedsFrames,
    "in a step whose frames do not show the symbol": NeedsSymbol,
    "step changes state.pose, which was passed to it": InPlace,
    "in a step without frames": SpoilsTheLook,
    "step gives another state.steps": Counting,
    "step changes state.pose, which it returned before": Buffered,
}


@pytest.mark.parametrize(("kind", "broken"), BROKEN.items())
def test_each_way_to_break_the_contract_is_told_in_a_sentence(kind, broken):
    assert_refused(check_controller, broken, "controller.name", kind)


@pytest.mark.parametrize("name", ["thesis_pid", "gauss_newton"])
def test_controllers_that_are_shipped_keep_the_contract(name):
    params = luxloop.load("flat", [f"functions.symbol.controller.name={name}"]).symbol.controller
    assert params is not None

    class Shipped:
        def __init__(self, sensor: SymbolSensor) -> None:
            self.law = luxloop.build_controller(params, sensor)

        def start(self, pose: Tensor) -> Any:
            return self.law.start(pose)

        def projection(self, state: Any, ego: Any) -> ProjectionCommand:
            return self.law.projection(state, ego)

        def step(self, state: Any, observation: Observation) -> Any:
            return self.law.step(state, observation)

    check_controller(Shipped)


def test_options_are_those_of_the_scenario(device):
    check_controller(Halfway, {"share": 0.3}, device.type)
    with refusal(r"controller\.options\.shore: .*did you mean 'share'\?"):
        check_controller(Halfway, {"shore": 0.3}, device.type)
    with refusal("is not a class; give the class itself"):
        check_controller(Halfway(None))  # type: ignore[arg-type]
