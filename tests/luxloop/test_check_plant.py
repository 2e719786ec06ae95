"""The contract of plants: what keeps it passes, and each way of breaking it has a sentence with cause and remedy."""

import math
from dataclasses import replace
from itertools import count
from typing import Any

import pytest
import torch

from luxloop import Arrivals, Exposure, Frame, LuxloopError, Sample, Utilisation, check_plant, simulated_plant
from luxloop.loop.studies.contracts.plant import check_in, worlds


@pytest.fixture(scope="module")
def shared() -> Any:
    return worlds("auto")


class Kept:
    """The simulated world, without its truth; its frames come `late` exposures late."""

    def __init__(self, scenario: Any, modules: Any, late: int = 0) -> None:
        self.inner, self.late = simulated_plant(scenario, modules), late

    def start(self) -> Any:
        return (self.inner.start()[0], ()), self.inner.start()[1]

    def show(self, state: Any, exposure: Exposure) -> Any:
        inner, queue = state
        inner, arrivals = self.inner.show(inner, exposure)
        frames = (*queue, *(self.made(frame, exposure) for frame in arrivals.frames))
        come = max(len(frames) - self.late, 0)
        return (inner, frames[come:]), self.said(arrivals, tuple(self.come(each, arrivals) for each in frames[:come]))

    def come(self, frame: Frame, arrivals: Arrivals) -> Any:
        return replace(frame, arrived_s=arrivals.time_s) if self.late else frame

    def said(self, arrivals: Arrivals, frames: Any) -> Any:
        return replace(arrivals, frames=frames)

    def made(self, frame: Frame, exposure: Exposure) -> Any:
        return frame


class Warming(Kept):
    """Keeps the light that it showed last."""

    def show(self, state: Any, exposure: Exposure) -> Any:
        (inner, _), arrivals = super().show((state[0], ()), exposure)
        return (inner, exposure.lights), arrivals


class Losing(Kept):
    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        return frame if frame.number % 3 else Frame(frame.number, math.nan, math.nan, None)


class Dropping(Kept):
    """Of some frames it never says a word."""

    def said(self, arrivals: Arrivals, frames: Any) -> Arrivals:
        return replace(arrivals, frames=tuple(frame for frame in frames if frame.number % 3), samples=())


class Slow(Kept):
    """Its time goes on as it likes, and its sensors tell nothing."""

    def __init__(self, scenario: Any, modules: Any) -> None:
        self.dark = modules[0].headlight.matrix.values.new_zeros(scenario.camera.height_px, scenario.camera.width_px)

    def start(self) -> Any:
        return 100.0, Arrivals(100.0)

    def show(self, state: Any, exposure: Exposure) -> Any:
        end_s = state + 0.02 + 0.001 * (exposure.number % 3)
        return end_s, Arrivals(end_s, (Frame(exposure.number, state + 0.004, end_s, self.dark),))


class Sampling(Kept):
    """Its gyro is 4 ms late."""

    def samples(self, time_s: float, values: torch.Tensor) -> Any:
        return (Sample("wheels", time_s, time_s, values[:2]), Sample("gyro", time_s - 0.004, time_s, values))

    def said(self, arrivals: Arrivals, frames: Any) -> Any:
        return replace(arrivals, frames=frames, samples=self.samples(arrivals.time_s, frames[0].image[0, :3] if frames else torch.zeros(3)))


@pytest.mark.parametrize("kept", [Kept, Warming, Losing, Dropping, Slow, Sampling])
def test_what_keeps_the_contract_passes(kept: Any, shared: Any) -> None:
    check_in(shared, kept, {})


@pytest.mark.parametrize("late", [1, 5, 20])
def test_frames_may_come_late(late: int, shared: Any) -> None:
    check_in(shared, Kept, {"late": late})


class NoShow:
    def __init__(self, scenario: Any, modules: Any) -> None: ...

    def start(self) -> None: ...


class OtherCall(Kept):
    def show(self, exposure: Exposure) -> Any:  # type: ignore[override]
        return super().show(((), ()), exposure)


class ArrivalsAlone(Kept):
    def show(self, state: Any, exposure: Exposure) -> Any:
        return super().show(state, exposure)[1]


