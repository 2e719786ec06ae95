"""The checks of a run: bounds on columns of its recording, some in comparison with the same world under a baseline's light."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import get_args

import numpy as np
import pyarrow as pa

from luxloop.loop.recording.remedies import why_empty
from luxloop.loop.recording.summary import Summary, column
from luxloop.loop.scenario.checks import Baseline, By, CheckParams
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.world.regulation import Result

ROUNDING_S = 1e-6  # at the ends of a window, for sums of periods and clocks that count from 1970
IN_FULL_LIGHT = " in full light"  # end of the names of columns
FAILURES = 3  # failing requirements of a rule that a line names
BEAM_OFF = 'the base beam is off; set lighting.base.beam = "low", say'


class Checks:
    """The checks of a run and the runs of their baselines: `step` after each step, `outcomes` at the end."""

    def __init__(self, checks: Mapping[str, CheckParams], beside: Callable[[Baseline], Iterator[Summary]] | None) -> None:
        """beside: starts the run of a baseline, which yields plain values by column for each step; None leaves out checks that compare."""
        self._checks = {name: check for name, check in checks.items() if beside or check.compare is None}
        self._runs = {} if beside is None else {light: beside(light) for light in baselines(self._checks)}
        self._rows: dict[Baseline, list[Summary]] = {light: [] for light in self._runs}
        self._rules: list[tuple[float, str, Mapping[str, tuple[Result, ...]]]] = []  # time, base beam, failing requirements by rule

    def step(self, result: Evaluation) -> None:
        """Add a step, and step the runs of all baselines, which share the renderings of the run."""
        if result.rules:
            self._rules.append((result.time_s, result.plan.base.name, result.rules))
        for light, run in self._runs.items():
            values = next(run)
            self._rows[light].append({name: values.get(name) for name in ("time_s", *(check.metric for check in self._checks.values()))})

    def with_full_light(self, table: pa.Table) -> pa.Table:
        """The table of the run so far, with the values in full light of the columns that checks compare with it as further columns."""
        rows = self._rows.get("full_light", [])
        for name in dict.fromkeys(check.metric for check in self._checks.values() if check.compare == "full_light"):
            values = [each[name] for each in rows] + [None] * (table.num_rows - len(rows))
            field = pa.field(name + IN_FULL_LIGHT, pa.float64(), metadata=table.schema.field(name).metadata)
            table = table.append_column(field, pa.array(values, pa.float64()))
        return table

    def outcomes(self, table: pa.Table) -> dict[str, Summary]:
        """Outcome of each check, by name, ready for JSON. table: rows of the run so far."""
        found = {name: outcome(check, table, self._rows) for name, check in self._checks.items()}
        for name, each in found.items():
            each["reasons"] += [] if each["passed"] else self._failures(self._checks[name])
        return found

    def _failures(self, check: CheckParams) -> list[str]:
        """Requirements that fail the rule of a check, in the step of its window with the most; none of another check."""
        rule = check.metric.removeprefix("rules.")
        steps = [(beam, rules.get(rule, ())) for time_s, beam, rules in self._rules if _in_window(check, np.array(time_s))]
        beam, failures = max(steps, key=lambda step: len(step[1]), default=("", ()))
        return [BEAM_OFF] if failures and beam == "off" and not any(each.value for each in failures) else [*map(str, failures)]


def outcome(check: CheckParams, table: pa.Table, beside: Mapping[Baseline, Sequence[Summary]]) -> Summary:
    """Outcome of a check. beside: rows of the baselines' runs, one a step."""
    amount = np.abs if check.absolute else np.asarray
    times_s, values, other = column(table, "time_s"), amount(column(table, check.metric)), None
    value = held = _value(check, times_s, values)
    if check.compare is not None:
        others = amount(np.array([row[check.metric] for row in beside[check.compare]], dtype=np.float64))
        other = _value(check, times_s, others)
        if check.by == "ratio":
            held = ratio(value, other)
        else:
            held = _value(check, times_s, values - others if check.by == "difference" else np.where(others > 0, values > 0, math.nan))
    by = dict.fromkeys(get_args(By))
    return {
        **check.model_dump(include={"metric", "from_s", "until_s", "take", "absolute", "over_s", "compare", "at_least", "at_most"}),
        "run_until_s": float(times_s[-1]) if len(times_s) else None,
        "unit": table.schema.field(check.metric).metadata[b"unit"].decode(),
        "value": value,
        "compared_value": other,
        **(by | {check.by: None if check.compare is None or held is None or math.isinf(held) else held}),
        "passed": held is not None and _within(check, held),
        "reasons": [_no_value(check, table, times_s, values)] if value is None else [],
    }


