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
    def __init__(self, far_m=14.0, lx=20.0):
        self.far_m, self.lx = far_m, lx

    def primitives(self, now):
        if not now.speed_m_s:
            return []
        forward, left, up, vehicle = now.T_world_vehicle[:3].T
        corner = vehicle + self.far_m * forward + 1.5 * left
        return [rectangle(corner, -3 * left, -2 * forward, self.lx, "E_v", normal=up)]


class Moving(Line):
    def primitives(self, now):
        now.T_world_vehicle[0, 3] += 1
        return []


class ForSomebody(Line):
    def primitives(self, now):
        return super().primitives(now) if now.objects[0].score else []


class Silent: ...


class Learning:
    def start(self):
        return 0.0

    def step(self, state, now):
        return state + float(now.seen.luminance.mean())

    def adapted(self, state, now):
        return Line(lx=20.0 + state).primitives(now)

    def base_share(self, state):
        return None if state else 0.5


class Levels(Line):
    def commands(self, now):
        return {"left": ModuleCommand(level_deg=0.5 * len(now.objects))}


class LevelsOnAndOn(Levels):
    def __init__(self):
        super().__init__()
        self.level_deg = 0.0

    def commands(self, now):
        self.level_deg += 0.1
        return {"left": ModuleCommand(level_deg=self.level_deg)}


def level_the_world(self: Line, now: Situation) -> Any:
    now.lamps[:, 2] += 0.1
    return {}


def drawn(change: Callable[[Any], Any]) -> type:
    """A line whose primitives are changed."""
    return variant(Line, primitives=lambda self, now: [change(each) for each in Line.primitives(self, now)])


class HalfLearnt:
    def start(self): ...

    def step(self, state, now): ...


BROKEN = {
    "has no method primitives": Silent,
    "has no method adapted": HalfLearnt,
    "[1400.0, 150.0, 0.0] m": drawn(lambda each: replace(each, origin=100 * each.origin)),
    "change no lamp's light": drawn(lambda each: replace(each, normal=-each.normal)),
    "gives a NoneType": variant(Line, primitives=lambda self, now: None),
    "gives a list of Tensor": drawn(lambda each: each.origin),
    "leave out": drawn(lambda each: replace(each, origin=each.origin * torch.nan)),
    "corners [1, 1, 3]": drawn(lambda each: replace(each, origin=each.origin[None])),
    "the setpoint 20": drawn(lambda each: replace(each, quantity=torch.full_like(each.quantity, 2))),
    "another primitives[0].value": drawn(lambda each: replace(each, value=each.value * torch.rand(1))),
    "changes now.T_world_vehicle, which was passed to it": Moving,
    "primitives fails at": ForSomebody,
    "base_share gives 50": variant(Learning, base_share=lambda self, state: 50),
    "commands gives another commands.left.level_deg": LevelsOnAndOn,
    "commands changes now.lamps, which was passed to it": variant(Levels, commands=level_the_world),
    "where now.objects is empty": variant(Levels, commands=lambda self, now: {"left": ModuleCommand(level_deg=now.objects[0].score)}),
}


@pytest.mark.parametrize(("kind", "broken"), BROKEN.items())
def test_each_way_to_break_the_contract_is_told_in_a_sentence(kind, broken):
    assert_refused(check_function, broken, "kind", kind)


@pytest.mark.parametrize("function", [variant(Line, primitives=lambda self, now: ()), Learning, Levels])
def test_what_keeps_the_contract_passes(function):
    check_function(function)


def test_options_are_those_of_the_scenario(device):
    check_function(Line, {"far_m": 16.0}, device.type)
    with refusal(r"options\.far: .*did you mean 'far_m'\?"):
        check_function(Line, {"far": 16.0}, device.type)
