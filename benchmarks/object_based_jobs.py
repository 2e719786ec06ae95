"""The jobs of benchmarks/object_based.py: all variants of lighting in one scene, zones, the tracker in good light."""

import math
from argparse import Namespace
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import count, product
from typing import Any

import numpy as np
import torch
from tracking import Identities

from luxloop import Scenario, Simulation, load, validate
from luxloop.controllers.functions.object_based import ObjectBasedState
from luxloop.loop.simulation.detection import pairs
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.lamps import flux_by_side
from luxloop.perception.camera import expose
from luxloop.perception.ground_truth import GroundTruth
from luxloop.perception.noise import FrameNoise
from luxloop.world.traffic.generator import random_tables

CAMERA = {"width_px": 640, "height_px": 360, "pitch_deg": 1.5, "oversampling": 1, "saturation_e": 2000.0}
RATE_HZ = 30.0
WORLD = {
    **{"camera": CAMERA, "headlight": {"model": "ssl-hd-lores"}, "ssc": {"a_d": 1.0}},
    **{"detector": {"kind": "network"}, "rate_hz": RATE_HZ},
}
FIRST = 2_000_000  # seed of the first scene: the network was trained on scenes from 10,000 on, and evaluated on those from 1,000,000 on
OURS = "luxloop"
LOW, FULL = "low beam", "full light"  # the latter with all pixels on
BEAMS = {LOW: "low", "high beam": "high", FULL: None}
HIGH_BEAM = {"lighting": {"base": {"beam": "high"}}}

END = range(60, 75)  # steps of which means are what object-based lighting has come to
COMES = 75  # step at which a newcomer is there
STEPS = 105
LATE = range(STEPS - 10, STEPS)  # the same of the newcomer
NEWCOMER = "newcomer"
LEAST_HEIGHT_PX, LEAST_VISIBLE = 24, 0.5  # of objects that count; as much of them lies in the image
DAZZLING_LX = 1.0  # on heads and windscreens
FREE_M = 1.5  # from a newcomer to everybody else

WALLS_M = ((17.0, 3.0), (25.0, 0.0), (17.0, -3.0))  # x and y
LUMINANCE, ZONE_STEPS = 0.9, 20  # wanted in zones, cd/m^2
Jobs = dict[str, dict[str, Any]]  # parameters by key


def lit(plain: Mapping[str, Any], tables: Mapping[str, Any] = HIGH_BEAM, seed: int = 0) -> Scenario:
    """A scenario with its tables of lighting, and a seed of noise."""
    return validate({**plain, "seed": seed, **tables}, str(plain["name"]))


def scene(seed: int, moving: bool) -> dict[str, Any]:
    """A scene at random, and a newcomer in a free place."""
    tables = random_tables(seed)
    traffic = tables["traffic"] | {"moving": moving}
    for key in ("pedestrians", "cyclists"):  # as in training: nights are emptier than what is worth looking at
        traffic[key] += 1
    plain = {"name": f"scene {seed}", "steps": STEPS, **WORLD, **tables, "traffic": traffic}
    comes_s = COMES / RATE_HZ
    others = torch.stack([each.pose_track().pose_at(comes_s)[:2, 3] for each in lit(plain).all_objects]).numpy()
    rng = np.random.default_rng([seed, 3])
    while True:
        x = math.exp(rng.uniform(math.log(10), math.log(30)))
        y = float(rng.uniform(-0.2, 0.2)) * x
        if np.hypot(*(others - (x, y)).T).min() > FREE_M:
            break
    newcomer = {"kind": ("pedestrian", "cyclist")[int(rng.integers(2))], "seed": int(rng.integers(2**31)), "name": NEWCOMER}
    at = {"position_m": [round(x, 2), round(y, 2), 0.0], "yaw_deg": round(float(rng.uniform(-180, 180)), 1)}
    return plain | {"objects": [newcomer | {"track": [at], "appears_s": comes_s}]}


def scene_jobs(given: Namespace) -> Jobs:
    """Every other scene moves."""
    variants = {name: load("obl", each).model_dump(mode="json", include={"lighting", "functions"}) for name, each in given.variants.items()}
    counts = {name: given.seeds if name == OURS else 1 for name in variants}
    return {
        f"scene {k}, {'moving' if k % 2 else 'static'}": {"scenario": scene(FIRST + k, k % 2 == 1), "variants": variants, "seeds": counts}
        for k in range(given.scenes)
    }


