"""The contract of lighting functions: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from luxloop import ModuleCommand, Situation, check_function, rectangle
from tests.luxloop.variants import assert_refused, variant
from tests.refusal import refusal


class Line:
    def __init__(self, far_m: float = 14.0, lx: float = 20.0) -> None:
        self.far_m, self.lx = far_m, lx

    def primitives(self, now: Situation) -> Any:
        if not now.speed_m_s:
            return []
        forward, left, up, vehicle = now.T_world_vehicle[:3].T
        corner = vehicle + self.far_m * forward + 1.5 * left
        return [rectangle(corner, -3 * left, -2 * forward, self.lx, "E_v", normal=up)]


class Moving(Line):
    def primitives(self, now: Situation) -> Any:
        now.T_world_vehicle[0, 3] += 1
        return []


class ForSomebody(Line):
    def primitives(self, now: Situation) -> Any:
        return super().primitives(now) if now.objects[0].score else []


class Silent: ...


class Learning:
    def start(self) -> Any:
        return 0.0

    def step(self, state: Any, now: Situation) -> Any:
        assert now.seen is not None
        return state + float(now.seen.luminance.mean())

    def adapted(self, state: Any, now: Situation) -> Any:
        return Line(lx=20.0 + state).primitives(now)

    def base_share(self, state: Any) -> Any:
        return None if state else 0.5


class Levels(Line):
    def commands(self, now: Situation) -> Any:
        return {"left": ModuleCommand(level_deg=0.5 * len(now.objects))}


class LevelsOnAndOn(Levels):
    def __init__(self) -> None:
        super().__init__()
        self.level_deg = 0.0

    def commands(self, now: Situation) -> Any:
        self.level_deg += 0.1
        return {"left": ModuleCommand(level_deg=self.level_deg)}


def level_the_world(self: Line, now: Situation) -> Any:
    now.lamps[:, 2] += 0.1
    return {}


def drawn(name: str, change: Callable[[Any], Any]) -> type:
    """A line whose primitives are changed."""
    return variant(Line, name, primitives=lambda self, now: [change(each) for each in Line.primitives(self, now)])


class HalfLearnt:
    def start(self) -> None: ...

    def step(self, state: Any, now: Situation) -> None: ...


BROKEN: dict[type, list[str]] = {
    Silent: ["has no method primitives"],
    HalfLearnt: ["has no method adapted", "start, step, adapted, base_share"],
    variant(Line, "TakesLess", primitives=lambda self: []): ["primitives takes ()", "but is called as primitives(now)"],
    drawn("InCentimetres", lambda each: replace(each, origin=100 * each.origin)): [
        "change no lamp's light",
        "[1400.0, 150.0, 0.0] m",
        "places are in m in the world",
    ],
    drawn("FacesAway", lambda each: replace(each, normal=-each.normal)): ["change no lamp's light", "normals", "point to the lamps"],
    variant(Line, "One", primitives=lambda self, now: None): ["gives a NoneType", "an empty one draws nothing"],
    drawn("Corners", lambda each: each.origin): ["gives a list of Tensor", "luxloop.rectangle"],
    drawn("NotANumber", lambda each: replace(each, origin=each.origin * torch.nan)): ["not finite", "leave out"],
    drawn("Batched", lambda each: replace(each, origin=each.origin[None])): ["corners [1, 1, 3]", "[P, 3]"],
    drawn("LuxAsShare", lambda each: replace(each, quantity=torch.full_like(each.quantity, 2))): [
        "the setpoint 20",
        '0 to 1 for the quantity "u_abs"',
    ],
    drawn("Flickering", lambda each: replace(each, value=each.value * torch.rand(1))): [
        "another primitives[0].value",
        "seed random numbers",
    ],
    Moving: ["changes now.T_world_vehicle, which was passed to it"],
    ForSomebody: ["where now.objects is empty", "primitives fails at", "IndexError"],
    variant(Learning, "KeepsItself", start=lambda self: (0.0, self)): [
        "start gives a state that cannot be saved",
        "state[1] is of the type",
    ],
    variant(Learning, "InPercent", base_share=lambda self, state: 50): ["base_share gives 50", "share of the base beam, 0..1"],
    variant(Learning, "InPlace", start=lambda self: torch.zeros(1), step=lambda self, state, now: state.add_(1)): [
        "step changes state, which was passed to it"
    ],
    LevelsOnAndOn: ["commands gives another commands.left.level_deg", "same now", "keep nothing in self"],
    variant(Levels, "LevelsTheWorld", commands=level_the_world): ["commands changes now.lamps, which was passed to it"],
    variant(Levels, "LevelsForSomebody", commands=lambda self, now: {"left": ModuleCommand(level_deg=now.objects[0].score)}): [
        "where now.objects is empty",
        "IndexError",
    ],
}


@pytest.mark.parametrize("broken", BROKEN, ids=lambda each: each.__name__)
def test_each_way_to_break_the_contract_is_told_in_a_sentence(broken: type) -> None:
    assert_refused(check_function, broken, "kind", ["check_function: ", *BROKEN[broken]])


@pytest.mark.parametrize("function", [variant(Line, "Nothing", primitives=lambda self, now: ()), Learning, Levels])
def test_what_keeps_the_contract_passes(function: type) -> None:
    check_function(function)


def test_options_are_those_of_the_scenario(device: torch.device) -> None:
    check_function(Line, {"far_m": 16.0}, device.type)
    with refusal(r"options\.far: .*did you mean 'far_m'\?"):
        check_function(Line, {"far": 16.0}, device.type)
