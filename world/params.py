"""Base of every parameter model: what a scenario file may say about a thing lives with the thing."""

from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, field_validator

SMALLEST: Final = 1e-12  # magnitude of a number that is not 0: what is divided by it, squared, stays finite in single precision

Metres = Annotated[float, Field(ge=-10_000, le=10_000)]
Degrees = Annotated[float, Field(ge=-180, le=180)]


class Params(BaseModel):
    """A frozen, validated value; unknown keys and non-finite numbers are errors. SI units, degrees only where a name ends in `_deg`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    @field_validator("*")
    @classmethod
    def _not_vanishing(cls, value: Any) -> Any:
        numbers = value if isinstance(value, tuple) else (value,)
        if tiny := [each for each in numbers if isinstance(each, float) and 0 < abs(each) < SMALLEST]:
            raise ValueError(f"{tiny[0]:g} is too close to 0 to compute with; give 0, or at least {SMALLEST:g} in magnitude")
        return value
