"""Base of every parameter model: what a scenario file may say about a thing lives with the thing."""

from pydantic import BaseModel, ConfigDict


class Params(BaseModel):
    """A frozen, validated value; unknown keys and non-finite numbers are errors. SI units, degrees only where a name ends in `_deg`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)
