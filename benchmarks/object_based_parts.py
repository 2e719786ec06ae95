"""Parts of the chain of object-based lighting on their own: zones, the tracker in good light, and pairs of renderings that should agree."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import torch
from object_based_cases import CAMERA, FIRST, WORLD, lit, scenario
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from luxloop.loop.simulation.detection import pairs
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import World
from luxloop.loop.studies.jobs.runner import Job
from luxloop.perception.camera import expose
from luxloop.perception.detection.detector import SAME, Detections, overlaps
from luxloop.perception.metrics import dssim
from luxloop.perception.noise import FrameNoise
from luxloop.world.headlight.overlap import reduce

REFLECTANCES = (0.05, 0.1, 0.2, 0.4, 0.8)
PLACES = ((17.0, 3.0), (25.0, 0.0), (17.0, -3.0))  # of walls, x and y in m
FULL_WELLS = (8000.0, CAMERA["saturation_e"])  # electrons, of cameras that measure up to 10.7 and 2.7 cd/m^2
TARGET, ZONE_STEPS, WITHIN = 0.9, 20, 0.05  # cd/m^2, steps, share
HIDDEN, SHOWN = 0.2, 0.5  # visible share of what is hidden, and of what has to have its old number
DSSIM_PX = 1.5  # the usual window
KEEP = 8  # pixels a texel of the reduced matrix, of 30 in the middle


def zone_jobs(seeds: int) -> Iterator[Job]:
    """Each reflectance once in each place, with each camera."""
    walls = [[REFLECTANCES[(first + k) % len(REFLECTANCES)] for k in range(len(PLACES))] for first in range(len(REFLECTANCES))]
    for seed in range(seeds):
        for saturation_e in FULL_WELLS:
            for each in walls:
                named = f"zones, {' '.join(map(str, each))}, {saturation_e:g} e, seed {seed}"
                yield Job(named, {"reflectances": each, "saturation_e": saturation_e, "seed": seed})


def zones(reflectances: Sequence[float], saturation_e: float, seed: int) -> dict[str, Any]:
    """A job: how bright three walls are, each with a zone, `luminance` in cd/m^2 by step, and what they reflect."""
    torch.set_num_threads(1)
    walls, functions = [], {}
    for k, ((x, y), albedo) in enumerate(zip(PLACES, reflectances, strict=True)):
        size, at = (0.2, 2.0, 2.0), [{"position_m": (x + 0.1, y, 0.0)}]
        walls.append({"kind": "box", "name": f"wall_{k}", "size_m": size, "albedo": albedo, "track": at})
        functions[f"zone_{k}"] = {"kind": "zone", "centre_m": (x, y, 1.0), "size_m": (0.0, 1.6, 1.6), "luminance_cd_m2": TARGET}
    world = {key: value for key, value in WORLD.items() if key != "detector"}
    world["camera"] = CAMERA | {"saturation_e": saturation_e}
    plain = {"name": "zones", "steps": ZONE_STEPS, **world, "light": {"ambient_lx": 0.1}, "objects": walls}
    results = list(Simulation.prepare(lit(plain, {"lighting": {"base": {"beam": "low"}}, "functions": functions}, seed)).run())
    return {
        "zones": [
            {"reflectance": albedo, "luminance": [result.zones[f"zone_{k}"].luminance for result in results]}
            for k, albedo in enumerate(reflectances)
        ]
    }


def _walker(name: str, seed: int, kind: str, way: Sequence[tuple[float, float]], speed_m_s: float) -> dict[str, Any]:
    path = {"points_m": [(x, y, 0.0) for x, y in way], "speed_m_s": speed_m_s}
    return {"kind": kind, "name": name, "seed": seed, "path": path}


def _crossing(k: int) -> list[dict[str, Any]]:
    """Two pedestrians, from both sides."""
    x = 13.0 + 3 * k
    return [
        _walker("from_the_left", FIRST + 10 * k, "pedestrian", [(x, 2.0), (x, -6.0)], 1.4),
        _walker("from_the_right", FIRST + 10 * k + 1, "pedestrian", [(x + 1.5, -2.0), (x + 1.5, 6.0)], 1.4),
    ]


def _overtaking(k: int) -> list[dict[str, Any]]:
    """A cyclist who overtakes another."""
    return [
        _walker("slow", FIRST + 10 * k + 2, "cyclist", [(16.0 + 2 * k, -1.2), (60.0, -1.2)], 2.0),
        _walker("fast", FIRST + 10 * k + 3, "cyclist", [(11.0 + 2 * k, 0.2), (60.0, 0.2)], 6.0),
    ]


def _hidden(k: int) -> list[dict[str, Any]]:
    """A pedestrian who walks behind a pillar."""
    x = 14.0 + 2 * k
    pillar = {"kind": "box", "name": "pillar", "size_m": (0.3, 0.85, 2.4), "albedo": 0.2, "track": [{"position_m": (x - 1.5, 0.0, 0.0)}]}
    return [_walker("walker", FIRST + 10 * k + 4, "pedestrian", [(x, -1.6), (x, 6.0)], 1.3), pillar]


SITUATIONS = {"two pedestrians cross": _crossing, "a cyclist overtakes": _overtaking, "10 frames behind a pillar": _hidden}
DENSE = "dense traffic"


def track_jobs(seeds: int, times: int, steps: int) -> Iterator[Job]:
    """Each situation so often, each time in another place with others."""
    for k in range(times):
        for name, made in SITUATIONS.items():
            plain = {"name": name, "steps": steps, **WORLD, "objects": made(k)}
            yield Job(f"{name} {k}", {"situation": name, "scenario": plain, "seeds": seeds})
        busy = scenario(FIRST + 900_000 + k, moving=True)
        traffic = {"seed": k, "pedestrians": 8, "cyclists": 3, "cars": 2, "parked": 2, "moving": True}
        plain = {**busy, "objects": [], "steps": steps, "traffic": traffic}
        yield Job(f"{DENSE} {k}", {"situation": DENSE, "scenario": plain, "seeds": seeds})


def tracked(situation: str, scenario: Mapping[str, Any], seeds: int) -> dict[str, Any]:
    """A job: identities in the light of the high beam, with each seed's noise.

    `objects`: a list for each seed of `switches`, how often the number changed of a track that shows an object; `frames`, in which it is
    seen well enough; `lost`, those of them without a track after the first that had one; `hidden`, in which it is not.
    """
    torch.set_num_threads(1)
    own = [lit(scenario, seed=seed) for seed in range(seeds)]
    shared = Simulation.prepare(own[0])
    simulations = [Simulation.prepare(each, before=shared) for each in own]
    states, tracks = [each.start() for each in simulations], [dict[str, list[int | None]]() for _ in own]
    hidden: dict[str, int] = {}
    matches: list[Mapping[str, int]] = [{} for _ in own]
    for step in range(shared.scenario.steps):
        view = shared.world.lit(step / shared.scenario.rate_hz)
        shown = {each.name: each.visible * each.inside for each in view.objects}
        hidden |= {name: hidden.get(name, 0) + (share < HIDDEN) for name, share in shown.items()}
        for k, each in enumerate(simulations):
            states[k], result = each.step(states[k])
            assert result.look is not None
            names, numbers = [each.name for each in view.objects], result.look.tracks.number.tolist()
            matches[k] = matched(matches[k], names, numbers, overlaps(view.boxes, result.look.tracks.boxes))
            for name in names:
                if shown[name] >= SHOWN:
                    tracks[k].setdefault(name, []).append(matches[k].get(name))
    return {
        "situation": situation,
        "objects": [[_identity(each) | {"hidden": hidden[name]} for name, each in of_seed.items()] for of_seed in tracks],
    }


def matched(before: Mapping[str, int], names: Sequence[str], numbers: Sequence[int], shares: Tensor) -> Mapping[str, int]:
    """Numbers of the tracks that show objects, by name: those that did before as long as they overlap, the others as they overlap most.

    That is how identities are followed since CLEAR MOT (Bernardin & Stiefelhagen 2008). shares: IoU `[objects, tracks]`.
    """
    column = {number: j for j, number in enumerate(numbers)}
    present = {name: number for name, number in before.items() if number in column}
    kept = {name: present[name] for i, name in enumerate(names) if name in present and shares[i, column[present[name]]] >= SAME}
    rows, columns = [k for k, name in enumerate(names) if name not in kept], [k for k, n in enumerate(numbers) if n not in kept.values()]
    left = shares[rows][:, columns]
    most = zip(*(each.tolist() for each in linear_sum_assignment(-left)), strict=True)
    return kept | {names[rows[i]]: numbers[columns[j]] for i, j in most if left[i, j] >= SAME}


def _identity(tracks: Sequence[int | None]) -> dict[str, int]:
    numbers = [number for number in tracks if number is not None]
    begun = next((k for k, number in enumerate(tracks) if number is not None), len(tracks))
    lost = sum(number is None for number in tracks[begun:])
    return {"switches": sum(a != b for a, b in pairwise(numbers)), "frames": len(tracks), "found": len(tracks) - begun, "lost": lost}


def pair_jobs(scenes: int) -> Iterator[Job]:
    for k in range(scenes):
        yield Job(f"renderings of scene {k}", {"scenario": {**scenario(FIRST + k, moving=False), "objects": []}})


def agreement(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """A job: how far pairs of frames of one scene in its high beam are apart, by the pair's name. All but the last have the same noise."""
    torch.set_num_threads(1)
    moving = {**scenario, "traffic": {**scenario["traffic"], "moving": True}}  # which is what the quick way is for
    exact, rays, quick, moved = (
        _frame(Simulation.prepare(lit({**world, "renderer": renderer})))
        for world, renderer in ((scenario, "opengl"), (scenario, "raycast"), (moving, "opengl"), (moving, "raycast"))
    )
    simulation = Simulation.prepare(lit(scenario))
    reduced, again = _frame(_with_less_overlap(simulation)), _frame(simulation, noise=1)
    return {
        "OpenGL, exact, and rays": _apart(exact, rays),
        "OpenGL, quick, and rays": _apart(quick, moved),
        f"full overlap and {KEEP} pixels a texel": _apart(exact, reduced),
        "yardstick: two frames of one scene": _apart(exact, again),
    }


