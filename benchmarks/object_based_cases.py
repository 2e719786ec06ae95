"""The scenes in which benchmarks/object_based.py shows object-based lighting, and the job that runs all its variants in one of them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.object_based import ObjectBasedState
from luxloop.loop.scenario.model import Scenario, load, validate
from luxloop.loop.scenario.overrides import Override
from luxloop.loop.simulation.detection import DetectionPipeline, pairs
from luxloop.loop.simulation.lamps import flux_by_side
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import LitScene
from luxloop.perception.camera import CameraParams, expose
from luxloop.perception.ground_truth import GroundTruth
from luxloop.perception.noise import FrameNoise
from luxloop.world.traffic.generator import random_tables

CAMERA = {"width_px": 640, "height_px": 360, "pitch_deg": 1.5, "oversampling": 1, "saturation_e": 2000.0}
WORLD: dict[str, Any] = {
    "camera": CAMERA,
    "headlight": {"model": "ssl-hd-lores"},
    "ssc": {"a_d": 1.0},
    "detector": {"kind": "network"},
    "rate_hz": 30.0,
}
FIRST = 2_000_000  # seed of the first scene: the network was trained on scenes from 10,000 on, and judged on those from 1,000,000 on
OURS = "luxloop"
SHARE = 0.08  # of the high beam, which is a fifth of the low one's flux
VARIANTS: dict[str, tuple[Override, ...]] = {  # what each changes in the lighting of the scenario `obl`
    OURS: (),
    "over the low beam": ("lighting.base.beam='low'", "functions.object_light.ambient={first=1.0, least=0.05}"),
    "raising": ("functions.object_light.loop.search={kind='raise'}",),
    "by class": ("functions.object_light.method='class'", f"functions.object_light.share={SHARE}"),
    "10 lx for all": ("functions.object_light.method='constant'", f"functions.object_light.share={SHARE}"),
    "stripes": ("functions.object_light.light.pattern='stripes'",),
}
LOW, HIGH, FULL = "low beam", "high beam", "full light"  # all pixels on
BEAMS = {LOW: "low", HIGH: "high", FULL: None}
BARE = {"lighting": {"base": {"beam": "high"}}}

END = range(60, 75)  # steps of which means are what object-based lighting has come to
COMES = 75  # step at which a newcomer is there
STEPS = 105
LATE = range(STEPS - 10, STEPS)  # the same of the newcomer
NEWCOMER = "newcomer"
LEAST_HEIGHT_PX, LEAST_VISIBLE = 24, 0.5  # of objects that count; as much of them lies in the image
DAZZLING_LX = 1.0  # on heads and windscreens
FREE_M = 1.5  # from a newcomer to everybody else


@dataclass(frozen=True)
class Case:
    """One scene. scenario: plain data, but for the lighting."""

    scene: int
    moving: bool
    scenario: Mapping[str, Any]
    seeds: int

    @property
    def key(self) -> str:
        return f"scene {self.scene}, {'moving' if self.moving else 'static'}"

    @property
    def parameters(self) -> dict[str, Any]:
        """Of the job."""
        variants = {name: load("obl", each).model_dump(mode="json", include={"lighting", "functions"}) for name, each in VARIANTS.items()}
        return {"scenario": self.scenario, "variants": variants, "seeds": {name: self.seeds if name == OURS else 1 for name in VARIANTS}}


def cases(scenes: int, seeds: int) -> Iterator[Case]:
    """Every other scene moves."""
    for scene in range(scenes):
        yield Case(scene, scene % 2 == 1, scenario(FIRST + scene, scene % 2 == 1), seeds)


def scenario(seed: int, moving: bool) -> dict[str, Any]:
    """A scene at random, and a newcomer in a free place."""
    tables = random_tables(seed)
    traffic = tables["traffic"] | {"moving": moving}
    for key in ("pedestrians", "cyclists"):  # as in training: nights are emptier than what is worth looking at
        traffic[key] += 1
    plain = {"name": f"scene {seed}", "steps": STEPS, **WORLD, **tables, "traffic": traffic}
    others = [each.pose_track() for each in lit(plain).all_objects]
    places = torch.stack([track.pose_at(COMES / WORLD["rate_hz"])[:2, 3] for track in others]).numpy()
    return plain | {"objects": [_newcomer(np.random.default_rng([seed, 3]), places)]}


def _newcomer(rng: np.random.Generator, others: np.ndarray) -> dict[str, Any]:
    while True:
        x = math.exp(rng.uniform(math.log(10), math.log(30)))
        y = float(rng.uniform(-0.2, 0.2)) * x
        if np.hypot(*(others - (x, y)).T).min() > FREE_M:
            break
    made = {"kind": ("pedestrian", "cyclist")[int(rng.integers(2))], "seed": int(rng.integers(2**31)), "name": NEWCOMER}
    at = {"position_m": [round(x, 2), round(y, 2), 0.0], "yaw_deg": round(float(rng.uniform(-180, 180)), 1)}
    return made | {"track": [at], "appears_s": COMES / WORLD["rate_hz"]}


def lit(plain: Mapping[str, Any], tables: Mapping[str, Any] = BARE, seed: int = 0) -> Scenario:
    """A scenario with its tables of lighting, and a seed of noise."""
    return validate({**plain, "seed": seed, **tables}, str(plain["name"]))


def illuminated(scenario: Mapping[str, Any], variants: Mapping[str, Mapping[str, Any]], seeds: Mapping[str, int]) -> dict[str, Any]:
    """A job: every variant with so many seeds, step by step side by side, so that each view is rendered once; frames have the same noise.

    Variants beside the default end where the newcomer comes.
    The result: `objects` that count, by name; `lamps`, what they give and take in the beams of BEAMS; `beams`, what the detector says in
    these; `runs`, by variant, of each seed.
    """
    torch.set_num_threads(1)  # wherever the job runs
    own = {(name, seed): lit(scenario, tables, seed) for name, tables in variants.items() for seed in range(seeds[name])}
    shared = Simulation.prepare(next(iter(own.values())))
    simulations = {key: Simulation.prepare(each, before=shared) for key, each in own.items()}  # in its world, which is rendered once
    states = {key: each.start() for key, each in simulations.items()}
    runs = {key: Run() for key in own}
    beams, counting, seen = beam_lights(shared), Counting(shared), References(shared, max(seeds.values()))
    for step in range(STEPS):
        for key in (key for key in own if step < COMES or key[0] == OURS):
            states[key], result = simulations[key].step(states[key])
            runs[key].add(result, shared)
        if step in END or step in LATE:
            view = shared.world.lit(step / shared.scenario.rate_hz)
            counting.add(view.objects, step)
            seen.add(view, beams, step)
    names = counting.names
    return {
        "objects": {name: counting.categories[name] for name in names},
        "lamps": {beam: _given(shared, lights) for beam, lights in beams.items()},
        "beams": {beam: [_means(each, names) for each in found] for beam, found in seen.scores.items()},
        "runs": {name: [runs[name, seed].result(names) for seed in range(seeds[name])] for name in variants},
    }


def beam_lights(simulation: Simulation) -> dict[str, tuple[Tensor, ...]]:
    """Utilisations `[n_p]`, one a module, of BEAMS."""
    lamps = [(module.lamp, module.number, module.flux) for module in simulation.modules]
    return {
        name: tuple(torch.ones_like(flux) if beam is None else lamp.beam(beam)[number].to(flux) for lamp, number, flux in lamps)
        for name, beam in BEAMS.items()
    }


def _given(simulation: Simulation, lights: Sequence[Tensor]) -> dict[str, float]:
    sides = flux_by_side(simulation.modules, lights)
    return {"flux_lm": sum(sides.values()), "watts": sum(map(simulation.scenario.headlight.power_w, sides.values()))}


def _means(scores: Mapping[str, Sequence[float]], names: Sequence[str]) -> dict[str, float]:
    return {name: round(float(np.mean(scores[name])), 4) for name in names if name in scores}


class Counting:
    """Which objects count: large enough, and seen well enough, in every step that is judged; the newcomer in those at the end."""

    def __init__(self, simulation: Simulation) -> None:
        assert simulation.pipeline is not None and simulation.pipeline.detector is not None
        self.classes = simulation.pipeline.detector.classes
        self.categories: dict[str, str] = {}
        self.steps: dict[str, int] = {}

    def add(self, objects: Sequence[GroundTruth], step: int) -> None:
        for each in objects:
            large, seen = each.whole[3] - each.whole[1] >= LEAST_HEIGHT_PX, min(each.visible, each.inside) >= LEAST_VISIBLE
            if large and seen and each.category in self.classes and (step in LATE) == (each.name == NEWCOMER):
                self.categories[each.name] = each.category
                self.steps[each.name] = self.steps.get(each.name, 0) + 1

    @property
    def names(self) -> list[str]:
        return [name for name, steps in self.steps.items() if steps == len(LATE if name == NEWCOMER else END)]


class References:
    """What the detector says of objects in the light of beams, with each seed's noise: scores by name, 0 where it finds none."""

    def __init__(self, simulation: Simulation, seeds: int) -> None:
        assert simulation.pipeline is not None
        self.pipeline: DetectionPipeline = simulation.pipeline
        self.camera: CameraParams = simulation.scenario.camera
        self.scores: dict[str, list[dict[str, list[float]]]] = {beam: [{} for _ in range(seeds)] for beam in BEAMS}
        self._last: tuple[LitScene, dict[str, Tensor]] | None = None

    def add(self, view: LitScene, beams: Mapping[str, Sequence[Tensor]], step: int) -> None:
        if self._last is None or self._last[0] is not view:
            self._last = (view, {beam: view.light(lights)[1] + view.base for beam, lights in beams.items()})
        for beam, luminance in self._last[1].items():
            for seed, scores in enumerate(self.scores[beam]):
                frame = expose(luminance, self.camera, FrameNoise.of(seed, step, 0))
                found = self.pipeline.find(frame / (2**self.camera.bits - 1), view)
                its_box = dict(pairs(view.boxes, found.boxes.double().cpu()))
                for k, each in enumerate(view.objects):
                    if (step in LATE) == (each.name == NEWCOMER):
                        scores.setdefault(each.name, []).append(float(found.scores[its_box[k]].max()) if k in its_box else 0.0)


