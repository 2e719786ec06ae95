"""Probes: luxmeters in the world, on the car or on an object."""

from typing import Self

from pydantic import Field, field_validator, model_validator

from luxloop.world.params import Metres, Params, Real


class ProbeParams(Params):
    """A luxmeter for the light of the own lamps."""

    position_m: tuple[Metres, Metres, Metres] = Field(examples=[[50.0, 1.75, 1.1]], description="position in frame")
    frame: str = Field(
        "world", description='"world", "car" (body frame, origin below the middle of the lamps), or an object, with which it moves'
    )
    facing: tuple[Real, Real, Real] | None = Field(
        None, examples=[[-1.0, 0.0, 0.0]], description="surface normal in frame; left out: the surface faces each module in turn"
    )

    adaptation_cd_m2: float | None = Field(
        None,
        ge=0.05,
        le=5,
        description="mean road luminance to which an eye at the probe is adapted, which looks along facing: adds its veil and threshold "
        "increment; left out: neither",
    )

    @field_validator("facing")
    @classmethod
    def _somewhere(cls, facing: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if facing is not None and not any(facing):
            raise ValueError("a surface cannot face 0, 0, 0; give a direction such as [-1, 0, 0]")
        return facing

    @model_validator(mode="after")
    def _an_eye_looks(self) -> Self:
        if self.adaptation_cd_m2 is not None and self.facing is None:
            raise ValueError("adaptation_cd_m2: an eye looks somewhere; give facing, such as [-1, 0, 0]")
        return self
