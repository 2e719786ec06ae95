"""A plant of hardware to which nothing is connected: it opens no socket and no device, so that a scenario can be checked and read."""

from typing import Any

from luxloop.loop.simulation.protocol import Arrivals, Exposure
from luxloop.world.errors import LuxloopError


class Unconnected:
    """Cannot be started."""

    def start(self) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        raise LuxloopError(
            "plant.kind: no rig is connected; run it with `luxloop run NAME --rig FILE`, or play a recording of it with --plant"
        )

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        return self.start()
