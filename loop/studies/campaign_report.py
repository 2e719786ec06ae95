"""Report of a campaign as Markdown: means with bootstrap intervals, paired tests corrected for their number, limits of the controllers,
pictures, and failed runs.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from matplotlib.axes import Axes
from rich.table import Table
from scipy import stats

from luxloop.loop.report import terminal as tables
from luxloop.loop.report.style import DEFAULTS, drawing
from luxloop.loop.run import torch_device
from luxloop.loop.studies.campaign import TABLE, TRAJECTORIES, Row, run_campaign
from luxloop.loop.studies.jobs import Results, dask, local
from luxloop.world.arrays import read_parquet
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write

CONFIDENCE = 0.95
RESAMPLES = 5000


@dataclass(frozen=True)
class Mean:
    """A mean, and its 95 % interval by the bootstrap's percentiles (Efron 1979); both ends are the mean for a single value."""

    value: float
    low: float
    high: float


def mean(values: Sequence[float]) -> Mean:
    """Mean of at least one value."""
    value = float(np.mean(values))
    if len(values) < 2:
        return Mean(value, value, value)
    found = stats.bootstrap(
        (np.asarray(values, float),), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, method="percentile", rng=0
    )
    return Mean(value, float(found.confidence_interval.low), float(found.confidence_interval.high))


def compare_pairs(first: Sequence[float], second: Sequence[float]) -> tuple[Mean, float]:
    """Mean of the differences second - first of runs in pairs, and p of the two-sided signed-rank test (Wilcoxon 1945)."""
    differences = np.subtract(second, first)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all differences are zero
        p = float(stats.wilcoxon(differences).pvalue) if differences.any() else 1.0
    return mean(differences.tolist()), p


def holm(p: Sequence[float]) -> list[float]:
    """Values of p of several tests, corrected for their number (Holm 1979)."""
    order = np.argsort(p)
    stepped = np.maximum.accumulate(np.asarray(p)[order] * np.arange(len(p), 0, -1))
    corrected = np.empty(len(p))
    corrected[order] = stepped.clip(max=1.0)
    return corrected.tolist()


REPORT, PICTURE, RESPONSES = "report.md", "report.png", "responses.png"
MOST_PANELS = 6  # columns of the picture of responses
BAND = (10, 90)  # percentiles


@dataclass(frozen=True)
class Metric:
    """A metric on the page. lacking: what a run without a value counts as; "steps": all its steps; None: it does not count."""

    label: str
    more_is_better: bool
    lacking: float | str | None = None

    def of(self, row: Row, name: str) -> float | None:
        """Value of a run with which means are made."""
        value = row.get(name)
        return value if value is not None else row["steps"] if self.lacking == "steps" else self.lacking  # type: ignore[return-value]


SHOWN = {
    "settle_step": Metric("settle step", False, "steps"),
    "overshoot_percent": Metric("overshoot in %", False),
    "residual_percent": Metric("centroid error in %", False, 100.0),
    "iou_open": Metric("IoU without control, at the last step", True, 0.0),
    "iou_final": Metric("IoU, at the last step", True, 0.0),
    "iou_mean": Metric("IoU, mean of all evaluated steps", True, 0.0),
    "dark_lx_max": Metric("light on masked objects, lx", False),
    "symbol_iou_min": Metric("least IoU of symbols", True, 0.0),
    "flux_lm_mean": Metric("flux of all lamps, lm", False),
    "energy_j": Metric("energy, J", False),
    "confidence_final_mean": Metric("confidence at the end", True, 0.0),
    "confidence_final_min": Metric("confidence at the end, least of all objects", True, 0.0),
    "eyes_lx_max_after_start_up": Metric("light on heads and windscreens, lx", False),
}
SERIES = ("controller", "variant")


def campaign(
    file: Path | str,
    folder: Path | str | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    device: str = "auto",
    allow_code: bool = False,
) -> Results:
    """Run a campaign file (docs/campaigns.md) and write table and report.

    folder: by default runs/FILE; an interrupted campaign continues from there. jobs: processes, each with one thread; by default one per
    core. scheduler: address of a Dask scheduler whose workers run the scenarios. device: "auto", "cpu" or "cuda". allow_code: whether
    Python modules that the file names may run. The result has `rows`, one for each run as in runs.parquet, and `failures`, reasons by key
    of a run. Raises LuxloopError for an invalid file, lost workers, or a folder with other files.
    """
    if jobs is not None and scheduler is not None:
        raise LuxloopError("jobs: applies to this machine, but a scheduler has its own workers; give one of the two")
    file = Path(file)
    out = Path(folder or Path("runs") / file.stem)
    executor = local(jobs) if scheduler is None else dask(scheduler)
    results = run_campaign(file, out, device=str(torch_device(device)), executor=executor, allow_code=allow_code)
    write_report(file.stem, results, out)
    return results


