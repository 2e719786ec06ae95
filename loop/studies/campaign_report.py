"""Report of a campaign as Markdown: means and worst cases over seeds, a picture, and failed runs."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.report.style import DEFAULTS, drawing
from luxloop.loop.run import torch_device
from luxloop.loop.studies.campaign import TABLE, Row, run_campaign
from luxloop.loop.studies.jobs import Results, dask, local
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write

REPORT, PICTURE = "report.md", "report.png"
# metric: (label, whether more is better)
SHOWN = {
    "settle_step": ("settle step", False),
    "overshoot_percent": ("overshoot in %", False),
    "residual_percent": ("centroid error in %", False),
    "iou_open": ("IoU without control, at the last step", True),
    "iou_final": ("IoU, at the last step", True),
    "iou_mean": ("IoU, mean of all evaluated steps", True),
    "dark_lx_max": ("light on masked objects, lx", False),
    "symbol_iou_min": ("least IoU of symbols", True),
    "flux_lm_mean": ("flux of all lamps, lm", False),
    "energy_j": ("energy, J", False),
    "confidence_final_mean": ("confidence at the end", True),
    "confidence_final_min": ("confidence at the end, least of all objects", True),
    "eyes_lx_max_after_start_up": ("light on heads and windscreens, lx", False),
}


def do_campaign(file: Path, out: Path | None, processes: int | None, scheduler: str | None, device: str, allow_code: bool) -> bool:
    """Run a campaign, write its report, print its table and failed runs; returns whether all runs succeeded."""
    if processes is not None and scheduler is not None:
        raise LuxloopError("--jobs: applies to this machine, but --scheduler has its own workers; give one of the two")
    folder = out or Path("runs") / file.stem
    executor = local(processes) if scheduler is None else dask(scheduler)
    campaign = run_campaign(file, folder, device=str(torch_device(device)), executor=executor, allow_code=allow_code)
    for key, reason in campaign.failures.items():
        tables.say(f"failed: {key}: {reason}", stderr=True)
    write_report(file.stem, campaign, folder)
    tables.show(overview(campaign))
    print(f"{folder / TABLE} and {folder / REPORT} written")
    return not campaign.failures


def write_report(name: str, campaign: Results, out: Path) -> None:
    """Write page and picture into a folder. Raises LuxloopError on a write error."""
    _draw(campaign, out / PICTURE)
    atomic_write(out / REPORT, page(name, campaign))


def overview(campaign: Results) -> Table:
    """Means and worst cases over seeds for the terminal."""
    return tables.plain(*_figures(campaign))


def page(name: str, campaign: Results) -> str:
    """The campaign as Markdown."""
    table = tables.markdown_table(*_figures(campaign), "lllr")
    failed = "".join(f"- {key}: {reason}\n" for key, reason in campaign.failures.items())
    runs = f"{len(campaign.rows)} runs, {len(campaign.failures)} failed."
    note = f"{runs} Means over seeds, the worst in brackets; `{TABLE}` has all figures."
    return f"# {name}\n\n{note}\n\n{table}\n\n![Figures of all runs]({PICTURE})\n" + (f"\n## Failed\n\n{failed}" if failed else "")


def _figures(campaign: Results) -> tuple[list[str], list[list[str]]]:
    """Column names, and a row for each scenario, controller and variant."""
    kinds = _kinds(campaign)
    body = [
        [*names, str(len(some)), *(_over(some, kind) for kind in kinds)]
        for names, some in _groups(campaign.rows, ("scenario", "controller", "variant"))
    ]
    return ["scenario", "controller", "variant", "seeds", *(SHOWN[kind][0] for kind in kinds)], body


def _kinds(campaign: Results) -> list[str]:
    """Metrics that at least one run has."""
    return [kind for kind in SHOWN if any(row.get(kind) is not None for row in campaign.rows)]


def _over(rows: Sequence[Row], kind: str) -> str:
    values = [row[kind] for row in rows if row.get(kind) is not None]
    lacking = len(rows) - len(values)
    if not values:
        return "–"
    worst = min(values) if SHOWN[kind][1] else max(values)
    return f"{np.mean(values):.3g} ({worst:.3g})" + (f", none in {lacking}" if lacking else "")


def _groups(rows: Iterable[Row], names: Sequence[str]) -> list[tuple[tuple[str, ...], list[Row]]]:
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(str(row[name] or "") for name in names), []).append(row)
    return list(groups.items())


def _draw(campaign: Results, file: Path) -> None:
    """One panel per metric: scenarios along x, a colour for each controller and variant, a dot for each seed."""
    kinds = _kinds(campaign) or ["settle_step"]
    scenarios = list(dict.fromkeys(row["scenario"] for row in campaign.rows))
    series = _groups(campaign.rows, ("controller", "variant"))
    with drawing(file, (max(6.0, 1.2 * len(scenarios) + 3), 0.6 + 1.9 * len(kinds)), DEFAULTS) as figure:
        panels = figure.subplots(len(kinds), sharex=True, squeeze=False)[:, 0]
        for axes, kind in zip(panels, kinds, strict=True):
            for number, (names, rows) in enumerate(series):
                offset = 0.6 * ((number + 0.5) / len(series) - 0.5)
                points = [(scenarios.index(row["scenario"]) + offset, row[kind]) for row in rows if row.get(kind) is not None]
                axes.plot(*np.array(points).reshape(-1, 2).T, "o", ms=4, alpha=0.7, label=", ".join(filter(None, names)) or "all")
            axes.set_ylabel(SHOWN[kind][0].replace(", ", ",\n"), fontsize=8)
            axes.grid(alpha=0.3)
        panels[0].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        panels[-1].set_xticks(range(len(scenarios)), scenarios, rotation=30, ha="right", fontsize=8)
