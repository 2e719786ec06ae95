"""A plant's clock shifted to zero at its start, and checks of the arrivals from a user's plant."""

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError
from torch import Tensor

from luxloop.controllers.situation import TrackedObject
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame, Plant, close_plant
from luxloop.loop.simulation.remote_messages import row_of
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import CameraParams
from luxloop.perception.egomotion import VALUES, Sample
from luxloop.world.errors import LuxloopError, did_you_mean, locate
from luxloop.world.plugin import in_a_line


@dataclass(frozen=True, eq=False)
class FromZero:
    """A plant whose time in s begins at 0. State: start time by the plant's clock, and the plant's state. like: tensor with the dtype and
    device of frames and samples.

    The plant gets its own times back to the bit: the difference of two times is exact in float64 unless their magnitudes are far apart.
    """

    plant: Plant
    name: str
    camera: CameraParams
    like: Tensor

    @property
    def truth(self) -> World | None:
        """The true world, by time since the start; None if the plant does not know it."""
        return getattr(self.plant, "truth", None)

    def start(self) -> tuple[Any, Arrivals]:
        """State and arrivals before the first exposure, at 0 s. Raises LuxloopError for invalid arrivals."""
        with locate(f"{self.name}: start"):
            state, arrivals = check_arrivals(self.plant.start(), None, self.like)
        return (arrivals.time_s, state), _since(arrivals.time_s, arrivals)

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """State and arrivals after an exposure. Raises LuxloopError for invalid arrivals."""
        start_s, own = state
        exposure = replace(exposure, start_s=start_s + exposure.start_s)
        with locate(f"{self.name}: show"):
            own, arrivals = check_arrivals(self.plant.show(own, exposure), exposure, self.like)
            for frame in arrivals.frames:
                check_frame(frame, (start_s, arrivals.time_s), arrivals.time_s, self.camera, self.like)
        return (start_s, own), _since(start_s, arrivals)

    def close(self) -> None:
        """Close the plant, if it can be closed."""
        close_plant(self.plant)


def _since(start_s: float, arrivals: Arrivals) -> Arrivals:
    def frame(each: Frame) -> Frame:
        shown = each.shown and replace(each.shown, start_s=each.shown.start_s - start_s)
        return replace(each, taken_s=each.taken_s - start_s, arrived_s=each.arrived_s - start_s, shown=shown)

    def object_(each: TrackedObject) -> TrackedObject:
        return replace(each, since_s=each.since_s - start_s, until_s=each.until_s - start_s)

    samples = (replace(each, measured_s=each.measured_s - start_s, arrived_s=each.arrived_s - start_s) for each in arrivals.samples)
    objects = None if arrivals.objects is None else tuple(map(object_, arrivals.objects))
    return Arrivals(arrivals.time_s - start_s, tuple(map(frame, arrivals.frames)), tuple(samples), objects)


ROUNDING_S = 1e-6  # rounding of summed periods and of clocks that count from 1970
TIME = "give the plant's time in s, as a number"
KINDS = {  # fields of arrivals: type and remedy
    "frames": (Frame, "luxloop.Frame; give frames=(luxloop.Frame(...),), or () where none has come"),
    "samples": (Sample, "luxloop.Sample; give samples=(luxloop.Sample(...),), or leave them out"),
    "objects": (TrackedObject, "TrackedObject; give objects=(...), or leave them out"),
}


def check_arrivals(gave: Any, exposure: Exposure | None, like: Tensor) -> tuple[Any, Arrivals]:
    """State and arrivals from a plant, checked. gave: its return value. exposure: None at the start. like: tensor with the dtype and device
    of samples.

    Raises LuxloopError for anything else. `check_frame` checks times and images of frames.
    """
    if not isinstance(gave, tuple) or len(gave) != 2 or not isinstance(gave[1], Arrivals):
        what = f"({', '.join(type(each).__name__ for each in gave)})" if isinstance(gave, tuple) else type(gave).__name__
        raise LuxloopError(f"gives {what}; return the state and luxloop.Arrivals, as (state, arrivals)")
    arrivals = gave[1]
    if not _is_time(arrivals.time_s) or not math.isfinite(arrivals.time_s):
        raise LuxloopError(f"gives the time_s {arrivals.time_s!r}; {TIME}")
    if exposure is not None and arrivals.time_s <= exposure.start_s:
        raise LuxloopError(
            f"gives the time_s {arrivals.time_s:g} after an exposure that began at {exposure.start_s:g} s; give the time at its end, "
            "such as exposure.start_s + exposure.duration_s"
        )
    for key, (kind, remedy) in KINDS.items():
        values = getattr(arrivals, key)
        if not ((key == "objects" and values is None) or (isinstance(values, tuple) and all(isinstance(each, kind) for each in values))):
            raise LuxloopError(f"gives {key} that are no tuple of {remedy}")
    for frame in arrivals.frames:
        if not isinstance(frame.number, int):
            raise LuxloopError(f"gives a frame of exposure {frame.number!r}; number it as its exposure, exposure.number")
        with locate(f"frame {frame.number}"):
            _check_times(frame.taken_s, frame.arrived_s)
            if not isinstance(frame.shown, Exposure | None):
                raise LuxloopError(f"has shown = {type(frame.shown).__name__}; give a luxloop.Exposure, or leave it out")
    _check_samples(arrivals, like)
    objects = arrivals.objects or ()
    if twice := [name for name, count in Counter(each.name for each in objects).items() if count > 1]:
        raise LuxloopError(f"gives two objects of the name {twice[0]!r}; give each a name of its own")
    for each in objects:
        try:
            row_of(each)
        except ValidationError as error:
            raise LuxloopError(f"object {each.name}: {in_a_line(error)}") from error
    return gave


