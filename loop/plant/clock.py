"""A plant's clock, counted from its start: the one place that knows when that was."""

from dataclasses import dataclass, replace
from typing import Any

from loop.plant.protocol import Arrivals, Exposure, Frame, Plant
from loop.plant.world import World


@dataclass(frozen=True, eq=False)
class FromZero:
    """A plant in s since its start; its state is when that was, by the plant's clock, and the plant's own state.

    The plant gets back its own times to the bit, for the difference of two times is exact in float64 unless their magnitudes are far apart.
    """

    plant: Plant

    @property
    def truth(self) -> World | None:
        """What is true at a time since the start, None where the plant does not know it."""
        return getattr(self.plant, "truth", None)

    def start(self) -> tuple[Any, Arrivals]:
        """State and arrivals before the first exposure, at 0 s."""
        state, arrivals = self.plant.start()
        return (arrivals.time_s, state), _since(arrivals.time_s, arrivals)

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Show an exposure; what has come in by its end."""
        start_s, own = state
        own, arrivals = self.plant.show(own, replace(exposure, start_s=start_s + exposure.start_s))
        return (start_s, own), _since(start_s, arrivals)


def _since(start_s: float, arrivals: Arrivals) -> Arrivals:
    def frame(each: Frame) -> Frame:
        shown = each.shown and replace(each.shown, start_s=each.shown.start_s - start_s)
        return replace(each, taken_s=each.taken_s - start_s, arrived_s=each.arrived_s - start_s, shown=shown)

    samples = (replace(each, measured_s=each.measured_s - start_s, arrived_s=each.arrived_s - start_s) for each in arrivals.samples)
    return Arrivals(arrivals.time_s - start_s, tuple(map(frame, arrivals.frames)), tuple(samples))