def write_report(name: str, campaign: Results, out: Path) -> None:
    """Write page and pictures into a folder. Raises LuxloopError on a write error."""
    _draw(campaign, out / PICTURE)
    steps = read_parquet(out / TRAJECTORIES) if (out / TRAJECTORIES).is_file() else None
    if steps is not None:
        _draw_responses(steps, out / RESPONSES)
    atomic_write(out / REPORT, page(name, campaign, responses=steps is not None))


def overview(campaign: Results) -> Table:
    """Means over seeds with their intervals for the terminal."""
    return tables.plain(*_figures(campaign))


def page(name: str, campaign: Results, *, responses: bool = False) -> str:
    """The campaign as Markdown. responses: whether there is a picture of the trajectories."""
    columns, body = _figures(campaign)
    compared, limits = _comparisons(campaign), _limits(campaign)
    parts = [
        f"# {name}",
        f"{len(campaign.rows)} runs, {len(campaign.failures)} failed. Means over seeds with 95 % bootstrap intervals, the worst in round "
        "brackets; runs that failed or lack a value count as IoU 0, a centroid error of 100 % and a settle step at their end. "
        f"`{TABLE}` has all figures.",
        tables.markdown_table(columns, body, "lllr"),
        f"![Figures of all runs]({PICTURE})",
    ]
    if responses:
        parts.append(f"![IoU and distance by step: medians and bands from {BAND[0]} to {BAND[1]} % of all seeds]({RESPONSES})")
    if compared:
        parts += [
            "## Comparisons",
            "Differences of runs with the same seed, with 95 % bootstrap intervals, and p of Wilcoxon's signed-rank test, corrected for "
            "the number of comparisons of a metric (Holm).",
            tables.markdown_table(["metric", "scenario", "of", "to", "pairs", "difference", "p"], compared, "llllrrr"),
        ]
    if limits:
        head = [*dict.fromkeys(name for each in limits.values() for name in each)]
        rows = [[key, *(_text(each.get(name)) for name in head)] for key, each in limits.items()]
        parts += ["## Limits", "Limits in which the controllers differ:", tables.markdown_table(["key", *head], rows)]
    failed = "".join(f"- {key}: {reason}\n" for key, reason in campaign.failures.items())
    return "\n\n".join(parts) + "\n" + (f"\n## Failed\n\n{failed}" if failed else "")


def _figures(campaign: Results) -> tuple[list[str], list[list[str]]]:
    """Column names, and a row for each scenario, controller and variant."""
    kinds, held = _kinds(campaign), any("settle_step" in row for row in campaign.rows)
    body = []
    for names, some in _groups(campaign.rows, ("scenario", *SERIES)):
        failed = sum(bool(row["error"]) for row in some)
        settled = [f"{sum(row.get('settle_step') is not None for row in some)} of {len(some)}"] if held else []
        body.append([*names, str(len(some)), str(failed), *settled, *(_over(some, kind) for kind in kinds)])
    return ["scenario", *SERIES, "runs", "failed", *(["settled"] if held else []), *(SHOWN[kind].label for kind in kinds)], body


def _kinds(campaign: Results) -> list[str]:
    """Metrics that at least one run has."""
    return [kind for kind in SHOWN if any(row.get(kind) is not None for row in campaign.rows)]


def _over(rows: Sequence[Row], kind: str) -> str:
    metric = SHOWN[kind]
    values = [value for row in rows if (value := metric.of(row, kind)) is not None]
    lacking = len(rows) - len(values)
    if not values:
        return "–"
    worst = min(values) if metric.more_is_better else max(values)
    return (
        _interval(mean(values), len(values)) + (f" ({worst:.3g})" if len(values) > 1 else "") + (f", none in {lacking}" if lacking else "")
    )


def _interval(found: Mean, count: int) -> str:
    return f"{found.value:.3g}" + (f" [{found.low:.3g}, {found.high:.3g}]" if count > 1 else "")


def _comparisons(campaign: Results) -> list[list[str]]:
    """Rows of comparisons: of each controller with the first one in the same variant, and of the first one's variants with the first."""
    found = []
    for kind in _kinds(campaign):
        tests = []
        for (scenario,), rows in _groups(campaign.rows, ("scenario",)):
            series = {names: {row["seed"]: SHOWN[kind].of(row, kind) for row in some} for names, some in _groups(rows, SERIES)}
            first_controller, first_variant = next(iter(series))
            for controller, variant in series:
                other = (first_controller, variant if controller != first_controller else first_variant)
                if other == (controller, variant) or other not in series:
                    continue
                mine, others = series[controller, variant], series[other]
                pairs = [(others[seed], mine[seed]) for seed in mine if mine[seed] is not None and others.get(seed) is not None]
                if len(pairs) > 1 and any(a != b for a, b in pairs):
                    difference, p = compare_pairs(*zip(*pairs, strict=True))
                    tests.append((scenario, (controller, variant), other, len(pairs), difference, p))
        for (scenario, of, to, count, difference, _), p in zip(tests, holm([each[-1] for each in tests]), strict=True):
            names = (", ".join(filter(None, each)) for each in (of, to))
            found.append([SHOWN[kind].label, scenario, *names, str(count), _interval(difference, count), f"{p:.2g}"])
    return found


