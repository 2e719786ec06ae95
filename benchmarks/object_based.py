"""What object-based lighting saves and keeps: `python benchmarks/object_based.py [--quick] [--scenes N] [--seeds N]`.

Static and moving scenes that the detector was not trained on, through the whole chain, with all methods side by side; zones; the
tracker. Goes on where an earlier run in the same folder was. Prints the tables of
docs/results/object_based.md.
"""

import hashlib
from argparse import Namespace
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import object_based_jobs as jobs
import pandas as pd
import tracking
from bench import Goal, run, show, study
from numpy.typing import NDArray
from object_based_jobs import COMES, DENSE, END, FULL, LATE, LOW, LUMINANCE, NEWCOMER, OURS, RATE_HZ

from luxloop.loop.studies.training.evaluate import SURE
from luxloop.perception.detection.build import WEIGHTS

NETWORK = Path(__file__).parents[1] / "perception" / "detection" / WEIGHTS
FOUND = SURE  # confidence in full light from which on an object counts: what the detector is evaluated by
NEAR = 0.05  # confidence that may be lost
KEPT = 0.5  # share of the evaluated steps in which a track must show an object, or it is lost
SETTLED = 0.02  # of the low beam's flux, to which flux comes to stay
WITHIN = 0.05  # of a zone's luminance
SECOND = round(RATE_HZ)
Row = dict[str, Any]


def measures(key: str, result: Mapping[str, Any]) -> Iterator[Row]:
    """A row for each variant and beam with each seed. key: of the scene, which says whether it moves."""
    low_lm, full = result["flux_lm"][LOW], result["scores"][FULL]
    of_variants = ((name, seed, each) for name, runs in result["runs"].items() for seed, each in enumerate(runs))
    of_beams = ((name, seed, {"scores": each}) for name, seeds in result["scores"].items() for seed, each in enumerate(seeds))
    for name, seed, each in (*of_variants, *of_beams):
        row = {"scene": key, "moving": key.endswith("moving"), "variant": name, "seed": seed, **kept(each["scores"], full[seed])}
        yield row | (lit(each, full[seed], low_lm) if "flux_lm" in each else {"saved": 1 - result["flux_lm"][name] / low_lm})


def lit(run: Mapping[str, Any], full: Mapping[str, float], low_lm: float) -> Row:
    """Metrics of a run: energy saved, settling time, objects lost, dazzled or lit late. full: confidence in full light."""
    flux, late = np.array(run["flux_lm"]), [(step, is_tracked) for step, is_tracked in run["dazzled"] if step >= SECOND]
    frames = len(flux) - SECOND
    return {
        "saved": float(1 - flux[END.start : END.stop].mean() / low_lm),
        "lost": sum(run["found"][name] is not None and run["tracked"][name] < KEPT for name in found_in(full)),
        "settle_s": settle_step(flux[:COMES], SETTLED * low_lm) / RATE_HZ,
        "searches_s": searches_s(run),
        "eyes_lx": max((lx for lx in run["eyes_lx"][SECOND:] if lx is not None), default=None),
        "dazzled": len({step for step, _ in late}) / frames,
        "dazzled_tracked": len({step for step, is_tracked in late if is_tracked}) / frames,
        **({"newcomer_s": newcomer_s(run)} if run["newcomer_lx"] and full.get(NEWCOMER, 0.0) >= FOUND else {}),
    }


def found_in(full: Mapping[str, float]) -> list[str]:
    """Objects beside the newcomer that are found in full light."""
    return [name for name, score in full.items() if name != NEWCOMER and score >= FOUND]


def kept(scores: Mapping[str, float], full: Mapping[str, float]) -> Row:
    """kept: whether every object that full light shows is within NEAR of it; None where there is none."""
    gap = max((full[name] - scores[name] for name in found_in(full)), default=None)
    return {"kept": None if gap is None else gap <= NEAR, "gap": gap}


def settle_step(flux: NDArray[np.float64], within: float) -> int:
    """First step from which on the flux is that close to its mean over END."""
    away = np.flatnonzero(np.abs(flux - flux[END.start : END.stop].mean()) > within)
    return int(away[-1]) + 1 if len(away) else 0


def searches_s(run: Mapping[str, Any]) -> list[float]:
    """How long the loops of tracks of the first half second searched until they first settled; infinite: never."""
    early = [(first, settled) for first, settled in run["searches"] if first < SECOND / 2]
    return [float("inf") if settled is None else (settled - first) / RATE_HZ for first, settled in early]


def newcomer_s(run: Mapping[str, Any]) -> float:
    """From a newcomer's first frame to the first after a track's in which it gets half of its light at the end; infinite: never."""
    found = run["found"].get(NEWCOMER)
    lx = [0.0 if value is None else value for value in run["newcomer_lx"]]
    enough = float(np.mean(lx[-len(LATE) :])) / 2
    lit = (k for k in range(len(lx)) if found is not None and k + COMES > found and lx[k] >= enough > 0)
    return next(lit, float("inf")) / RATE_HZ


