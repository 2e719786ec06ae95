"""What object-based lighting saves and keeps: `python benchmarks/object_based.py --population first|second [--scenes N] [--seeds N]`.

Scenes of a population of traffic, through the whole chain: object light alone and beside the glare-free guard, glare-free high beam, and
constant beams. Every other scene of the first has moving traffic; in every other one of the second the car drives at 5 to 20 m/s.
`--detector` takes a kind, a file of weights or of an ONNX network, or a file of TOML with a detector's table. Final scenes begin at
2,000,000 and 4,000,000; develop with `--first`. Goes on where an earlier run in the same folder was. Prints the tables of
docs/results/object_based.md.
"""

import hashlib
import math
import sys
import tomllib
from argparse import Namespace
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from bench import Goal, run, show, study

from luxloop import Simulation, load, validate
from luxloop.loop.simulation.attribution import DAZZLING_LX, NEW_S, WHY, attribute
from luxloop.loop.simulation.detection import pairs
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.lamps import flux_by_side
from luxloop.loop.simulation.world import LitScene
from luxloop.loop.studies.training.evaluate import SURE
from luxloop.perception.camera import expose
from luxloop.perception.detection.build import WEIGHTS
from luxloop.perception.detection.detector import Detections
from luxloop.perception.ground_truth import GroundTruth
from luxloop.perception.noise import FrameNoise
from luxloop.world.caches import keeping
from luxloop.world.scene.vehicle import course
from luxloop.world.traffic.generator import random_tables, second_tables
from luxloop.world.traffic.tracked import ROAD_USERS

FILES = Path(__file__).parents[1] / "perception" / "detection"
CAMERA = {"width_px": 640, "height_px": 360, "pitch_deg": 1.5, "oversampling": 1, "saturation_e": 2000.0}
RATE_HZ, STEPS = 20.0, 50
COMES = 30  # step at which a newcomer is there
END = range(STEPS - 10, STEPS)  # steps that decide what is saved and kept
ATTRIBUTED = 5  # steps from one attribution of causes to the next
FIRST = {"first": 2_000_000, "second": 4_000_000}  # seeds of the final scenes: other ones than in training and development
PARTS = {"first": ("static", "moving"), "second": ("standing", "driving")}  # even and odd scenes

ALONE, BESIDE, GLARE_FREE = "object light", "object light beside the guard", "glare-free high beam"
LOW, FULL = "low beam", "full light"  # the latter with all pixels on
BEAMS = {LOW: "low", FULL: None}
BEGINS = {ALONE: 0, BESIDE: 0, GLARE_FREE: END.start - 10}  # steps; masks need a track, but search for no light

NEWCOMER = "newcomer"
FREE_M = 1.5  # from a newcomer to everybody else
LEAST_HEIGHT_PX, LEAST_VISIBLE = 24, 0.5  # of objects that count; as much of them lies in the image
FOUND = SURE  # mean score in full light from which on an object counts
NEAR = 0.05  # score that may be lost
KEPT = 0.5  # share of END in which a track must show an object, or it is lost
Row = dict[str, Any]


def variants() -> dict[str, dict[str, Any]]:
    """Tables of lighting by variant, object light as in the scenario `obl`."""
    own = load("obl").model_dump(mode="json", include={"lighting", "functions"})
    guard = {"guard": {"kind": "glare_free"}}
    return {ALONE: own, BESIDE: own | {"functions": own["functions"] | guard}, GLARE_FREE: own | {"functions": guard}}


def detector(given: str) -> dict[str, Any]:
    """The table of a kind, of a file of weights or of an ONNX network, or in a file of TOML."""
    if given.endswith(".toml"):
        return tomllib.loads(Path(given).read_text())
    key = {".pt": ("network", "weights"), ".onnx": ("onnx", "file")}.get(Path(given).suffix)
    return {"kind": given} if key is None else {"kind": key[0], key[1]: str(Path(given).resolve())}


