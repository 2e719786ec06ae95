"""A plant's clock, counted from its start: the one place that knows when that was."""

from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from luxloop.controllers.situation import TrackedObject
from luxloop.loop.simulation.checked import check_arrivals, check_frame
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame, Plant
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import locate


@dataclass(frozen=True, eq=False)
class FromZero:
    """A plant in s since its start; its state is when that was, by the plant's clock, and the plant's own state. like: a tensor of the
    lamps', whose dtype and device frames and samples have.

    The plant gets back its own times to the bit, for the difference of two times is exact in float64 unless their magnitudes are far apart.
    """

    plant: Plant
    name: str
    camera: CameraParams
    like: Tensor

    @property
    def truth(self) -> World | None:
        """What is true at a time since the start, None where the plant does not know it."""
        return getattr(self.plant, "truth", None)

    def start(self) -> tuple[Any, Arrivals]:
        """State and arrivals before the first exposure, at 0 s. Raises LuxloopError where the plant gives no such thing."""
        with locate(f"{self.name}: start"):
            state, arrivals = check_arrivals(self.plant.start(), None, self.like)
        return (arrivals.time_s, state), _since(arrivals.time_s, arrivals)

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Show an exposure; what has come in by its end. Raises LuxloopError where the plant gives no such thing."""
        start_s, own = state
        exposure = replace(exposure, start_s=start_s + exposure.start_s)
        with locate(f"{self.name}: show"):
            own, arrivals = check_arrivals(self.plant.show(own, exposure), exposure, self.like)
            for frame in arrivals.frames:
                check_frame(frame, (start_s, arrivals.time_s), arrivals.time_s, self.camera, self.like)
        return (start_s, own), _since(start_s, arrivals)

    def close(self) -> None:
        """End what the plant holds open."""
        getattr(self.plant, "close", lambda: None)()


def _since(start_s: float, arrivals: Arrivals) -> Arrivals:
    def frame(each: Frame) -> Frame:
        shown = each.shown and replace(each.shown, start_s=each.shown.start_s - start_s)
        return replace(each, taken_s=each.taken_s - start_s, arrived_s=each.arrived_s - start_s, shown=shown)

    def object_(each: TrackedObject) -> TrackedObject:
        return replace(each, since_s=each.since_s - start_s, until_s=each.until_s - start_s)

    samples = (replace(each, measured_s=each.measured_s - start_s, arrived_s=each.arrived_s - start_s) for each in arrivals.samples)
    objects = None if arrivals.objects is None else tuple(map(object_, arrivals.objects))
    return Arrivals(arrivals.time_s - start_s, tuple(map(frame, arrivals.frames)), tuple(samples), objects)
