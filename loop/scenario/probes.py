"""Probes: lux meters in the world, on the car or on an object."""

from pydantic import Field, field_validator

from luxloop.world.params import Metres, Params, Real


class ProbeParams(Params):
    """A lux meter: the illuminance from the lamps at a place."""

    position_m: tuple[Metres, Metres, Metres] = Field(examples=[[50.0, 1.75, 1.1]], description="place in its frame")
    frame: str = Field(
        "world", description='"world", "car" (x forward from below the middle of the lamps), or the name of an object that carries it'
    )
    facing: tuple[Real, Real, Real] | None = Field(
        None, examples=[[-1.0, 0.0, 0.0]], description="direction in its frame that its surface faces; left out: each module"
    )

    @field_validator("facing")
    @classmethod
    def _somewhere(cls, facing: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if facing is not None and not any(facing):
            raise ValueError("a surface cannot face 0, 0, 0; give a direction such as [-1, 0, 0]")
        return facing