def illuminate(scenario: Mapping[str, Any], variants: Mapping[str, Mapping[str, Any]], seeds: Mapping[str, int]) -> dict[str, Any]:
    """A job: all variants and seeds step by step in one world, so that each view is rendered once; frames have the same noise.

    Variants beside the default end where the newcomer comes.
    The result: `objects` that count; `flux_lm` of BEAMS; `scores` by beam, of each seed, what the detector says of objects in their light;
    `runs`, by variant, of each seed.
    """
    own = {(name, seed): lit(scenario, tables, seed) for name, tables in variants.items() for seed in range(seeds[name])}
    simulations = dict(zip(own, in_one_world(own.values()), strict=True))
    shared, steps = next(iter(simulations.values())), {key: each.evaluations() for key, each in simulations.items()}
    runs, counts, luminance = {key: Run() for key in own}, Counter(), {}
    beams = {
        name: tuple(
            torch.ones_like(module.flux) if beam is None else module.lamp.beam(beam)[module.number].to(module.flux)
            for module in shared.modules
        )
        for name, beam in BEAMS.items()
    }
    scores = {beam: [defaultdict(list) for _ in range(max(seeds.values()))] for beam in beams}
    before, pipeline = None, shared.pipeline
    for step in range(STEPS):
        for key in (key for key in own if step < COMES or key[0] == OURS):
            runs[key].add(next(steps[key]), shared)
        if step not in END and step not in LATE:
            continue
        view = shared.world.lit(step / RATE_HZ)
        if view is not before:
            before, luminance = view, {beam: view.light(lights)[1] + view.base for beam, lights in beams.items()}
        due = {each.name for each in view.objects if (step in LATE) == (each.name == NEWCOMER)}
        counts.update(due & {each.name for each in view.objects if is_clear(each) and each.category in pipeline.detector.classes})
        for beam, of_seeds in scores.items():
            for seed, by_name in enumerate(of_seeds):
                frame = expose(luminance[beam], shared.scenario.camera, FrameNoise.of(seed, step, 0))
                found = pipeline.find(frame / (2**shared.scenario.camera.bits - 1), view)
                boxes = dict(pairs(view.boxes, found.boxes.double().cpu()))
                for k, each in enumerate(view.objects):
                    if each.name in due:
                        by_name[each.name].append(float(found.scores[boxes[k]].max()) if k in boxes else 0.0)
    names = [name for name, seen in counts.items() if seen == len(evaluated_steps(name))]
    return {
        "objects": names,
        "flux_lm": {beam: sum(flux_by_side(shared.modules, lights).values()) for beam, lights in beams.items()},
        "scores": {beam: [means(each, names) for each in of_seeds] for beam, of_seeds in scores.items()},
        "runs": {name: [runs[name, seed].result(names) for seed in range(seeds[name])] for name in variants},
    }


def in_one_world(scenarios: Iterable[Scenario]) -> list[Simulation]:
    """A simulation of each, in the world of the first, which is rendered once."""
    torch.set_num_threads(1)  # wherever the job runs
    found = []
    for each in scenarios:
        found.append(Simulation.prepare(each, before=found[0] if found else None))
    return found


def evaluated_steps(name: str) -> range:
    return LATE if name == NEWCOMER else END


def is_clear(each: GroundTruth) -> bool:
    """Whether an object is large enough, and visible enough, to be asked for."""
    return bool(each.whole[3] - each.whole[1] >= LEAST_HEIGHT_PX and min(each.visible, each.inside) >= LEAST_VISIBLE)


def means(scores: Mapping[str, Sequence[float]], names: Sequence[str]) -> dict[str, float]:
    return {name: round(float(np.mean(scores[name])), 4) for name in names if name in scores}


class Run:
    """What a run gives, step by step. tracked: steps in which a track shows an object. dazzled: step, whether a track shows who is
    dazzled. searches: first step of a track's loop, and the first in which it had settled."""

    def __init__(self) -> None:
        self.series = {name: [] for name in ("flux_lm", "eyes_lx", "newcomer_lx", "dazzled")}
        self.scores = defaultdict(list)
        self.tracked = defaultdict(list)
        self.searches = {}

    def add(self, result: Evaluation, shared: Simulation) -> None:
        own, step, eyes_lx = self.series, result.step, result.detections.eyes_lx_max
        own["flux_lm"].append(round(sum(power.flux_lm for power in result.powers.values()), 2))
        own["eyes_lx"].append(finite(eyes_lx))
        for name, each in result.detections.recognised.items():
            if each.track is not None:
                self.tracked[name].append(step)
            if step in evaluated_steps(name):
                self.scores[name].append(each.score)
        for state in (each for each in result.planning.functions.values() if isinstance(each, ObjectBasedState)):
            for track, loop in state.loops.items():
                search = self.searches.setdefault(track, [step, None])
                if loop.settled and search[1] is None:
                    search[1] = step
        if (eyes_lx or 0.0) > DAZZLING_LX:
            view = shared.world.lit(result.time_s)
            for seen in view.objects:
                lx = result.illuminance[view.eyes & (view.surfaces.object_id == seen.object_id)]
                if len(lx) and float(lx.max()) > DAZZLING_LX:
                    own["dazzled"].append((step, result.detections.recognised[seen.name].track is not None))
        if step >= COMES:
            own["newcomer_lx"].append(finite(result.objects[NEWCOMER].lx_mean))

    def result(self, names: Sequence[str]) -> dict[str, Any]:
        """Plain values. scores, tracked: by name, mean, and share of the evaluated steps. found: first step with a track, if any."""
        return self.series | {
            "scores": means(self.scores, names),
            "tracked": {name: float(np.isin(evaluated_steps(name), self.tracked[name]).mean()) for name in names},
            "found": {name: next(iter(self.tracked[name]), None) for name in names},
            "searches": list(self.searches.values()),
        }


def finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 3)


def zone_jobs(given: Namespace) -> Jobs:
    """Each reflectance once in each place, with each camera."""
    n = len(given.reflectances)
    rows = [[given.reflectances[(first + k) % n] for k in range(len(WALLS_M))] for first in range(n)]
    return {
        f"zones, {' '.join(map(str, each))}, {well:g} e, seed {seed}": {"reflectances": each, "saturation_e": well, "seed": seed}
        for seed, well, each in product(range(given.seeds), given.full_wells_e, rows)
    }


def zones(reflectances: Sequence[float], saturation_e: float, seed: int) -> dict[str, Any]:
    """A job: how bright three walls are, each with a zone, in cd/m^2, `luminance [walls, steps]`."""
    walls, functions = [], {}
    for k, ((x, y), albedo) in enumerate(zip(WALLS_M, reflectances, strict=True)):
        walls.append(_box(f"wall_{k}", (0.2, 2.0, 2.0), albedo, (x + 0.1, y, 0.0)))
        functions[f"zone_{k}"] = {"kind": "zone", "centre_m": (x, y, 1.0), "size_m": (0.0, 1.6, 1.6), "luminance_cd_m2": LUMINANCE}
    world = {key: value for key, value in WORLD.items() if key != "detector"} | {"camera": CAMERA | {"saturation_e": saturation_e}}
    plain = {"name": "zones", "steps": ZONE_STEPS, **world, "light": {"ambient_lx": 0.1}, "objects": walls}
    (simulation,) = in_one_world([lit(plain, {"lighting": {"base": {"beam": "low"}}, "functions": functions}, seed)])
    results = list(simulation.evaluations())
    return {"saturation_e": saturation_e, "luminance": [[each.zones[name].luminance for each in results] for name in functions]}


def _box(name: str, size_m: tuple[float, ...], albedo: float, position_m: tuple[float, ...]) -> dict[str, Any]:
    return {"kind": "box", "name": name, "size_m": size_m, "albedo": albedo, "track": [{"position_m": position_m}]}


def situations(given: Namespace, k: int) -> dict[str, list[dict[str, Any]]]:
    """Objects of the k-th place by situation."""
    found, seeds = {}, count(FIRST + 10 * k)
    for name, (farther_m, *walkers) in given.situations.items():
        found[name] = []
        for kind, (x, y), (end_x, end_y), speed_m_s in walkers:
            seed, away_m = next(seeds), farther_m * k
            path = {"points_m": [(x + away_m, y, 0.0), (end_x + away_m, end_y, 0.0)], "speed_m_s": speed_m_s}
            found[name].append({"kind": kind, "name": f"{kind}_{seed}", "seed": seed, "path": path})
        if "pillar" in name:
            found[name].append(_box("pillar", (0.3, 0.85, 2.4), 0.2, (x + away_m - 1.5, 0.0, 0.0)))
    return found


DENSE = "dense traffic"


def track_jobs(given: Namespace) -> Jobs:
    """Each situation so often, each time in another place with others."""
    found = {}
    for k in range(given.times):
        plain = {name: {"name": name, **WORLD, "objects": objects} for name, objects in situations(given, k).items()}
        traffic = {"seed": k, "pedestrians": 8, "cyclists": 3, "cars": 2, "parked": 2, "moving": True}
        plain[DENSE] = {**scene(FIRST + 900_000 + k, moving=True), "objects": [], "traffic": traffic}
        for name, each in plain.items():
            found[f"{name} {k}"] = {"situation": name, "scenario": each | {"steps": given.frames}, "seeds": given.seeds}
    return found


def track(situation: str, scenario: Mapping[str, Any], seeds: int) -> dict[str, Any]:
    """A job: identities in the light of the high beam, with each seed's noise: `tracking.Identities` of each."""
    simulations = in_one_world(lit(scenario, seed=seed) for seed in range(seeds))
    found = [Identities() for _ in simulations]
    for results in zip(*(each.evaluations() for each in simulations), strict=True):
        view = simulations[0].world.lit(results[0].time_s)
        visible = [each.visible * each.inside >= LEAST_VISIBLE for each in view.objects]
        for own, result in zip(found, results, strict=True):
            tracks = result.detections.tracks
            own.look([each.name for each in view.objects], view.boxes, visible, tracks.boxes, tracks.number.tolist())
    return {"situation": situation, "runs": [each.counts() for each in found]}