def _no_value(check: CheckParams, table: pa.Table, times_s: np.ndarray, values: np.ndarray) -> str:
    """Why a check has no value, with a remedy."""
    there = np.isfinite(values)
    if len(times_s) and check.from_s > times_s[-1] + ROUNDING_S:
        return f"begins at {check.from_s:g} s, the run ends at {times_s[-1]:.4g} s (raise steps)"
    if (there & _in_window(check, times_s)).any():
        return f"the window is shorter than over_s = {check.over_s:g}; lower over_s, or raise steps"
    if there.any():
        first, last = times_s[there][[0, -1]]
        return f"has values from {first:.4g} to {last:.4g} s only; choose from_s and until_s to include some"
    return why_empty(check.metric, table)


def ratio(value: float | None, other: float | None) -> float | None:
    """Value divided by other: 1 if both are 0, infinite if only other is 0, None if either is None."""
    if value is None or other is None:
        return None
    return value / other if other else math.copysign(math.inf, value) if value else 1.0


def baselines(checks: Mapping[str, CheckParams]) -> tuple[Baseline, ...]:
    """Baselines that checks compare with, each once."""
    return tuple(dict.fromkeys(check.compare for check in checks.values() if check.compare is not None))


def success(summary: Summary) -> bool:
    """Whether all checks of a run passed, by its summary."""
    return all(outcome["passed"] for outcome in summary["checks"].values())


def lines(summary: Summary) -> dict[str, str]:
    """A line for each check of a run, for tables."""
    return {f"check {name}": _line(outcome) for name, outcome in summary["checks"].items()}


def _line(outcome: Summary) -> str:
    unit = "" if outcome["unit"] in ("", "1") else f" {outcome['unit']}"
    over = "" if outcome["over_s"] is None else f" over {outcome['over_s']:g} s"
    metric = f"|{outcome['metric']}|" if outcome["absolute"] else outcome["metric"]
    parts = [f"{outcome['take']} {metric}{over}"]
    if outcome["value"] is not None:
        parts[0] += f" {outcome['value']:.4g}{unit}" + " failing requirements" * metric.startswith("rules.")
        if outcome["compare"] is not None:
            parts.append(_comparison(outcome, unit))
    of_bound = unit if outcome["compare"] is None or outcome["difference"] is not None else ""
    for bound in (each for each in ("at_least", "at_most") if outcome[each] is not None):
        given = f"{100 * outcome[bound]:.4g} %" if outcome["recall"] is not None else f"{outcome[bound]:g}{of_bound}"
        parts.append(f"{bound.replace('_', ' ')} {given}")
    reasons, more = outcome["reasons"][:FAILURES], len(outcome["reasons"]) - FAILURES
    if reasons:
        parts.append("; ".join(reasons) + (f"; {more} more" if more > 0 else ""))
    return f"{', '.join(parts)}: {'passed' if outcome['passed'] else 'failed'}"


def _comparison(outcome: Summary, unit: str) -> str:
    light, other = outcome["compare"].replace("_", " "), outcome["compared_value"]
    if other is None:
        return f"no value with {light}"
    if outcome["recall"] is not None:
        return f"above 0 in {100 * outcome['recall']:.4g} % of the steps in which it is above 0 with {light}"
    if outcome["difference"] is not None:
        return f"{outcome['take']} {outcome['difference']:+.4g}{unit} relative to {light}"
    share = "an infinite multiple" if outcome["ratio"] is None else f"{outcome['ratio']:.4g}"
    return f"{share} of {other:.4g}{unit} with {light}"


def _value(check: CheckParams, times_s: np.ndarray, values: np.ndarray) -> float | None:
    """A check's statistic of values `[steps]`; None where no step in the window has a value."""
    inside = np.isfinite(values) & _in_window(check, times_s)
    there = values[inside] if check.over_s is None else _moving_means(times_s[inside], values[inside], check.over_s)
    if not len(there):
        return None
    if check.take.startswith("p"):
        return float(np.percentile(there, int(check.take[1:]), method="inverted_cdf"))
    return float(there[-1] if check.take == "last" else getattr(there, check.take)())


def _in_window(check: CheckParams, times_s: np.ndarray) -> np.ndarray:
    until_s = math.inf if check.until_s is None else check.until_s
    return (times_s >= check.from_s - ROUNDING_S) & (times_s <= until_s + ROUNDING_S)


def _moving_means(times_s: np.ndarray, values: np.ndarray, over_s: float) -> np.ndarray:
    """Mean of the values of the last over_s seconds, both ends included, for each step at which over_s seconds have passed."""
    firsts = np.searchsorted(times_s, times_s - over_s - ROUNDING_S)
    whole = (k for k in range(len(times_s)) if times_s[k] - times_s[0] >= over_s - ROUNDING_S)
    return np.array([values[firsts[k] : k + 1].mean() for k in whole])


def _within(check: CheckParams, value: float) -> bool:
    return (check.at_least is None or value >= check.at_least) and (check.at_most is None or value <= check.at_most)
