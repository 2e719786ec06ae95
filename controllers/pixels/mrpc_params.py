"""How setpoints become utilisations: the parameters of MRPC (T 7.4, 7.5.2)."""

from typing import Literal, Self

from pydantic import Field, model_validator

from controllers.pixels.sampling import Sampling
from world.params import Params


class MrpcParams(Params):
    """Mapping, exclusion and reduction (T 7.4, 7.5.2, 8.5)."""

    a_m: float = Field(1.0, ge=0, le=8, description="mapping: 0 shares a setpoint equally among its pixels, 1 by what they can give")
    a_r: float = Field(
        1.0, ge=0, le=8, description="reduction: 0 averages utilisations, 1 conserves light, 2 is the least-squares solution"
    )
    a_x: float = Field(0.0, ge=0, le=1, description="exclusion: texels below this share of a pixel's maximum do not count, 0 for none")
    exclusion: Literal["capability", "printed"] = Field(
        "capability", description="what a_x looks at: what a pixel can give at a texel, or the setpoint as T eq. 7.4.3 prints it"
    )
    a_ac: float = Field(0.0, ge=0, le=1, description="activation: a pixel with a smaller share of lit setpoints is off")
    a_d: float | None = Field(
        None, gt=0, le=1e6, description="edge darkening: dims setpoints where the lamp gives less than a_d times its mean"
    )
    lower_cd: float = Field(0.0, ge=0, le=1e9, description="least intensity that a pixel is asked for at a texel that a primitive covers")
    upper_cd: float | None = Field(
        None, gt=0, le=1e9, description="greatest intensity that a pixel is asked for at a texel that a primitive covers"
    )
    mapping: Literal["potentiated", "direct", "maximal"] = Field(
        "potentiated",
        description="potentiated shares by a_m and granularity; without them, direct asks each pixel for everything, maximal the strongest",
    )
    shape: Literal["arbitrary", "rectangle"] = Field(
        "arbitrary", description="pixels as they are, or simplified to the rectangles around their texels above a_x (0.5 if a_x is 0)"
    )
    sampling: Sampling = Field("all", description="which of its texels a pixel asks: all, one of them, or a pattern of supersampling")
    granularity: float = Field(0.0, ge=0, le=4, description="mapping: the power by which smaller pixels are asked for more")
    sharpening: float = Field(0.0, ge=0, le=4, description="by how much setpoints beside dark ones are raised to make up for blur")
    corrections: int = Field(0, ge=0, le=10, description="how often setpoints are raised by what the light of all pixels lacks of them")

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        if self.upper_cd is not None and self.upper_cd < self.lower_cd:
            raise ValueError(f"upper_cd: {self.upper_cd:g} is below lower_cd, {self.lower_cd:g}; exchange them")
        return self
