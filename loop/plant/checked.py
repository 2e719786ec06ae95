"""What a plant of the user's own hands over, refused in a sentence where the loop could make nothing, or something wrong, of it."""

import math
from typing import Any

from torch import Tensor

from loop.plant.protocol import Arrivals, Exposure, Frame
from perception.camera import CameraParams
from perception.egomotion import VALUES, Sample
from world.errors import LuxloopError, did_you_mean, located

ROUNDING_S = 1e-6  # of sums of periods and of clocks that count from 1970


def pair(gave: Any) -> tuple[Any, Arrivals]:
    """State and arrivals. Raises LuxloopError where it is something else."""
    if not isinstance(gave, tuple) or len(gave) != 2 or not isinstance(gave[1], Arrivals):
        what = f"({', '.join(type(each).__name__ for each in gave)})" if isinstance(gave, tuple) else type(gave).__name__
        raise LuxloopError(f"gives {what}; return the state and luxloop.Arrivals, as (state, arrivals)")
    return gave


def check_time(arrivals: Arrivals, exposure: Exposure | None) -> None:
    """Raises LuxloopError where the plant's time is none, or has not gone on since an exposure began."""
    if not isinstance(arrivals.time_s, int | float) or not math.isfinite(arrivals.time_s):
        raise LuxloopError(f"gives the time_s {arrivals.time_s!r}; give the plant's time in s, as a number")
    if exposure is not None and arrivals.time_s <= exposure.start_s:
        raise LuxloopError(
            f"gives the time_s {arrivals.time_s:g} after an exposure that began at {exposure.start_s:g} s; give the time at its end, "
            "such as exposure.start_s + exposure.duration_s"
        )


def check_frames(arrivals: Arrivals) -> None:
    """Raises LuxloopError where its frames are none."""
    if not isinstance(arrivals.frames, tuple) or not all(isinstance(frame, Frame) for frame in arrivals.frames):
        raise LuxloopError("gives frames that are no tuple of luxloop.Frame; give frames=(luxloop.Frame(...),), or () where none has come")


def check_samples(arrivals: Arrivals) -> None:
    """Raises LuxloopError where its samples are none, or are not what their sensors tell."""
    if not isinstance(arrivals.samples, tuple) or not all(isinstance(sample, Sample) for sample in arrivals.samples):
        raise LuxloopError("gives samples that are no tuple of luxloop.Sample; give samples=(luxloop.Sample(...),), or leave them out")
    for sample in arrivals.samples:
        if sample.sensor not in VALUES:
            raise LuxloopError(f"gives a sample of {sample.sensor!r}; {did_you_mean(str(sample.sensor), VALUES)}")
        count, values = VALUES[sample.sensor], sample.values
        if not isinstance(values, Tensor) or values.ndim != 1 or (count and len(values) != count) or not values.isfinite().all():
            raise LuxloopError(f"gives a sample of {sample.sensor} whose values are no {count or 'n'} finite numbers in a tensor")


def check_frame(frame: Frame, start_s: float, now_s: float, camera: CameraParams) -> None:
    """Raises LuxloopError for a frame that cannot be of an exposure from the plant's start to now, or of the camera."""
    if not isinstance(frame.number, int):
        raise LuxloopError(f"gives a frame of exposure {frame.number!r}; number it as its exposure, exposure.number")
    if frame.image is None:
        return
    with located(f"frame {frame.number}"):
        if not start_s - ROUNDING_S <= frame.taken_s <= frame.arrived_s + ROUNDING_S <= now_s + 2 * ROUNDING_S:
            raise LuxloopError(
                f"was taken at {frame.taken_s:.10g} s and arrived at {frame.arrived_s:.10g} s, but the plant's time is {start_s:.10g} "
                f"to {now_s:.10g} s; give the plant's time in s, and a frame when it has come"
            )
        check_image(frame.image, camera)


def check_image(image: Any, camera: CameraParams) -> None:
    """Raises LuxloopError where it holds no digital numbers of the camera."""
    size, most = (camera.height_px, camera.width_px), 2**camera.bits - 1
    if not isinstance(image, Tensor) or not image.is_floating_point() or image.shape != size:
        what = f"{image.dtype} {list(image.shape)}" if isinstance(image, Tensor) else type(image).__name__
        raise LuxloopError(f"has an image that is a {what}; give a tensor of floats {list(size)}, as camera.height_px and width_px say")
    if not image.isfinite().all():
        raise LuxloopError("has an image that is not finite; a frame that is lost has the image None")
    low, high = float(image.min()), float(image.max())
    if low < 0 or high > most:
        raise LuxloopError(
            f"has an image from {low:.4g} to {high:.4g}; digital numbers of camera.bits = {camera.bits} are 0 to {most}: scale it, and "
            "clamp it"
        )