def zone_row(result: Mapping[str, Any]) -> Row:
    """steps: after which each zone stays within WITHIN of its luminance; as many as there were where it does not."""
    errors = np.abs(np.array(result["luminance"]) / LUMINANCE - 1)
    away = [np.flatnonzero(each > WITHIN) for each in errors]
    return {
        "saturation_e": result["saturation_e"],
        "steps": [int(each[-1]) + 1 if len(each) else 0 for each in away],
        "error": errors[:, -1].max(),
    }


def lit_soon(newcomers_s: pd.Series) -> float:
    """Share of the newcomers that are lit within half a second."""
    return (newcomers_s.dropna() <= 0.5).mean()


def goals(light: pd.DataFrame, zones: Mapping[str, Row], situations: Mapping[str, Row]) -> list[Goal]:
    own = light[light["variant"] == OURS]
    static, moving = (own.loc[own["moving"] == moves, "settle_s"].quantile(0.9) for moves in (False, True))
    searches = own["searches_s"].explode().dropna().astype(float).quantile(0.9, interpolation="higher")
    found = [
        Goal("Flux saved against the low beam, median", own["saved"].median(), 0.85, True),
        Goal("Every object within 0.05 of full light, share of the runs", own["kept"].mean(), 0.80, True),
        Goal("No object lost that full light keeps, share of the runs", (own.dropna(subset="kept")["lost"] == 0).mean(), 0.98, True),
        Goal("Settled, static, 90 % quantile, s", static, 2.0),
        Goal("The same: moving", moving, 2.0),
        Goal("End of a track's search, 90 % quantile, s", searches, 2.0),
        Goal("A newcomer lit within 0.5 s, share", lit_soon(own["newcomer_s"]), 0.90, True),
        Goal("Heads and windscreens after the first second, lx", own["eyes_lx"].max(), 1.0),
        *(Goal(f"Steps of zones to come within 5 %, full well of {well}", each["worst steps"], 10) for well, each in zones.items()),
        Goal("Identity switches", sum(row["switches"] for name, row in situations.items() if name != DENSE), 0),
    ]
    return [each._replace(value=None if np.isnan(each.value) else float(each.value)) for each in found]


def light_frame(rows: Sequence[Row]) -> pd.DataFrame:
    """A frame of rows, with numbers also where few scenes have no newcomer or no object that full light shows."""
    sparse = ("kept", "gap", "eyes_lx", "newcomer_s")
    return pd.DataFrame([dict.fromkeys(sparse) | row for row in rows]).astype(dict.fromkeys(sparse, float))


def light_table(light: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """A row for each variant: what is saved beside what is kept."""
    own = light[light["variant"] == OURS]
    parts = own.assign(variant=OURS + np.where(own["moving"], ", moving", ", static"))
    by = pd.concat([light, parts]).groupby("variant", sort=False)
    columns = {
        "runs": by.size(),
        "flux saved median": by["saved"].median(),
        "flux saved 10 %": by["saved"].quantile(0.1),
        "every object kept": by["kept"].mean(),
        "greatest loss median": by["gap"].median(),
        "greatest loss 90 %": by["gap"].quantile(0.9),
        "runs with one lost": by["lost"].agg(lambda each: (each.dropna() > 0).mean()),
        "heads above 1 lx, frames dazzled": by["dazzled"].mean(),
        "heads above 1 lx, frames dazzled_tracked": by["dazzled_tracked"].mean(),
        "newcomer lit within 0.5 s": by["newcomer_s"].agg(lit_soon),
    }
    return pd.DataFrame(columns).to_dict("index")


def measure(given: Namespace) -> dict[str, Any]:
    todo = {jobs.zones: jobs.zone_jobs(given), jobs.track: jobs.track_jobs(given), jobs.illuminate: jobs.scene_jobs(given)}
    weights = hashlib.sha256(NETWORK.read_bytes()).hexdigest()
    (of_zones, of_tracks, of_scenes), failed = zip(*(study(*each, given, [jobs, tracking], weights) for each in todo.items()), strict=True)
    light = [row for key, result in of_scenes.items() for row in measures(key, result)]
    frame = light_frame(light)
    by_well = pd.DataFrame([zone_row(each) for each in of_zones.values()]).explode("steps").astype(float).groupby("saturation_e")
    zones = {
        f"{well:g} e": {"mean steps": each["steps"].mean(), "worst steps": each["steps"].max(), "worst error": each["error"].max()}
        for well, each in sorted(by_well, reverse=True)
    }
    runs = defaultdict(list)
    for each in of_tracks.values():
        runs[each["situation"]] += each["runs"]
    situations = {name: tracking.summary(each) for name, each in runs.items()}
    show("Light and confidence", light_table(frame))
    show("Zones", zones)
    show("Tracker", situations)
    failures = {key: reason for each in failed for key, reason in each.items()}
    return {"light": light, "zones": zones, "tracks": situations, "goals": goals(frame, zones, situations), "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "scenes", "seeds", "out", "jobs")
