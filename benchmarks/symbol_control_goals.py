"""What the judge's trajectories come to: a row of measures for each run, and the goals that symbol control is held to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from symbol_control_cases import DISTURBED, DRIVING, STANDING, UNDISTURBED, UNTIL, Case

from luxloop.loop.recording.summary import AXES

BEGUN = 11  # from this step on the symbol is compared with the open loop, and judged while the car moves
END = 5  # steps of which the mean is the end, as in summaries
NEAR = 0.02  # of the undisturbed run's IoU: recovered
DARK = 100.0  # %: the centroid's error where nothing is lit
Row = dict[str, Any]
Judged = Mapping[str, Mapping[str, Any]]  # by controller

EVEN, CURVED = ("flat",), ("bumps", "grade + cross-fall", "mixed")
DISTURBANCES = tuple(scene for scene in DISTURBED if scene != UNDISTURBED)
SCANS, STEEP = ("Belgian block", "half-round bar", "torsion track", "rough course"), ("speed bump", "curb")


def measures(case: Case, judged: Judged, undisturbed: Judged | None = None) -> list[Row]:
    """A row a controller. undisturbed: the same without its disturbance, where it has one."""
    world = {"part": case.part, "scene": case.scene, "latency": case.latency, "seed": case.seed}
    opened = _series(judged["open"], "iou", 0.0)
    rows = []
    for controller, each in judged.items():
        iou = _series(each, "iou", 0.0)
        offset = np.stack([_series(each, axis, DARK) for axis in AXES])
        row = world | {
            "controller": controller,
            "iou_least": float(iou[BEGUN:].min()),
            "settle": len(iou) if each["settle_step"] is None else each["settle_step"],
            "overshoot": DARK if (offset == DARK).all() else each["overshoot_percent"],
            "gap": float((opened - iou)[BEGUN:].max()),
        }
        if case.part == "driving":
            row |= {"iou": float(iou[BEGUN:].mean()), "centroid": float(np.abs(offset[:, BEGUN:]).max(0).mean())}
        else:
            row |= {"iou": float(iou[-END:].mean()), "centroid": float(np.abs(offset[:, -END:].mean(1)).max())}
        if undisturbed is not None:
            worse = np.flatnonzero(iou[UNTIL:] < _series(undisturbed[controller], "iou", 0.0)[UNTIL:] - NEAR)
            row["recovery"] = int(worse[-1]) + 1 if len(worse) else 0
        rows.append(row)
    return rows


def _series(judged: Mapping[str, Any], name: str, missing: float) -> NDArray[np.float64]:
    return np.array([missing if value is None else value for value in judged[name]])


@dataclass(frozen=True)
class Goal:
    """What luxloop shall reach in some scenes of a part.

    each: of what the mean over seeds has to reach it; "all": that of all scenes and latencies together; "case": no mean at all, the worst
    run. limited: what keeps luxloop from it where it is missed.
    """

    what: str
    measure: str
    limit: float
    scenes: tuple[str, ...]
    limited: str
    least: bool = False
    each: Literal["all", "scene", "case"] = "scene"

    def worst(self, rows: Sequence[Row]) -> tuple[float, str] | None:
        """The value that counts, and where it is so; None where there is none."""
        groups: dict[str, list[float]] = {}
        for row in rows:
            if row["controller"] == "luxloop" and row["scene"] in self.scenes and row.get(self.measure) is not None:
                late = f", {row['latency']} late" if row["latency"] else ""
                name = {"all": "", "scene": row["scene"] + late, "case": f"{row['scene']}{late}, seed {row['seed']}"}[self.each]
                groups.setdefault(name, []).append(row[self.measure])
        means = [(float(np.mean(values)), name) for name, values in groups.items()]
        return (min if self.least else max)(means, default=None)

    def reached(self, value: float) -> bool:
        return value >= self.limit if self.least else value <= self.limit


ROADS = (*EVEN, *CURVED, *SCANS, *STEEP)
STRAYS = "4 steps with frames on time, 9 with frames 3 steps late"
FINE = "heights finer than the mesh drift"
MESH = "stones are finer than the mesh; drawn for the exact road: 0.1 to 0.6 %"
SHADOW = "the bump's back is in the lamp's shadow"
PIXELS = "heights are known to a fraction of a camera pixel, which spans 10 to 20 cm of the road there"
BODY = "late and noisy sensors [predict the body](../control.md#on-the-move)"
TRUE_POSE = "drawn for the true road and pose: {}"
LEFT = "noise leaves wrong heights, which later observations correct by a few percent a step"
LUCK = "in single steps the open loop happens to be right while the body swings"
GOALS = (
    Goal("Settling, mean of roads and latencies, at most 6 steps", "settle", 6, ROADS, STRAYS, each="all"),
    Goal("Overshoot at most 5 %", "overshoot", 5, ROADS, "heights from the first observation of a symbol far from its place"),
    Goal("Centroid at most 1 % off on flat, curved and measured roads", "centroid", 1, (*EVEN, *CURVED, *SCANS), MESH),
    Goal("Centroid at most 2 % off on speed bump and curb", "centroid", 2, STEEP, SHADOW),
    Goal("IoU at least 0.99 on the flat road", "iou", 0.99, EVEN, PIXELS, least=True),
    Goal("IoU at least 0.95 on bumps, grade + cross-fall and mixed", "iou", 0.95, CURVED, PIXELS, least=True),
    Goal("IoU at least 0.85 on speed bump and curb", "iou", 0.85, STEEP, SHADOW, least=True),
    Goal("Nowhere, at no step, more than 0.02 below the open loop: standing", "gap", 0.02, tuple(STANDING), FINE, each="case"),
    Goal("The same: moving", "gap", 0.02, tuple(DRIVING), LUCK, each="case"),
    Goal("The same: disturbed", "gap", 0.02, tuple(DISTURBED), LEFT, each="case"),
    Goal("Mean IoU at least 0.92 at 5 m/s", "iou", 0.92, ("5 m/s",), BODY + "; " + TRUE_POSE.format("0.84"), least=True),
    Goal("Mean IoU at least 0.88 at 10 m/s", "iou", 0.88, ("10 m/s",), TRUE_POSE.format("0.87"), least=True),
    Goal("Mean IoU at least 0.80 at 20 m/s", "iou", 0.80, ("20 m/s",), TRUE_POSE.format("0.80"), least=True),
    Goal("The same with a start height that is 3 cm wrong", "iou", 0.80, ("20 m/s, from 3 cm off",), TRUE_POSE.format("0.80"), least=True),
    Goal("Mean IoU at least 0.90 while the nose nods by 0.2°", "iou", 0.90, ("nods by 0.2°",), BODY, least=True),
    Goal("Mean IoU at least 0.60 while it nods by 1°", "iou", 0.60, ("nods by 1°",), BODY, least=True),
    Goal(
        "Steps to come within 0.02 of the undisturbed IoU after a disturbance, at most 10", "recovery", 10, DISTURBANCES, LEFT, each="case"
    ),
)