def scene(population: str, k: int, first: int, found_by: str) -> dict[str, Any]:
    """A scene at random, and a newcomer who stands in a free place, 10 to 30 m ahead at the end of the run."""
    seed, odd = first + k, k % 2 == 1
    tables = random_tables(seed) if population == "first" else second_tables(seed)
    traffic = tables["traffic"] | {"on_road": True}
    if population == "first":  # as in training: nights are emptier than what is worth looking at
        traffic |= {"moving": odd, **{key: traffic[key] + 1 for key in ("pedestrians", "cyclists")}}
    elif not odd:
        tables.pop("vehicle")
    world = {"camera": CAMERA, "headlight": {"model": "ssl-hd-lores"}, "ssc": {"a_d": 1.0}, "detector": detector(found_by)}
    plain = {"name": f"scene {seed}", "steps": STEPS, "rate_hz": RATE_HZ, "judge_every": 0, **world, **tables, "traffic": traffic}
    scenario, comes_s = validate(plain, f"scene {seed}"), COMES / RATE_HZ
    others = torch.stack([each.pose_track().pose_at(comes_s)[:2, 3] for each in scenario.all_objects]).numpy()
    car = np.zeros(3)  # x and y in m, yaw in rad, at the end
    if scenario.vehicle is not None:
        car = np.array([values[-1] for values in course(scenario.vehicle, np.arange(STEPS + 1) / RATE_HZ)[:3]])
    rng = np.random.default_rng([seed, 3])
    while True:
        x = math.exp(rng.uniform(math.log(10), math.log(30)))
        y = float(rng.uniform(-0.2, 0.2)) * x
        place = car[:2] + np.array([x * np.cos(car[2]) - y * np.sin(car[2]), x * np.sin(car[2]) + y * np.cos(car[2])])
        if np.hypot(*(others - place).T).min() > FREE_M:
            break
    who = {"kind": ("pedestrian", "cyclist")[int(rng.integers(2))], "seed": int(rng.integers(2**31)), "name": NEWCOMER}
    at = {"position_m": [*place.round(2).tolist(), 0.0], "yaw_deg": round(float(rng.uniform(-180, 180)), 1)}
    return plain | {"objects": [who | {"track": [at], "appears_s": comes_s, "on_road": True}]}


def illuminate(scenario: Mapping[str, Any], seeds: int) -> dict[str, Any]:
    """A job: all variants and seeds step by step in one world, so that each view is rendered once; frames have the same noise.

    The result: `flux_lm` of BEAMS; `scores` by beam, of each seed, mean scores in END by object that counts; `runs`, by variant, of each
    seed.
    """
    torch.set_num_threads(1)  # wherever the job runs
    runs = dict[tuple[str, int], Run]()
    beams: Beams | None = None
    for name, tables in variants().items():
        for seed in range(seeds):
            own = validate({**scenario, "seed": seed, **tables}, str(scenario["name"]))
            simulation = Simulation.prepare(own, before=beams and beams.simulation)
            beams = beams or Beams(simulation)
            runs[name, seed] = Run(simulation, beams, BEGINS[name])
    assert beams is not None
    scores, counts = {beam: [defaultdict(list) for _ in range(seeds)] for beam in BEAMS}, Counter[str]()
    for step in range(STEPS):
        for (name, _), each in runs.items():
            if step >= BEGINS[name]:
                each.step()
        if step in END:
            counts.update(each.name for each in beams.view(step).objects if beams.asks_for(each))
            for beam, of_seeds in scores.items():
                for seed, by_name in enumerate(of_seeds):
                    for name, score in beams.scores(beam, step, seed).items():
                        by_name[name].append(score)
    names = [name for name, steps in counts.items() if steps == len(END)]
    return {
        "flux_lm": beams.flux_lm,
        "scores": {beam: [{name: round(float(np.mean(each[name])), 4) for name in names} for each in of] for beam, of in scores.items()},
        "runs": {name: [runs[name, seed].result(names) for seed in range(seeds)] for name in BEGINS},
    }


