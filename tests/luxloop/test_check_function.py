"""The contract of lighting functions: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from luxloop import LuxloopError, ModuleCommand, Situation, check_function, rectangle
from luxloop.loop.studies.contracts.function import check_in, world


@pytest.fixture(scope="module")
def shared() -> Any:
    return world("auto")


class Line:
    def __init__(self, far_m: float = 14.0, lx: float = 20.0) -> None:
        self.far_m, self.lx = far_m, lx

    def primitives(self, now: Situation) -> Any:
        if not now.speed_m_s:
            return []
        forward, left, up, vehicle = now.T_world_vehicle[:3].T
        corner = vehicle + self.far_m * forward + 1.5 * left
        return [rectangle(corner, -3 * left, -2 * forward, self.lx, "E_v", normal=up)]


class Nothing(Line):
    def primitives(self, now: Situation) -> Any:
        return ()


class InCentimetres(Line):
    def primitives(self, now: Situation) -> Any:
        return [replace(each, origin=100 * each.origin) for each in super().primitives(now)]


class FacesAway(Line):
    def primitives(self, now: Situation) -> Any:
        return [replace(each, normal=-each.normal) for each in super().primitives(now)]


class One(Line):
    def primitives(self, now: Situation) -> Any:
        return (*super().primitives(now), None)[0]


class Corners(Line):
    def primitives(self, now: Situation) -> Any:
        return [each.origin for each in super().primitives(now)]


class NotANumber(Line):
    def primitives(self, now: Situation) -> Any:
        return [replace(each, origin=each.origin * torch.nan) for each in super().primitives(now)]


class Batched(Line):
    def primitives(self, now: Situation) -> Any:
        return [replace(each, origin=each.origin[None]) for each in super().primitives(now)]


class LuxAsShare(Line):
    def primitives(self, now: Situation) -> Any:
        return [replace(each, quantity=torch.full_like(each.quantity, 2)) for each in super().primitives(now)]


class Flickering(Line):
    def primitives(self, now: Situation) -> Any:
        return [replace(each, value=each.value * torch.rand(1)) for each in super().primitives(now)]


class Moving(Line):
    def primitives(self, now: Situation) -> Any:
        now.T_world_vehicle[0, 3] += 1
        return []


class ForSomebody(Line):
    def primitives(self, now: Situation) -> Any:
        return super().primitives(now) if now.objects[0].score else []


class TakesLess(Line):
    def primitives(self) -> Any:  # type: ignore[override]
        return []


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


class KeepsItself(Learning):
    def start(self) -> Any:
        return (0.0, self)


class InPercent(Learning):
    def base_share(self, state: Any) -> Any:
        return 50


class InPlace(Learning):
    def start(self) -> Any:
        return torch.zeros(1)

    def step(self, state: Any, now: Situation) -> Any:
        return state.add_(1)


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


class LevelsTheWorld(Levels):
    def commands(self, now: Situation) -> Any:
        now.lamps[:, 2] += 0.1
        return {}


class LevelsForSomebody(Levels):
    def commands(self, now: Situation) -> Any:
        return {"left": ModuleCommand(level_deg=now.objects[0].score)}


class HalfLearnt:
    def start(self) -> None: ...

    def step(self, state: Any, now: Situation) -> None: ...


BROKEN: dict[Any, list[str]] = {
    Silent: ["has no method primitives"],
    HalfLearnt: ["has no method adapted", "start, step, adapted, base_share"],
    TakesLess: ["primitives takes () -> Any, but is called as primitives(now)"],
    InCentimetres: ["change no lamp's light", "[1400.0, 150.0, 0.0] m", "places are in m in the world"],
    FacesAway: ["change no lamp's light", "normals", "point to the lamps"],
    One: ["gives a NoneType", "an empty one draws nothing"],
    Corners: ["gives a list of Tensor", "luxloop.rectangle"],
    NotANumber: ["not finite", "leave out"],
    Batched: ["corners [1, 1, 3]", "[P, 3]"],
    LuxAsShare: ["the setpoint 20", '0 to 1 for the quantity "u_abs"', '"E_v" in lx'],
    Flickering: ["another primitives[0].value", "same now", "seed random numbers"],
    Moving: ["changes now.T_world_vehicle, which was passed to it"],
    ForSomebody: ["where now.objects is empty", "primitives fails at", "IndexError"],
    KeepsItself: ["start gives a state that cannot be saved", "state[1] is of the type KeepsItself"],
    InPercent: ["base_share gives 50", "share of the base beam, 0..1"],
    LevelsOnAndOn: ["commands gives another commands.left.level_deg", "same now", "keep nothing in self"],
    LevelsTheWorld: ["commands changes now.lamps, which was passed to it"],
    LevelsForSomebody: ["commands fails at", "IndexError"],
    InPlace: ["step changes state, which was passed to it"],
}


@pytest.mark.parametrize("broken", BROKEN, ids=lambda each: each.__name__)
def test_each_way_to_break_the_contract_is_told_in_a_sentence(broken: Any, shared: Any) -> None:
    with pytest.raises(LuxloopError) as caught:
        check_in(shared, broken, {})
    (sentence,) = caught.value.args
    assert sentence.startswith("check_function: ") and f"kind: {__name__}:{broken.__name__}: " in sentence
    assert all(words in sentence for words in BROKEN[broken]), sentence


@pytest.mark.parametrize("kept", [Line, Nothing, Learning, Levels])
def test_what_keeps_the_contract_passes(kept: Any, shared: Any) -> None:
    check_in(shared, kept, {})


def test_options_are_those_of_the_scenario(device: torch.device) -> None:
    check_function(Line, {"far_m": 16.0}, device.type)
    with pytest.raises(LuxloopError, match=r"options\.far: .*did you mean 'far_m'\?"):
        check_function(Line, {"far": 16.0}, device.type)
