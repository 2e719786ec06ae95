"""Base of all parameter models; each model lies beside the code that it configures."""

import re
from itertools import pairwise
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, WithJsonSchema, field_validator, model_validator

SMALLEST: Final = 1e-12  # least value of a positive number: division by its square stays finite in single precision

Share = Annotated[float, Field(ge=0, le=1)]
PositiveShare = Annotated[float, Field(gt=0, le=1)]
Metres = Annotated[float, Field(ge=-10_000, le=10_000)]
Distance = Annotated[float, Field(ge=0, le=10_000)]  # m
Length = Annotated[float, Field(gt=0, le=10_000)]  # m
Degrees = Annotated[float, Field(ge=-180, le=180)]
Slope = Annotated[float, Field(ge=-90, le=90)]  # deg
Real = Annotated[float, Field(ge=-1e6, le=1e6)]
NotNegative = Annotated[float, Field(ge=0, le=1e6)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
ModuleName = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[^/]+$")]  # a part of names of files
PLAIN = "[a-z][a-z0-9_]*"


def _plain(name: str) -> str:
    if not re.fullmatch(PLAIN, name):
        better = re.sub("[^a-z0-9]+", "_", name.lower()).lstrip("_0123456789").rstrip("_")
        rule = "names have lower-case letters, digits and _, with a letter first"
        raise ValueError(f"{name!r} is not a valid name: {rule}; write {better or 'another'}")
    return name


PlainName = Annotated[str, AfterValidator(_plain), WithJsonSchema({"type": "string", "pattern": f"^{PLAIN}$"})]  # of a column, say


def in_order(low: str, high: str, strict: bool = True) -> Any:
    """A validator that refuses a value of the key `high` below that of `low`, or equal to it if strict; None is no bound."""

    def check(self: Any) -> Any:
        least, most = getattr(self, low), getattr(self, high)
        if least is not None and most is not None and (most < least or (strict and most == least)):
            raise ValueError(f"{high}: {most:g} is {'not above' if strict else 'below'} {low} = {least:g}; raise {high}, or reduce {low}")
        return self

    return model_validator(mode="after")(check)


def ascending(key: str) -> AfterValidator:
    """A validator that refuses entries whose values of a key do not ascend."""

    def check(entries: Any) -> Any:
        values = [getattr(each, key) for each in entries]
        if any(later <= earlier for earlier, later in pairwise(values)):
            raise ValueError(f"{key} must ascend from entry to entry, here {values}")
        return entries

    return AfterValidator(check)


class Params(BaseModel):
    """A frozen, validated value; unknown keys and non-finite numbers are errors. SI units, degrees only where a name ends in `_deg`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True, defer_build=True)

    @field_validator("*")
    @classmethod
    def _not_vanishing(cls, value: Any, info: ValidationInfo) -> Any:
        positive = any(getattr(each, "gt", None) == 0 for each in cls.model_fields[str(info.field_name)].metadata)
        if positive and isinstance(value, float) and value < SMALLEST:
            raise ValueError(f"{value:g} is too close to 0 to compute with; give at least {SMALLEST:g}")
        return value
