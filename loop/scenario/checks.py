"""Checks of a scenario: bounds on columns of its recording, which a run evaluates."""

from typing import Literal, Self

from pydantic import Field, model_validator

from luxloop.world.params import NotNegative, Params, in_order

Baseline = Literal["open_loop", "full_light", "low_beam"]
By = Literal["ratio", "difference", "recall"]


class CheckParams(Params):
    """Bounds on a statistic of a column of the recording over a window of time."""

    metric: str = Field(
        min_length=1,
        examples=["lamp.left.flux_lm"],
        description="column of the recording, such as `functions.symbol.iou` or `lamp.left.flux_lm`",
    )
    from_s: NotNegative = Field(0.0, description="start of the window")
    until_s: NotNegative | None = Field(None, description="end of the window, included; left out: the end of the run")
    take: Literal["mean", "min", "max", "last", "p50", "p90", "p99"] = Field(
        "mean", description="statistic of the values in the window; `p99`: the least value that 99 % of them do not exceed"
    )
    absolute: bool = Field(False, description="whether to take the statistic of the values' absolute amounts, as of signed errors")
    over_s: float | None = Field(
        None, gt=0, le=1e6, description="take the statistic of moving means over this time; left out: of the values themselves"
    )
    at_least: float | None = Field(None, ge=-1e12, le=1e12, description="lower bound")
    at_most: float | None = Field(None, ge=-1e12, le=1e12, description="upper bound; one of the two bounds is required")
    compare: Baseline | None = Field(
        None,
        description="baseline that runs beside in the same world with the same noise; the bounds then hold for the comparison `by`",
    )
    by: By = Field(
        "ratio",
        description="comparison with the baseline: `ratio` of both statistics, statistic of the `difference` per step, or `recall`: of the "
        "steps in which the baseline's value is above 0 the share in which the run's is as well",
    )

    _times_in_order = in_order("from_s", "until_s", strict=False)
    _bounds_in_order = in_order("at_least", "at_most", strict=False)

    @model_validator(mode="after")
    def _check_bounds(self) -> Self:
        if self.at_least is None and self.at_most is None:
            raise ValueError("has no bound; give at_least, at_most or both")
        if self.by != "ratio" and self.compare is None:
            raise ValueError(f"by: {self.by} compares with another light; give compare, or leave by out")
        if self.by == "recall" and (self.take != "mean" or self.over_s is not None):
            raise ValueError("by: recall counts steps, so that nothing else is taken of them; leave take and over_s out")
        if self.compare is not None and self.metric.endswith("_ms"):
            raise ValueError(f"compare: the runs share rendering, so {self.metric} cannot be compared; leave compare out")
        return self
