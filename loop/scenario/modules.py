"""Where the light of a module comes from: the scenario's lamp, or a real one whose beam is digitised live (T 4.3)."""

from typing import Literal

from pydantic import Field

from luxloop.world.params import Params


class ModuleSourceParams(Params):
    """One module of the lamps, by its name, or its lamp's side where that has a single one."""

    source: Literal["simulated", "digitised"] = Field(
        "simulated", description="simulated, or digitised from a picture of a real lamp's light on a screen; needs `--rig FILE`"
    )
    latency_s: float = Field(
        0.0, ge=0, le=10, description="delay of digitised light in the simulated world; at 0 the world waits for the light"
    )
    delay_body: bool = Field(
        False, description="whether the motion of the vehicle's body on its springs is delayed by latency_s, so that it matches the light"
    )

    def late_steps(self, rate_hz: float) -> int:
        """Control steps, rate_hz of them a second, by which its light is late, and its body as well where that is delayed."""
        return round(self.latency_s * rate_hz)