class Run:
    """What is kept of one run."""

    def __init__(self) -> None:
        self.flux_lm: list[float] = []
        self.watts: list[float] = []
        self.eyes_lx: list[float | None] = []
        self.scores: dict[str, list[float]] = {}
        self.tracked: dict[str, list[int]] = {}  # steps in which a track shows an object
        self.newcomer_lx: list[float | None] = []
        self.dazzled: list[tuple[int, str, float, bool]] = []  # step, object, lx on its eyes, whether a track shows it
        self.searches: dict[str, list[int | None]] = {}  # first step of a track's loop, and the first in which it had settled

    def add(self, result: StepResult, shared: Simulation) -> None:
        assert result.look is not None
        self.flux_lm.append(round(sum(power.flux_lm for power in result.powers.values()), 2))
        self.watts.append(round(sum(power.watts for power in result.powers.values()), 3))
        self.eyes_lx.append(_rounded(result.look.eyes_lx_max))
        for name, each in result.look.recognised.items():
            if each.track is not None:
                self.tracked.setdefault(name, []).append(result.step)
            if result.step in (LATE if name == NEWCOMER else END):
                self.scores.setdefault(name, []).append(each.score)
        for state in (each for each in result.functions.values() if isinstance(each, ObjectBasedState)):
            for track, loop in state.loops.items():
                search = self.searches.setdefault(track, [result.step, None])
                if loop.settled and search[1] is None:
                    search[1] = result.step
        if (result.look.eyes_lx_max or 0.0) > DAZZLING_LX:
            self.dazzled += dazzled(result, shared.world.lit(result.time_s))
        if result.step >= COMES:
            self.newcomer_lx.append(_rounded(result.objects[NEWCOMER].lx_mean))

    def result(self, names: Sequence[str]) -> dict[str, Any]:
        """Plain values. scores, tracked: by name, mean, and share of the steps that are judged. found: first step with a track, if any."""
        judged = {name: LATE if name == NEWCOMER else END for name in names}
        return {
            "flux_lm": self.flux_lm,
            "watts": self.watts,
            "eyes_lx": self.eyes_lx,
            "scores": _means(self.scores, names),
            "tracked": {name: len(set(judged[name]) & set(self.tracked.get(name, ()))) / len(judged[name]) for name in names},
            "found": {name: self.tracked[name][0] if name in self.tracked else None for name in names},
            "newcomer_lx": self.newcomer_lx,
            "dazzled": self.dazzled,
            "searches": list(self.searches.values()),
        }


def dazzled(result: StepResult, view: LitScene) -> list[tuple[int, str, float, bool]]:
    """Whose heads and windscreens get more than DAZZLING_LX in this step, how much, and whether a track shows them."""
    assert result.look is not None
    found = []
    for each in view.objects:
        lx = result.illuminance[view.eyes & (view.surfaces.object_id == each.object_id)]
        most = float(lx.max()) if len(lx) else 0.0
        if most > DAZZLING_LX:
            its_track = result.look.recognised[each.name].track
            found.append((result.step, each.name, round(most, 3), its_track is not None))
    return found


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 3)