class Beams:
    """What the detector finds in constant beams."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation, modules = simulation, simulation.modules
        self.lights = {
            name: [torch.ones_like(each.flux) if beam is None else each.lamp.beam(beam)[each.number].to(each.flux) for each in modules]
            for name, beam in BEAMS.items()
        }
        self.flux_lm = {beam: sum(flux_by_side(modules, lights).values()) for beam, lights in self.lights.items()}
        self.luminance = keeping(len(BEAMS), self._luminance)
        self.found = keeping(8, self._found)

    def view(self, step: int) -> LitScene:
        return self.simulation.world.lit(step / RATE_HZ)

    def _luminance(self, beam: str, view: LitScene) -> torch.Tensor:
        return view.light(self.lights[beam])[1] + view.base

    def _found(self, beam: str, step: int, seed: int) -> Detections:
        camera, view = self.simulation.scenario.camera, self.view(step)
        frame = expose(self.luminance(beam, view), camera, FrameNoise.of(seed, step, 0))
        return self.simulation.pipeline.find(frame / (2**camera.bits - 1), view)

    def scores(self, beam: str, step: int, seed: int) -> dict[str, float]:
        """Of each visible object, 0 without a box."""
        view, found = self.view(step), self.found(beam, step, seed)
        boxes = dict(pairs(view.boxes, found.boxes.double().cpu()))
        return {each.name: float(found.scores[boxes[k]].max()) if k in boxes else 0.0 for k, each in enumerate(view.objects)}

    def asks_for(self, each: GroundTruth) -> bool:
        """Whether an object is of the detector's classes, large enough, and visible enough."""
        large = each.whole[3] - each.whole[1] >= LEAST_HEIGHT_PX and min(each.visible, each.inside) >= LEAST_VISIBLE
        return bool(large and each.category in self.simulation.pipeline.classes)


class Run:
    """A run of a variant, step by step."""

    def __init__(self, simulation: Simulation, beams: Beams, begins: int) -> None:
        self.simulation, self.beams, self.state = simulation, beams, simulation.start(begins)
        self.users = {each.name: number for number, each in enumerate(simulation.world.given, 1) if each.category in ROAD_USERS}
        self.last: Evaluation | None = None
        self.flux_lm, self.eyes_lx, self.newcomer_lx = list[float](), list[float | None](), list[float]()
        self.scores, self.tracked = defaultdict[str, list[float]](list), defaultdict[str, list[int]](list)
        self.causes, self.false = Counter[str](), list[bool]()
        self.since = dict[str, int]()  # step from which on an object has been in sight

    def step(self) -> None:
        self.state, shown = self.simulation.step(self.state)
        result = self.last = self.simulation.evaluate(shown, self.last)
        self.flux_lm.append(round(sum(power.flux_lm for power in result.powers.values()), 2))
        for name, each in result.detections.recognised.items():
            if each.track is not None:
                self.tracked[name].append(result.step)
            if result.step in END:
                self.scores[name].append(each.score)
        self.look(result)
        if result.step >= COMES:
            lx = result.objects[NEWCOMER].lx_mean
            self.newcomer_lx.append(0.0 if lx is None or not math.isfinite(lx) else round(lx, 3))

    def look(self, result: Evaluation) -> None:
        """Light on heads and windscreens of road users who came in sight NEW_S ago or more, and causes."""
        (exposure,), known = result.exposures, result.detections
        light = self.simulation.world.on_objects(exposure.start_s, exposure.lights, exposure.commands)
        self.since = {each.name: self.since.get(each.name, result.step) for each in self.beams.view(result.step).objects}
        seen_s = {name: (result.step - since) / RATE_HZ for name, since in self.since.items()}
        lit = {name: light.on_eyes([number]) for name, number in self.users.items() if name in seen_s}
        eyes_lx = {name: float(lx.max()) for name, lx in lit.items() if len(lx)}
        most = max((lx for name, lx in eyes_lx.items() if seen_s[name] >= NEW_S), default=None)
        self.eyes_lx.append(most and round(most, 3))
        if result.step % ATTRIBUTED == 0:
            in_full_light = partial(self.beams.found, FULL, result.step, self.simulation.scenario.seed)
            causes = attribute(self.beams.view(result.step), known.recognised, known.tracks, eyes_lx, seen_s, in_full_light)
            self.causes.update(causes)
            self.false.append(any(number for why, number in causes.items() if why.startswith("false")))

    def result(self, names: Sequence[str]) -> dict[str, Any]:
        """Plain values. scores, tracked: by name, mean, and share of END with a track. found: first step with a track, if any."""
        return {
            **{key: getattr(self, key) for key in ("flux_lm", "eyes_lx", "newcomer_lx", "causes", "false")},
            "scores": {name: round(sum(self.scores[name]) / len(END), 4) for name in names},
            "tracked": {name: float(np.isin(END, self.tracked[name]).mean()) for name in names},
            "found": {name: next(iter(self.tracked[name]), None) for name in names},
        }


