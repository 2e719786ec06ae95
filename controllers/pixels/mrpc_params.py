"""Parameters of MapReduce pixel control (T 7.4, 7.5.2)."""

from typing import Literal, Self

from pydantic import Field, model_validator

from luxloop.controllers.pixels.sampling import Sampling
from luxloop.world.params import Params


class MrpcParams(Params):
    """MapReduce pixel control: mapping, exclusion and reduction (T 7.4, 7.5.2, 8.5)."""

    a_m: float = Field(
        1.0, ge=0, le=8, description="mapping: 0 shares a setpoint equally among its pixels, 1 in proportion to their intensities"
    )
    a_r: float = Field(
        1.0, ge=0, le=8, description="reduction: 0 averages utilisations, 1 conserves light, 2 is the least-squares solution"
    )
    a_x: float = Field(0.0, ge=0, le=1, description="exclusion: texels below this share of a pixel's maximum are ignored; 0: none")
    exclusion: Literal["capability", "printed"] = Field(
        "capability", description="a_x applies to a pixel's intensity at a texel (capability), or to the setpoint as printed in T eq. 7.4.3"
    )
    a_ac: float = Field(0.0, ge=0, le=1, description="activation threshold: a pixel with a smaller share of lit setpoints is off")
    a_d: float | None = Field(
        None, gt=0, le=1e6, description="edge darkening: dims setpoints where the lamp gives less than a_d times its mean intensity"
    )
    lower_cd: float = Field(0.0, ge=0, le=1e9, description="lower bound of a pixel's setpoint at texels that a primitive covers")
    upper_cd: float | None = Field(None, gt=0, le=1e9, description="upper bound of a pixel's setpoint at texels that a primitive covers")
    mapping: Literal["potentiated", "direct", "maximal"] = Field(
        "potentiated",
        description="potentiated: by a_m and granularity; direct: the whole setpoint to each pixel; maximal: relative to the strongest",
    )
    shape: Literal["arbitrary", "rectangle"] = Field(
        "arbitrary", description="pixel shapes as they are, or simplified to the rectangles around their texels above a_x (0.5 if a_x is 0)"
    )
    sampling: Sampling = Field("all", description="texels that a pixel samples: all, one, or a supersampling pattern")
    granularity: float = Field(0.0, ge=0, le=4, description="mapping: exponent by which smaller pixels get larger shares")
    sharpening: float = Field(0.0, ge=0, le=4, description="strength by which setpoints beside dark ones are raised to compensate blur")
    corrections: int = Field(0, ge=0, le=10, description="number of corrections of the setpoints by the error of the resulting light")

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        if self.upper_cd is not None and self.upper_cd < self.lower_cd:
            raise ValueError(f"upper_cd: {self.upper_cd:g} is below lower_cd, {self.lower_cd:g}; exchange them")
        return self