def _limits(campaign: Results) -> Mapping[str, Mapping[str, Any]]:
    """Limits by key and controller in which the controllers of a campaign differ."""
    limits: dict[str, dict[str, Any]] = {}
    for row in campaign.rows:
        for key, value in row.items():
            if key.startswith("limit.") and value is not None:
                limits.setdefault(key.removeprefix("limit."), {})[row["controller"]] = value
    controllers = {row["controller"] for row in campaign.rows}
    return {key: each for key, each in limits.items() if len({*each.values()}) > 1 or each.keys() != controllers}


def _text(value: Any) -> str:
    return "–" if value is None else str(value)


def _groups(rows: Iterable[Row], names: Sequence[str]) -> list[tuple[tuple[str, ...], list[Row]]]:
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(str(row[name] or "") for name in names), []).append(row)
    return list(groups.items())


def _draw_responses(steps: pa.Table, file: Path) -> None:
    """IoU and distance of the centroid by step, a column for each scenario and variant: medians and bands of all seeds by controller."""
    away = pc.sqrt(pc.add(*(pc.power(steps[f"centroid_error_{axis}_percent"], 2) for axis in "xy")))
    rows = steps.append_column("away", away).select(["scenario", "variant", "controller", "step", "iou", "away"]).to_pylist()
    panels = _groups(rows, ("scenario", "variant"))[:MOST_PANELS]
    with drawing(file, (3.2 * len(panels) + 1.5, 5.0), DEFAULTS) as figure:
        axes = figure.subplots(2, len(panels), sharex="col", sharey="row", squeeze=False)
        for (upper, lower), (names, some) in zip(axes.T, panels, strict=True):
            for (controller,), mine in _groups(some, ("controller",)):
                _draw_band(upper, mine, "iou", controller)
                _draw_band(lower, mine, "away", controller)
            upper.set_title(", ".join(filter(None, names)), fontsize=9)
            lower.set_xlabel("step")
        axes[0, 0].set(ylabel="IoU", ylim=(0, 1))
        axes[1, 0].set(ylabel="distance of the centroid,\n% of the symbol", yscale="symlog", ylim=(0, None))
        axes[0, -1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        for panel in axes.flat:
            panel.grid(alpha=0.3)


def _draw_band(axes: Axes, rows: Sequence[Row], key: str, label: str) -> None:
    """Median of a column by step, in a band of its percentiles."""
    step, values = np.array([(row["step"], row[key]) for row in rows if row[key] is not None]).reshape(-1, 2).T
    at = np.unique(step)
    low, middle, high = np.array([np.percentile(values[step == each], (BAND[0], 50, BAND[1])) for each in at]).reshape(-1, 3).T
    (line,) = axes.plot(at, middle, lw=1.2, label=label)
    axes.fill_between(at, low, high, color=line.get_color(), alpha=0.2, lw=0)


def _draw(campaign: Results, file: Path) -> None:
    """One panel per metric: scenarios along x, a colour for each controller and variant, a dot for each seed."""
    kinds = _kinds(campaign) or ["settle_step"]
    scenarios = list(dict.fromkeys(row["scenario"] for row in campaign.rows))
    series = _groups(campaign.rows, SERIES)
    with drawing(file, (max(6.0, 1.2 * len(scenarios) + 3), 0.6 + 1.9 * len(kinds)), DEFAULTS) as figure:
        panels = figure.subplots(len(kinds), sharex=True, squeeze=False)[:, 0]
        for axes, kind in zip(panels, kinds, strict=True):
            for number, (names, rows) in enumerate(series):
                offset = 0.6 * ((number + 0.5) / len(series) - 0.5)
                points = [(scenarios.index(row["scenario"]) + offset, row[kind]) for row in rows if row.get(kind) is not None]
                axes.plot(*np.array(points).reshape(-1, 2).T, "o", ms=4, alpha=0.7, label=", ".join(filter(None, names)) or "all")
            axes.set_ylabel(SHOWN[kind].label.replace(", ", ",\n"), fontsize=8)
            axes.grid(alpha=0.3)
        panels[0].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        panels[-1].set_xticks(range(len(scenarios)), scenarios, rotation=30, ha="right", fontsize=8)
