"""Intersection over union with and without warp and supervisor, and after a survey, on four roads and behind a box: docs/control.md."""

import itertools

from luxloop.loop.report.terminal import markdown
from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import load

STEPS, MEANT = 30, 10
BOX = '[{kind="box", name="box", size_m=[0.4, 0.5, 0.3], albedo=0.2, track=[{position_m=[15.5, 0.2, 0.0]}]}]'
ROADS = {
    "mixed": ("snowflake", ()),
    "bumps": ("snowflake", ("road.kind=bumps",)),
    "speed bump": ("speed_bump", ()),
    "curb": ("curb", ()),
    "box on a flat road": ("snowflake", ("road.kind=flat", f"objects={BOX}")),
}
STAGES = {"alone": "", "warp": ", warp={}", "both": ", warp={}, supervisor={}"}


def iou(scenario: str, changes: tuple[str, ...], controller: str) -> float:
    """Mean of the last steps."""
    results = prepare(load(scenario, [*changes, f"functions.symbol.controller={controller}", f"steps={STEPS}"]), "cpu").run()
    return sum(float(result.symbol.verdict.iou) for result in list(results)[-MEANT:]) / MEANT


def main() -> None:
    """Print the table."""
    names = ["thesis_pid", "gauss_newton"]
    columns = [f"`{name}` {stage}" for name, stage in itertools.product(names, STAGES)]
    rows = []
    for road, (scenario, changes) in ROADS.items():
        controllers = ['{name="open"}', '{name="feedforward", survey=true}']
        controllers += (f'{{name="{name}"{keys}}}' for name, keys in itertools.product(names, STAGES.values()))
        rows.append((road, *(f"{iou(scenario, changes, each):.2f}" for each in controllers)))
    print(markdown(("road", "open loop", "survey", *columns), rows))


if __name__ == "__main__":
    main()