class PlainTuple(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Any:
        return (arrivals.time_s, frames)


class LockedState(Kept):
    def start(self) -> Any:
        return (super().start()[0], count()), Arrivals(0.0)


class StateInSelf(Kept):
    """Hands on no state, which a simulated camera that is not late does not miss."""

    def start(self) -> Any:
        self.state, arrivals = self.inner.start()
        return None, arrivals

    def show(self, state: Any, exposure: Exposure) -> Any:
        self.state, arrivals = self.inner.show(self.state, exposure)
        return None, arrivals


class QueueInSelf(Kept):
    """Its frames wait in itself, so that an old state finds what came later."""

    def __init__(self, scenario: Any, modules: Any) -> None:
        super().__init__(scenario, modules)
        self.last: dict[int, Any] = {}

    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        assert frame.image is not None
        self.last[exposure.number] = frame.image
        return replace(frame, image=self.last[max(self.last)])


class OneBuffer(Kept):
    def __init__(self, scenario: Any, modules: Any) -> None:
        super().__init__(scenario, modules)
        self.buffer = modules[0].headlight.matrix.values.new_zeros(scenario.camera.height_px, scenario.camera.width_px)

    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        self.buffer += 1
        return replace(frame, image=self.buffer)


class Unseeded(Kept):
    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        assert frame.image is not None
        return replace(frame, image=(frame.image + torch.rand_like(frame.image).round()).clamp(max=4095))


class DimsInPlace(Kept):
    def show(self, state: Any, exposure: Exposure) -> Any:
        for light in exposure.lights:
            light.u.mul_(0.8)
        return super().show(state, exposure)


class StandsStill(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Arrivals:
        return Arrivals(0.0, frames)


class NoTime(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Arrivals:
        return Arrivals(math.nan, frames)


class List(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Any:
        return Arrivals(arrivals.time_s, list(frames))  # type: ignore[arg-type]


class ImagesAlone(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Any:
        return Arrivals(arrivals.time_s, tuple(frame.image for frame in frames))


class CountsFromOne(Kept):
    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        return replace(frame, number=frame.number + 1)


class Again(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Arrivals:
        return replace(arrivals, frames=2 * frames)


class Swapped(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Arrivals:
        return replace(arrivals, frames=frames[::-1])

    def show(self, state: Any, exposure: Exposure) -> Any:
        self.late = (exposure.number + 1) % 2
        return super().show(state, exposure)


class Milliseconds(Kept):
    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        return replace(frame, taken_s=1e3 * frame.taken_s, arrived_s=1e3 * frame.arrived_s)


class SinceMidnight(Kept):
    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        return replace(frame, taken_s=80_000 + frame.taken_s)


class Backwards(Kept):
    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        return replace(frame, arrived_s=exposure.start_s - 0.01)


class FromTheFuture(Kept):
    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        return replace(frame, arrived_s=frame.arrived_s + 0.1)


class Pictures(Kept):
    """Its images are something else."""

    def made(self, frame: Frame, exposure: Exposure) -> Frame:
        assert frame.image is not None
        return replace(frame, image=self.picture(frame.image))

    def picture(self, image: torch.Tensor) -> Any:
        return image


class Transposed(Pictures):
    def picture(self, image: torch.Tensor) -> torch.Tensor:
        return image.T


class Bytes(Pictures):
    def picture(self, image: torch.Tensor) -> torch.Tensor:
        return image.to(torch.uint8)


class Arrays(Pictures):
    def picture(self, image: torch.Tensor) -> Any:
        return image.cpu().numpy()


class Shares(Pictures):
    def picture(self, image: torch.Tensor) -> torch.Tensor:
        return image / 4095


class Luminance(Pictures):
    def picture(self, image: torch.Tensor) -> torch.Tensor:
        return 0.37 * image


class SixteenBits(Pictures):
    def picture(self, image: torch.Tensor) -> torch.Tensor:
        return 16 * image + 4096


class LostAsNothing(Pictures):
    def picture(self, image: torch.Tensor) -> torch.Tensor:
        return torch.full_like(image, math.nan)


class Silent(Kept):
    def said(self, arrivals: Arrivals, frames: Any) -> Arrivals:
        return replace(arrivals, frames=())


class Pairs(Sampling):
    def samples(self, time_s: float, values: torch.Tensor) -> Any:
        return ((time_s, values),)


class Radar(Sampling):
    def samples(self, time_s: float, values: torch.Tensor) -> Any:
        return (Sample("wheel", time_s, time_s, values),)  # type: ignore[arg-type]


class TwoRates(Sampling):
    def samples(self, time_s: float, values: torch.Tensor) -> Any:
        return (Sample("gyro", time_s, time_s, values[:2]),)


class InMilliseconds(Sampling):
    def samples(self, time_s: float, values: torch.Tensor) -> Any:
        return (Sample("gyro", 1e3 * time_s, 1e3 * time_s, values),)


class Omniscient(Kept):
    truth = "all of it"


BROKEN: dict[Any, list[str]] = {
    NoShow: ["has no method show; it needs start, show"],
    OtherCall: ["show takes (exposure", "is called as show(state, exposure)"],
    ArrivalsAlone: ["show: gives Arrivals", "return the state and luxloop.Arrivals"],
    PlainTuple: ["show: gives (tuple, tuple)", "as (state, arrivals)"],
    LockedState: ["start gives a state that cannot be saved: state[1] is of the type count", "frozen dataclass"],
    StateInSelf: ["another (state, arrivals)[1].frames", "same state and exposure", "in the state and not in self"],
    QueueInSelf: ["when an earlier state is shown its exposure again after others", "in the state and not in self"],
    OneBuffer: ["changes (state, arrivals)[1].frames[0].image, which it returned before", "with clone()"],
    Unseeded: ["another (state, arrivals)[1].frames[0].image", "same state and exposure", "seed random numbers anew"],
    DimsInPlace: ["changes exposure.lights[0].u, which was passed to it", "without operations in place"],
    StandsStill: ["gives the time_s 0 after an exposure that began at 0 s", "exposure.start_s + exposure.duration_s"],
    NoTime: ["gives the time_s nan; give the plant's time in s"],
    List: ["no tuple of luxloop.Frame", "or () where none has come"],
    ImagesAlone: ["no tuple of luxloop.Frame"],
    CountsFromOne: ["a frame of exposure 1, which was not shown", "exposure.number"],
    Again: ["the frame of exposure 0 twice", "take it out of the state"],
    Swapped: ["the frame of exposure 0 after that of exposure 1", "in the order of their exposures"],
    Milliseconds: ["frame 0: arrived at 16.6667 s, after time_s = 0.0166667; give times in s"],
    SinceMidnight: ["frame 0: was taken at 80000 s, but its exposure lasted from 0 to 0.0166667 s", "the plant's time in s"],
    Backwards: ["frame 0: arrived at -0.01 s, before it was taken at 0 s", "never runs backwards"],
    FromTheFuture: ["frame 0: arrived at 0.116667 s, after time_s = 0.0166667", "a frame when it has come"],
    Transposed: ["frame 0: has an image that is a torch.float32 [320, 180]", "give a tensor [180, 320]"],
    Bytes: ["has an image that is a torch.uint8 [180, 320]", "torch.float32 on"],
    Arrays: ["has an image that is a ndarray"],
    Shares: ["no whole numbers; it seems to hold shares: multiply it by 4095"],
    Luminance: ["no whole numbers; it may hold a luminance: give digital numbers of 0 to 4095"],
    SixteenBits: ["digital numbers of camera.bits = 12 are 0 to 4095"],
    LostAsNothing: ["has an image that is not finite; a frame that is lost has the image None"],
    Silent: ["no frame of 24 exposures has arrived or been reported lost"],
    Pairs: ["gives samples that are no tuple of luxloop.Sample", "or leave them out"],
    Radar: ["gives a sample of 'wheel'", "did you mean 'wheels'"],
    TwoRates: ["sample of gyro: has values that are a torch.float32 [2]", "give a tensor [3], torch.float32 on"],
    InMilliseconds: ["sample of gyro: was measured at", "give the plant's time in s"],
    Omniscient: ["truth is of the type str", "simulated_plant"],
}


@pytest.mark.parametrize("broken", BROKEN, ids=lambda each: each.__name__)
def test_each_way_to_break_the_contract_is_told_in_a_sentence(broken: Any, shared: Any) -> None:
    with pytest.raises(LuxloopError) as caught:
        check_in(shared, broken, {})
    (sentence,) = caught.value.args
    assert f"plant.kind: {__name__}:{broken.__name__}: " in sentence
    assert all(words in sentence for words in BROKEN[broken]), sentence


class Dimmed:
    """As docs/python.md has it."""

    def __init__(self, scenario: Any, modules: Any, share: float = 0.8) -> None:
        self.inner, self.share = simulated_plant(scenario, modules), share
        self.truth = self.inner.truth

    def start(self) -> Any:
        return self.inner.start()

    def show(self, state: Any, exposure: Exposure) -> Any:
        dimmed = tuple(Utilisation(self.share * light.u, light.band) for light in exposure.lights)
        return self.inner.show(state, replace(exposure, lights=dimmed))


def test_options_are_those_of_the_scenario(device: torch.device) -> None:
    check_plant(Dimmed, {"share": 0.6}, device.type)
    with pytest.raises(LuxloopError, match=r"plant\.options\.shar: .*did you mean 'share'\?"):
        check_plant(Dimmed, {"shar": 0.6}, device.type)
    with pytest.raises(LuxloopError, match="is not a class; give the class itself"):
        check_plant(3, device=device.type)  # type: ignore[arg-type]