def measures(scene: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[Row]:
    """A row for each variant and beam with each seed. scene: columns that say where it is."""
    low_lm, full = result["flux_lm"][LOW], result["scores"][FULL]
    for variant, runs in result["runs"].items():
        for seed, each in enumerate(runs):
            saved = 1 - np.mean(each["flux_lm"][-len(END) :]) / low_lm
            yield {**scene, "variant": variant, "seed": seed, "saved": saved, **kept(each["scores"], full[seed]), **lit(each, full[seed])}
    for beam, runs in result["scores"].items():
        for seed, scores in enumerate(runs):
            yield {**scene, "variant": beam, "seed": seed, "saved": 1 - result["flux_lm"][beam] / low_lm, **kept(scores, full[seed])}


def found_in(full: Mapping[str, float]) -> list[str]:
    """Objects beside the newcomer that are found in full light."""
    return [name for name, score in full.items() if name != NEWCOMER and score >= FOUND]


def kept(scores: Mapping[str, float], full: Mapping[str, float]) -> Row:
    """kept: whether every object that full light shows is within NEAR of it; None where there is none. gap: the largest loss."""
    gap = max((full[name] - scores[name] for name in found_in(full)), default=None)
    return {"kept": None if gap is None else gap <= NEAR, "gap": gap}


def lit(run: Mapping[str, Any], full: Mapping[str, float]) -> Row:
    """Objects lost, and objects below full light by what is missing; frames with heads, and with a bright one; newcomers; causes."""
    names = found_in(full)
    away = [name for name in names if full[name] - run["scores"][name] > NEAR]
    missing = Counter(missed(run, name) for name in away)
    heads = [lx for lx in run["eyes_lx"] if lx is not None]
    return {
        "lost": sum(run["found"][name] is not None and run["tracked"][name] < KEPT for name in names) if names else None,
        "objects": len(names),
        **{why: missing[why] for why in MISSED},
        "heads": len(heads),
        "bright": sum(lx > DAZZLING_LX for lx in heads),
        "eyes_lx": max(heads, default=None),
        "attributed": len(run["false"]),
        "false": sum(run["false"]),
        "newcomer_s": newcomer_s(run) if full.get(NEWCOMER, 0.0) >= FOUND else None,
        **run["causes"],
    }


MISSED = ("tracked, too dark", "found, without a track", "dark, without a track")


def missed(run: Mapping[str, Any], name: str) -> str:
    """Which of MISSED an object is that has less than in full light."""
    if run["tracked"][name] >= KEPT:
        return MISSED[0]
    return MISSED[1] if run["scores"][name] >= FOUND * KEPT else MISSED[2]


def newcomer_s(run: Mapping[str, Any]) -> float:
    """From a newcomer's first frame to the first after a track's in which it gets half of its light at the end; infinite: never."""
    found, lx = run["found"].get(NEWCOMER), run["newcomer_lx"]
    enough = float(np.mean(lx[-len(END) :])) / 2
    lit = (k for k in range(len(lx)) if found is not None and k + COMES > found and lx[k] >= enough > 0)
    return next(lit, math.inf) / RATE_HZ


def light_table(rows: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """A row for each variant and part: what is saved beside what is kept."""
    by = rows.groupby(["part", "variant"], sort=False)
    total = by.sum(numeric_only=True)
    columns = {
        "runs": by.size(),
        "flux saved median": by["saved"].median(),
        "flux saved 10 %": by["saved"].quantile(0.1),
        "every object kept": by["kept"].mean(),
        "greatest loss median": by["gap"].median(),
        "greatest loss 90 %": by["gap"].quantile(0.9),
        "nothing lost": by["lost"].agg(nothing),
        "frames with heads at most 1 lx": 1 - total["bright"] / total["heads"],
        "heads most lx": by["eyes_lx"].max(),
        "frames with a false track": total["false"] / total["attributed"],
        "false tracks a frame": total[[why for why in WHY if why.startswith("false")]].sum(axis=1) / total["attributed"],
        "newcomers lit within 0.5 s": by["newcomer_s"].agg(soon),
    }
    return {", ".join(reversed(key)): row for key, row in pd.DataFrame(columns).to_dict("index").items()}


def nothing(lost: pd.Series) -> float:
    """Share of the runs with nothing lost, of those in which full light shows something."""
    return float((lost.dropna() == 0).mean())


def soon(newcomers_s: pd.Series) -> float:
    """Share of the newcomers that are lit within half a second."""
    return float((newcomers_s.dropna() <= 0.5).mean())


def cause_table(rows: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """By variant, how many objects are missed, heads dazzled, objects untracked and tracks false, and the share of each cause."""
    total = rows[rows["variant"].isin(BEGINS)].groupby("variant", sort=False)[[*MISSED, *WHY]].sum()
    groups = {"missed": MISSED, **{kind: [why for why in WHY if why.startswith(kind)] for kind in ("dazzled", "untracked", "false")}}
    found = defaultdict[str, dict[str, Any]](dict)
    for kind, causes in groups.items():
        count = total[[*causes]].sum(axis=1)
        found[kind] = count.astype(int).to_dict()
        for why in causes:
            found[why] = (total[why] / count).to_dict()
    return found


def goals(given: Namespace, rows: pd.DataFrame) -> list[Goal]:
    """Of both variants of object light, over both parts."""
    by = {name: rows[rows["variant"] == name] for name in (ALONE, BESIDE, GLARE_FREE)}
    share = {name: float(each["kept"].mean()) for name, each in by.items()}
    least = 0.82 if given.population == "first" else max(0.72, share[GLARE_FREE] - 0.12)
    found = [Goal("Every object within 0.05 of full light, beside the guard over alone", share[BESIDE] - share[ALONE], 0, True)]
    for name in (ALONE, BESIDE):
        own = by[name]
        total = own.sum(numeric_only=True)
        found += [
            Goal(f"Every object within 0.05 of full light, share of the runs, {name}", share[name], least, True),
            Goal(f"Nothing lost, share of the runs, {name}", nothing(own["lost"]), 0.97, True),
            Goal(f"Flux saved against the low beam, median, {name}", own["saved"].median(), 0.85, True),
            Goal(f"Frames with heads and windscreens at most 1 lx, {name}", 1 - total["bright"] / total["heads"], 0.985, True),
            Goal(f"Heads and windscreens, lx at most, {name}", own["eyes_lx"].max(), 5.0),
            Goal(f"Frames with a false or second track, {name}", total["false"] / total["attributed"], 0.05),
            Goal(f"Newcomers lit within 0.5 s, {name}", soon(own["newcomer_s"]), 0.96, True),
        ]
    return [each._replace(value=None if np.isnan(each.value) else float(each.value)) for each in found]


def measure(given: Namespace) -> dict[str, Any]:
    if given.population not in PARTS:
        sys.exit(f"--population {given.population}: take one of {', '.join(PARTS)}")
    first = given.first or FIRST[given.population]
    scenes = {
        f"scene {first + k}": {"scenario": scene(given.population, k, first, given.detector), "seeds": given.seeds}
        for k in range(given.scenes)
    }
    files = [FILES / WEIGHTS, *(Path(given.detector),) * Path(given.detector).is_file()]
    digest = hashlib.sha256(b"".join(each.read_bytes() for each in files)).hexdigest()
    found, failures = study(illuminate, scenes, given, [sys.modules[__name__]], digest)
    parts = {key: {"scene": key, "part": PARTS[given.population][k % 2]} for k, key in enumerate(scenes)}
    numbers = ("kept", "gap", "lost", "eyes_lx", "newcomer_s")  # None in many rows
    rows = pd.DataFrame([row for key, result in found.items() for row in measures(parts[key], result)]).astype(
        dict.fromkeys(numbers, float)
    )
    show("Light and scores", light_table(rows))
    show("Causes", cause_table(rows))
    return {"rows": rows.to_dict("records"), "goals": goals(given, rows), "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "population", "detector", "scenes", "seeds", "first", "out", "jobs")
