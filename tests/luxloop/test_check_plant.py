"""The contract of plants: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import pytest
import torch

from luxloop import Arrivals, Exposure, Frame, Sample, Utilisation, check_plant, simulated_plant
from tests.luxloop.variants import assert_refused, variant
from tests.refusal import refusal


class Good:
    """The simulated world, without its truth; its frames come `late` exposures late."""

    def __init__(self, scenario, modules, late=0):
        self.inner, self.late = simulated_plant(scenario, modules), late

    def start(self):
        return (self.inner.start()[0], ()), self.inner.start()[1]

    def show(self, state, exposure):
        inner, queue = state
        inner, arrivals = self.inner.show(inner, exposure)
        frames = (*queue, *(self.frame(each, exposure) for each in arrivals.frames))
        come = max(len(frames) - self.late, 0)
        arrived = [replace(each, arrived_s=arrivals.time_s) if self.late else each for each in frames[:come]]
        return (inner, frames[come:]), self.arrivals(arrivals, tuple(arrived))

    def arrivals(self, arrivals, frames):
        return replace(arrivals, frames=frames)

    def frame(self, frame, exposure):
        return frame


class Warming(Good):
    """Keeps the light that it showed last."""

    def show(self, state, exposure):
        (inner, _), arrivals = super().show((state[0], ()), exposure)
        return (inner, exposure.lights), arrivals


class Losing(Good):
    """Of some frames it never says a word, and others are lost."""

    def frame(self, frame, exposure):
        return frame if frame.number % 3 else Frame(frame.number, math.nan, math.nan, None)

    def arrivals(self, arrivals, frames):
        return replace(arrivals, frames=tuple(frame for frame in frames if frame.number % 3 < 2), samples=())


class Slow(Good):
    """Its time goes on as it likes, and its sensors tell nothing."""

    def __init__(self, scenario, modules):
        self.dark = modules[0].headlight.matrix.values.new_zeros(scenario.camera.height_px, scenario.camera.width_px)

    def start(self):
        return 100.0, Arrivals(100.0)

    def show(self, state, exposure):
        end_s = state + 0.02 + 0.001 * (exposure.number % 3)
        return end_s, Arrivals(end_s, (Frame(exposure.number, state + 0.004, end_s, self.dark),))


class Sampling(Good):
    """Its gyro is 4 ms late."""

    def arrivals(self, arrivals, frames):
        time_s, values = arrivals.time_s, frames[0].image[0, :3] if frames else torch.zeros(3)
        samples = Sample("wheels", time_s, time_s, values[:2]), Sample("gyro", time_s - 0.004, time_s, values)
        return replace(arrivals, frames=frames, samples=samples)


@pytest.mark.parametrize(("plant", "options"), [(Warming, {}), (Losing, {}), (Slow, {}), (Sampling, {}), (Good, {"late": 5})])
def test_what_keeps_the_contract_passes(plant, options):
    check_plant(plant, options)


class NoShow:
    def __init__(self, scenario, modules): ...

    def start(self): ...


class ArrivalsAlone(Good):
    def show(self, state, exposure):
        return super().show(state, exposure)[1]


class LockedState(Good):
    def start(self):
        return (super().start()[0], count()), Arrivals(0.0)


class StateInSelf(Good):
    """Hands on no state, which a simulated camera that is not late does not miss."""

    def start(self):
        self.state, arrivals = self.inner.start()
        return None, arrivals

    def show(self, state, exposure):
        self.state, arrivals = self.inner.show(self.state, exposure)
        return None, arrivals


class QueueInSelf(Good):
    """Its frames wait in itself, so that an old state finds what came later."""

    def __init__(self, scenario, modules):
        super().__init__(scenario, modules)
        self.last: dict[int, Any] = {}

    def frame(self, frame, exposure):
        self.last[exposure.number] = frame.image
        return replace(frame, image=self.last[max(self.last)])


class OneBuffer(Good):
    def __init__(self, scenario, modules):
        super().__init__(scenario, modules)
        self.buffer = modules[0].headlight.matrix.values.new_zeros(scenario.camera.height_px, scenario.camera.width_px)

    def frame(self, frame, exposure):
        self.buffer += 1
        return replace(frame, image=self.buffer)


class DimsInPlace(Good):
    def show(self, state, exposure):
        for light in exposure.lights:
            light.u.mul_(0.8)
        return super().show(state, exposure)


class Swapped(Good):
    def arrivals(self, arrivals, frames):
        return replace(arrivals, frames=frames[::-1])

    def show(self, state, exposure):
        self.late = (exposure.number + 1) % 2
        return super().show(state, exposure)


class Omniscient(Good):
    truth = "all of it"


def with_frames(frame: Callable[[Any, Exposure], Any]) -> type:
    return variant(Good, frame=lambda self, each, exposure: frame(each, exposure))


def with_images(image: Callable[[torch.Tensor], torch.Tensor]) -> type:
    return with_frames(lambda frame, _: replace(frame, image=image(frame.image)))


def with_arrivals(arrivals: Callable[[Arrivals, Any], Any]) -> type:
    return variant(Good, arrivals=lambda self, each, frames: arrivals(each, frames))


BROKEN = {
    "has no method show; it needs start, show": NoShow,
    "show: gives Arrivals": ArrivalsAlone,
    "start gives a state that cannot be saved: state[1] is of the type count": LockedState,
    "another (state, arrivals)[1].frames": StateInSelf,
    "when an earlier state is shown its exposure again after others": QueueInSelf,
    "changes (state, arrivals)[1].frames[0].image, which it returned before": OneBuffer,
    "changes exposure.lights[0].u, which was passed to it": DimsInPlace,
    "the frame of exposure 0 after that of exposure 1": Swapped,
    "truth is of the type str": Omniscient,
    "gives the time_s 0 after an exposure that began at 0 s": with_arrivals(lambda each, frames: Arrivals(0.0, frames)),
    "no tuple of luxloop.Frame": with_arrivals(lambda each, frames: Arrivals(each.time_s, list(frames))),
    "the frame of exposure 0 twice": with_arrivals(lambda each, frames: replace(each, frames=2 * frames)),
    "no frame of 24 exposures has arrived or been reported lost": with_arrivals(lambda each, frames: replace(each, frames=())),
    "gives samples that are no tuple of luxloop.Sample": with_arrivals(lambda each, frames: replace(each, samples=((0.0, 1.0),))),
    "a frame of exposure 1, which was not shown": with_frames(lambda frame, _: replace(frame, number=frame.number + 1)),
    "frame 0: was taken at 80000 s, not from 0 to 0.01666666667 s": with_frames(
        lambda frame, _: replace(frame, taken_s=80_000 + frame.taken_s)
    ),
    "frame 0: was taken at 0 s and arrived at -0.01 s": with_frames(
        lambda frame, exposure: replace(frame, arrived_s=exposure.start_s - 0.01)
    ),
    "and arrived at 0.1166666667 s, by time_s = 0.01666666667": with_frames(
        lambda frame, _: replace(frame, arrived_s=frame.arrived_s + 0.1)
    ),
    "another (state, arrivals)[1].frames[0].image": with_images(lambda image: (image + torch.rand_like(image).round()).clamp(max=4095)),
    "has an image that is a torch.float32 [320, 180]": with_images(lambda image: image.T),
    "no whole numbers; it seems to hold shares: multiply it by 4095": with_images(lambda image: image / 4095),
    "it may hold a luminance: give digital numbers of 0 to 4095": with_images(lambda image: 0.37 * image),
}


@pytest.mark.parametrize(("kind", "broken"), BROKEN.items())
def test_each_way_to_break_the_contract_is_told_in_a_sentence(kind, broken):
    assert_refused(check_plant, broken, "plant.kind", kind)


class Dimmed:
    """As docs/python.md has it."""

    def __init__(self, scenario, modules, share=0.8):
        self.inner, self.share = simulated_plant(scenario, modules), share
        self.truth = self.inner.truth

    def start(self):
        return self.inner.start()

    def show(self, state, exposure):
        dimmed = tuple(Utilisation(self.share * light.u, light.band) for light in exposure.lights)
        return self.inner.show(state, replace(exposure, lights=dimmed))


def test_options_are_those_of_the_scenario(device):
    check_plant(Dimmed, {"share": 0.6}, device.type)
    with refusal(r"plant\.options\.shar: .*did you mean 'share'\?"):
        check_plant(Dimmed, {"shar": 0.6}, device.type)
    with refusal("is not a class; give the class itself"):
        check_plant(3, device=device.type)  # type: ignore[arg-type]