def _frame(simulation: Simulation, noise: int = 0) -> tuple[Tensor, Detections]:
    """A frame in the high beam as shares of the largest digital number, and what is found in it."""
    assert simulation.pipeline is not None
    view, camera = simulation.world.lit(0.0), simulation.scenario.camera
    lights = [module.lamp.beam("high")[module.number].to(module.flux) for module in simulation.modules]
    luminance = view.light(lights)[1] + view.base
    frame = expose(luminance, camera, FrameNoise.of(noise, 0, 0)) / (2**camera.bits - 1)
    return frame, simulation.pipeline.find(frame, view)


def _with_less_overlap(simulation: Simulation) -> Simulation:
    """The same with lamps of which each texel has its strongest pixels alone, with the light of all (T 5.2)."""
    modules = []
    for module in simulation.world.modules:
        light = replace(module.headlight, matrix=reduce(module.headlight.matrix, KEEP, "proportional"))
        modules.append(replace(module, headlight=light))
    before = simulation.world
    world = World(before.scene, modules, before.camera, before.source, before.motion, metered=True, given=before.given)
    return replace(simulation, plant=replace(simulation.plant, world=world))


def _apart(one: tuple[Tensor, Detections], other: tuple[Tensor, Detections]) -> dict[str, Any]:
    """mae: share of the largest number. score_changes: of boxes that both have. alone: boxes that one has and the other has not."""
    (a, found_a), (b, found_b) = one, other
    both = pairs(found_a.boxes.double(), found_b.boxes.double())
    changes = [abs(float(found_a.scores[i].max() - found_b.scores[j].max())) for i, j in both]
    shared = ({i for i, _ in both}, {j for _, j in both})
    alone = [
        float(found.scores[k].max()) for found, its in zip((found_a, found_b), shared, strict=True) for k in set(range(len(found))) - its
    ]
    return {
        "mae": float((a - b).abs().mean()),
        "dssim": float(dssim(a, b, DSSIM_PX, 1.0)),
        "score_changes": [round(each, 4) for each in changes],
        "alone": [round(each, 4) for each in sorted(alone, reverse=True)],
    }