def _check_samples(arrivals: Arrivals, like: Tensor) -> None:
    """Raises LuxloopError for samples of an unknown sensor, or with invalid times or values. like: tensor with their dtype and device."""
    for sample in arrivals.samples:
        if sample.sensor not in VALUES:
            raise LuxloopError(f"gives a sample of {sample.sensor!r}; {did_you_mean(str(sample.sensor), VALUES)}")
        with locate(f"sample of {sample.sensor}"):
            _check_times(sample.measured_s, sample.arrived_s)
            if not sample.measured_s <= sample.arrived_s + ROUNDING_S <= arrivals.time_s + 2 * ROUNDING_S:
                raise LuxloopError(
                    f"was measured at {sample.measured_s:.10g} s and arrived at {sample.arrived_s:.10g} s, by time_s = "
                    f"{arrivals.time_s:.10g}; give the plant's time in s, and a sample when it has arrived"
                )
            count = VALUES[sample.sensor]
            if not _is_like(sample.values, like) or sample.values.ndim != 1 or (count and len(sample.values) != count):
                raise LuxloopError(
                    f"has values that are {_described(sample.values)}; give a tensor [{count or 'n'}], {like.dtype} on {like.device}"
                )
            if not sample.values.isfinite().all():
                raise LuxloopError(f"has the values {sample.values.tolist()}, which are not finite; give none where it tells nothing")


def check_frame(frame: Frame, span_s: tuple[float, float], now_s: float, camera: CameraParams, like: Tensor) -> None:
    """Raises LuxloopError for a frame taken outside span_s, arrived after now_s, or with an image that does not fit the camera."""
    if frame.image is None:
        return
    with locate(f"frame {frame.number}"):
        (start_s, end_s), taken_s, arrived_s = span_s, frame.taken_s, frame.arrived_s
        if not start_s - ROUNDING_S <= taken_s <= end_s + ROUNDING_S:
            raise LuxloopError(f"was taken at {taken_s:.10g} s, not from {start_s:.10g} to {end_s:.10g} s; give the plant's time in s")
        if not taken_s - ROUNDING_S <= arrived_s <= now_s + ROUNDING_S:
            raise LuxloopError(
                f"was taken at {taken_s:.10g} s and arrived at {arrived_s:.10g} s, by time_s = {now_s:.10g}; "
                "give the plant's time in s, and a frame when it has come"
            )
        image, size, most = frame.image, (camera.height_px, camera.width_px), 2**camera.bits - 1
        if not _is_like(image, like) or image.shape != size:
            raise LuxloopError(
                f"has an image that is {_described(image)}; give a tensor {list(size)}, as camera.height_px and width_px say, "
                f"{like.dtype} on {like.device}"
            )
        if not image.isfinite().all():
            raise LuxloopError("has an image that is not finite; a frame that is lost has the image None")
        low, high = float(image.min()), float(image.max())
        if low < 0 or high > most:
            raise LuxloopError(
                f"has an image from {low:.4g} to {high:.4g}; digital numbers of camera.bits = {camera.bits} are 0 to {most}: scale it, "
                "and clamp it"
            )


def _check_times(*times_s: Any) -> None:
    """Raises LuxloopError for a time that is not a number."""
    if strange := [each for each in times_s if not _is_time(each)]:
        raise LuxloopError(f"has the time {strange[0]!r}; {TIME}")


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float)


def _is_like(value: Any, like: Tensor) -> bool:
    return isinstance(value, Tensor) and (value.dtype, value.device) == (like.dtype, like.device)


def _described(value: Any) -> str:
    return f"a {value.dtype} {list(value.shape)} on {value.device}" if isinstance(value, Tensor) else f"a {type(value).__name__}"
