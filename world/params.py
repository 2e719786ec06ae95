"""Base of every parameter model: what a scenario file may say about a thing lives with the thing."""

from typing import Annotated, Any, Final

from annotated_types import Gt
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

SMALLEST: Final = 1e-12  # least value of a number that has to be positive: what is divided by its square stays finite in single precision

Metres = Annotated[float, Field(ge=-10_000, le=10_000)]
Degrees = Annotated[float, Field(ge=-180, le=180)]


class Params(BaseModel):
    """A frozen, validated value; unknown keys and non-finite numbers are errors. SI units, degrees only where a name ends in `_deg`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    @field_validator("*")
    @classmethod
    def _not_vanishing(cls, value: Any, info: ValidationInfo) -> Any:
        positive = any(isinstance(each, Gt) and each.gt == 0 for each in cls.model_fields[str(info.field_name)].metadata)
        if positive and isinstance(value, float) and value < SMALLEST:
            raise ValueError(f"{value:g} is too close to 0 to compute with; give at least {SMALLEST:g}")
        return value
