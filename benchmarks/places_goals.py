"""What the judge's trajectories on hard roads come to: a row of measures for each world and controller, and the goals of luxloop there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from places_cases import FEEDFORWARD, Place
from symbol_control_goals import DARK, END

from luxloop.loop.recording.summary import AXES

VISIBLE = 0.8  # share of the target's cells that lamp and camera allow at least where goals hold
LOOKS = 3  # after the first frame, within which a symbol is found
NOTHING = 0.05  # IoU of a symbol that nobody recognises
Row = dict[str, Any]


def measures(place: Place, found: Mapping[str, Any]) -> list[Row]:
    """A row a controller of a world's result (`places_cases.run_place`).

    iou: mean of the last five steps; so are those of the open loop, the feedforward and the bound beside it. centroid: in % of the symbol's
    size. found: first step at which the symbol was not lost, None for never. lost, lost_later: steps at which it was lost, all, and those
    after the first looks. below_open, below_thesis: by how much the IoU is lower; None where the thesis' controller does not run.
    """
    judged = found["judged"]
    end = {name: float(series(each, "iou", 0.0)[-END:].mean()) for name, each in judged.items()}
    latency = place.scenario.camera.latency_steps
    rows = []
    for controller, each in judged.items():
        offset = np.stack([series(each, axis, DARK) for axis in AXES])[:, -END:].mean(1)
        seen = np.flatnonzero(~np.array(each["lost"]))
        rows.append(
            {
                "kind": place.kind,
                "world": place.key,
                "latency": latency,
                "controller": controller,
                "iou": end[controller],
                "iou_open": end["open"],
                "iou_feedforward": end[FEEDFORWARD],
                "iou_bound": found["iou_bound"],
                "visible": found["visible"],
                "found": int(seen[0]) if len(seen) else None,
                "steps": len(each["lost"]),
                "lost": sum(each["lost"]),
                "lost_later": sum(each["lost"][latency + LOOKS :]),
                "centroid": float(np.abs(offset).max()),
                "below_open": end["open"] - end[controller],
                "below_thesis": end["thesis_pid"] - end[controller] if "thesis_pid" in end else None,
            }
        )
    return rows


def series(judged: Mapping[str, Any], name: str, missing: float) -> NDArray[np.float64]:
    """Values of all steps, `[steps]`."""
    return np.array([missing if value is None else value for value in judged[name]])


@dataclass(frozen=True)
class Goal:
    """What shall hold in at least so large a share of the worlds of which enough is visible. controller: whose rows, of which kind."""

    what: str
    holds: Any
    share: float = 1.0
    controller: str = "luxloop"
    kind: str | None = None
    on_the_road: bool = False  # worlds of either target are counted apart

    def of(self, rows: Sequence[Row]) -> tuple[int, int]:
        """In how many worlds it holds, and of how many."""
        own = [row for row in rows if row["controller"] == self.controller and self._counts(row)]
        return sum(bool(self.holds(row)) for row in own), len(own)

    def _counts(self, row: Row) -> bool:
        if self.kind:
            return row["kind"] == self.kind
        return row["visible"] >= VISIBLE and row["kind"].startswith("place") == self.on_the_road

    def missed(self, rows: Sequence[Row]) -> list[Row]:
        """The rows in which it does not hold."""
        return [row for row in rows if row["controller"] == self.controller and self._counts(row) and not self.holds(row)]


def _found_in_time(row: Row) -> bool:
    return row["found"] is not None and row["found"] <= row["latency"] + LOOKS


GOALS = (
    Goal("IoU at least 0.95 x feedforward's", lambda r: r["iou"] >= 0.95 * r["iou_feedforward"], share=0.95),
    Goal("IoU at least 0.85 x that", lambda r: r["iou"] >= 0.85 * r["iou_feedforward"]),
    Goal("Feedforward within 0.02 of the bound", lambda r: r["iou"] >= r["iou_bound"] - 0.02, controller=FEEDFORWARD),
    Goal("No more than 0.02 below the open loop", lambda r: r["below_open"] <= 0.02),
    Goal("No more than 0.02 below thesis_pid", lambda r: r["below_thesis"] <= 0.02),
    Goal(f"Found within latency + {LOOKS} steps", _found_in_time),
    Goal("Never lost after that", lambda r: r["lost_later"] == 0),
    Goal(
        "Grades of -3 to +4 % from 3 m on: IoU at least 0.95 x the bound",
        lambda r: r["iou"] >= 0.95 * r["iou_bound"],
        kind="grade from 3 m",
    ),
    Goal(
        "On the road itself: IoU at least 0.95 x feedforward's",
        lambda r: r["iou"] >= 0.95 * r["iou_feedforward"],
        share=0.95,
        on_the_road=True,
    ),
    Goal("On the road itself: no more than 0.02 below the open loop", lambda r: r["below_open"] <= 0.02, on_the_road=True),
    Goal(
        "On the road itself, the same from -4 % on: IoU at least 0.85, or 0.95 x the bound",
        lambda r: r["iou"] >= min(0.85, 0.95 * r["iou_bound"]),
        kind="place, grade from 3 m",
    ),
)
# What becomes of the symbol where less of it can be seen; the first that is true counts.
OUTCOMES = {
    "nothing, nor has the bound": lambda r: r["iou_bound"] < NOTHING,
    "as good as for the true road": lambda r: r["iou"] >= 0.95 * max(r["iou_feedforward"], r["iou_bound"]),
    "better than the open loop": lambda r: r["below_open"] < -0.02,
    "as the open loop": lambda r: r["below_open"] <= 0.02,
    "worse than the open loop": lambda r: True,
}


def outcome(row: Row) -> str:
    """Which of OUTCOMES."""
    return next(name for name, holds in OUTCOMES.items() if holds(row))
