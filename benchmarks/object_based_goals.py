"""What the runs come to: a row of measures for each, and the goals that object-based lighting is held to."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from object_based_cases import BEAMS, COMES, END, FULL, HIGH, LATE, LOW, NEWCOMER, OURS, WORLD
from object_based_parts import DENSE, FULL_WELLS, TARGET, WITHIN

from luxloop.loop.studies.training.judge import SURE

FOUND = SURE  # confidence in full light from which on an object counts: what the detector is judged by
NEAR = 0.05  # confidence that may be lost
KEPT = 0.5  # share of the judged steps in which a track must show an object, or it is lost
SETTLED = 0.02  # of the low beam's flux, to which flux comes to stay
RATE_HZ = WORLD["rate_hz"]
SECOND = round(RATE_HZ)
Row = dict[str, Any]


def measures(scene: Row, result: Mapping[str, Any]) -> list[Row]:
    """A row for each variant and beam with each seed. scene: what else the rows say, such as whether it moves."""
    rows = []
    lamps, beams = result["lamps"], result["beams"]
    for variant, runs in result["runs"].items():
        rows += [scene | _measured(run, beams[FULL][seed], lamps, variant, seed) for seed, run in enumerate(runs)]
    for variant in BEAMS:
        for seed, scores in enumerate(beams[variant]):
            saved = _saved(lamps[variant]["flux_lm"], lamps[variant]["watts"], lamps)
            rows.append(scene | {"variant": variant, "seed": seed} | saved | _kept(scores, beams[FULL][seed]))
    return rows


def _measured(run: Mapping[str, Any], full: Mapping[str, float], lamps: Mapping[str, Any], variant: str, seed: int) -> Row:
    end = slice(END.start, END.stop)
    flux, eyes = np.array(run["flux_lm"]), [lx for lx in run["eyes_lx"][SECOND:] if lx is not None]
    seen = [name for name in full if name != NEWCOMER and full[name] >= FOUND]
    return {
        "variant": variant,
        "seed": seed,
        **_saved(float(flux[end].mean()), float(np.mean(run["watts"][end])), lamps),
        **_kept(run["scores"], full),
        "saved_so_far": float(1 - flux[: END.stop].mean() / lamps[LOW]["flux_lm"]),
        "lost": sum(run["found"][name] is not None and run["tracked"][name] < KEPT for name in seen),
        "never_found": sum(run["found"][name] is None for name in seen),
        "settle_s": settle_step(flux[:COMES], SETTLED * lamps[LOW]["flux_lm"]) / RATE_HZ,
        "searches_s": searches_s(run),
        "eyes_lx": max(eyes, default=None),
        **_dazzled(run),
        **({"newcomer": full.get(NEWCOMER, 0.0) >= FOUND, "newcomer_s": newcomer_s(run)} if run["newcomer_lx"] else {}),
    }


def _dazzled(run: Mapping[str, Any]) -> Row:
    """Share of the frames after the first second with more than 1 lx on heads or windscreens, and with that on those that a track shows."""
    frames = len(run["flux_lm"]) - SECOND
    late = [(step, is_tracked) for step, _, _, is_tracked in run["dazzled"] if step >= SECOND]
    return {
        "dazzled": len({step for step, _ in late}) / frames,
        "dazzled_tracked": len({step for step, is_tracked in late if is_tracked}) / frames,
    }


def _saved(flux_lm: float, watts: float, lamps: Mapping[str, Mapping[str, float]]) -> Row:
    shares = {f"saved_{key}": 1 - flux_lm / lamps[beam]["flux_lm"] for key, beam in (("low", LOW), ("high", HIGH), ("full", FULL))}
    return {"flux_lm": flux_lm, **shares, "watts_saved": lamps[LOW]["watts"] - watts}


def _kept(scores: Mapping[str, float], full: Mapping[str, float]) -> Row:
    """kept: whether every object that full light shows is within NEAR of it; None where there is none."""
    gaps = [full[name] - scores[name] for name in full if name != NEWCOMER and full[name] >= FOUND]
    kept = sum(gap <= NEAR for gap in gaps)
    return {"objects": len(gaps), "objects_kept": kept, "kept": kept == len(gaps) if gaps else None, "gap": max(gaps, default=None)}


def settle_step(flux: NDArray[np.float64], within: float) -> int:
    """First step from which on the flux is that close to its mean over END."""
    away = np.flatnonzero(np.abs(flux - flux[END.start : END.stop].mean()) > within)
    return int(away[-1]) + 1 if len(away) else 0


def searches_s(run: Mapping[str, Any]) -> list[float | None]:
    """How long the loops of tracks of the first half second searched until they first settled; None: never."""
    early = [(first, settled) for first, settled in run["searches"] if first < SECOND / 2]
    return [None if settled is None else (settled - first) / RATE_HZ for first, settled in early]


def newcomer_s(run: Mapping[str, Any]) -> float | None:
    """From a newcomer's first frame to the first after a track's in which it gets half of its light at the end, or more; None: never."""
    found = run["found"].get(NEWCOMER)
    lx = [0.0 if value is None else value for value in run["newcomer_lx"]]
    enough = float(np.mean(lx[-len(LATE) :])) / 2
    lit = [k for k in range(len(lx)) if found is not None and k + COMES > found and lx[k] >= enough > 0]
    return lit[0] / RATE_HZ if lit else None


def zone_rows(results: Iterable[Mapping[str, Any]]) -> list[Row]:
    """steps: after which a zone stays within WITHIN of its target; as many as there were where it does not."""
    rows = []
    for saturation_e, zone in ((result["saturation_e"], zone) for result in results for zone in result["zones"]):
        away = np.flatnonzero(np.abs(np.array(zone["luminance"]) / TARGET - 1) > WITHIN)
        error = abs(zone["luminance"][-1] / TARGET - 1)
        steps = int(away[-1]) + 1 if len(away) else 0
        rows.append({"reflectance": zone["reflectance"], "saturation_e": saturation_e, "steps": steps, "error": error})
    return rows


def track_rows(results: Iterable[Mapping[str, Any]]) -> list[Row]:
    """A row for each object with each seed."""
    return [{"situation": each["situation"], **row} for each in results for of_seed in each["objects"] for row in of_seed]


@dataclass(frozen=True)
class Measured:
    """All rows."""

    light: Sequence[Row]
    zones: Sequence[Row]
    tracks: Sequence[Row]

    def ours(self, moving: bool | None = None) -> list[Row]:
        return [row for row in self.light if row["variant"] == OURS and moving in (None, row["moving"])]


@dataclass(frozen=True)
class Goal:
    """value: None where there is nothing to measure. limited: what keeps luxloop from it where it is missed. form: of value and limit."""

    what: str
    value: Callable[[Measured], float | None]
    limit: float
    limited: str = ""
    least: bool = False
    form: str = "{:.2f}"

    def reached(self, value: float) -> bool:
        return value >= self.limit if self.least else value <= self.limit


def quantile(rows: Sequence[Row], key: str, share: float) -> float | None:
    values = [row[key] for row in rows if row.get(key) is not None]
    return float(np.quantile(values, share)) if values else None


def share(found: Iterable[bool | None]) -> float | None:
    values = [each for each in found if each is not None]
    return float(np.mean(values)) if values else None


def median_saved(rows: Sequence[Row]) -> float | None:
    return quantile(rows, "saved_low", 0.5)


def share_kept(rows: Sequence[Row]) -> float | None:
    return share(row["kept"] for row in rows)


def _searched(rows: Sequence[Row]) -> float | None:
    """90 % quantile over all tracks of all runs; infinite where they never settle, which is no number to interpolate between."""
    found = [float("inf") if time_s is None else time_s for row in rows for time_s in row["searches_s"]]
    return float(np.quantile(found, 0.9, method="higher")) if found else None


def newcomers(rows: Sequence[Row]) -> list[float]:
    """Times in s of those that full light shows; infinite: never lit."""
    return [float("inf") if row["newcomer_s"] is None else row["newcomer_s"] for row in rows if row.get("newcomer")]


def _newcomers(rows: Sequence[Row]) -> float | None:
    return share(time_s <= 0.5 for time_s in newcomers(rows))


def _lossless(rows: Sequence[Row]) -> float | None:
    return share(row["lost"] == 0 if row["objects"] else None for row in rows)


def _steps(rows: Sequence[Row], saturation_e: float) -> float | None:
    return quantile([row for row in rows if row["saturation_e"] == saturation_e], "steps", 1.0)


def _switches(rows: Sequence[Row]) -> float | None:
    found = [row["switches"] for row in rows if row["situation"] != DENSE]
    return float(max(found)) if found else None


PERCENT = "{:.1%}"
MASKS = (
    "half of the others have less than 0.9 in full light, too, and a third have no track; people at 40 m have dark bodies below a dark head"
)
LOST = "in 13 of 32 the object has less than 0.9 in full light, too, and in 10 it is found, but has no separate track"
MOVING = "light for moving objects changes all the time"
SEARCH = "10 % of the tracks never settle; of the others 90 % settle within 1.4 s"
UNSEEN = "objects with too little light from the base beam are found late or never"
SIZES = "an object placed 1.4 times too far or more gets at least 1.1 lx, one without a track the light on its neighbours"
GOALS = (
    Goal("Flux saved against the low beam, median, at least 85 %", lambda m: median_saved(m.ours()), 0.85, MOVING, True, PERCENT),
    Goal("Every object within 0.05 of full light, at least 80 % of the runs", lambda m: share_kept(m.ours()), 0.80, MASKS, True, PERCENT),
    Goal("No object lost that full light keeps, at least 98 % of the runs", lambda m: _lossless(m.ours()), 0.98, LOST, True, PERCENT),
    Goal("Settled within 2 s, static, 90 % quantile", lambda m: quantile(m.ours(False), "settle_s", 0.9), 2.0, MOVING, form="{:.2f} s"),
    Goal("The same: moving", lambda m: quantile(m.ours(True), "settle_s", 0.9), 2.0, MOVING, form="{:.2f} s"),
    Goal("A track's search for its light has ended within 2 s, 90 % quantile", lambda m: _searched(m.ours()), 2.0, SEARCH, form="{:.2f} s"),
    Goal("A newcomer lit within 0.5 s, at least 90 %", lambda m: _newcomers(m.ours()), 0.90, UNSEEN, True, PERCENT),
    Goal(
        "Heads and windscreens at most 1 lx after the first second",
        lambda m: quantile(m.ours(), "eyes_lx", 1.0),
        1.0,
        SIZES,
        form="{:.2f} lx",
    ),
    Goal("Zones within 5 % in at most 10 steps", lambda m: _steps(m.zones, FULL_WELLS[0]), 10, form="{:.0f} steps"),
    Goal("The same: with the detector's camera", lambda m: _steps(m.zones, FULL_WELLS[1]), 10, form="{:.0f} steps"),
    Goal("No identity switch: crossing, overtaking, 10 frames hidden", lambda m: _switches(m.tracks), 0, "", form="{:.0f}"),
)
