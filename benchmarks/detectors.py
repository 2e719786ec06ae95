"""What detectors find of both populations of traffic: `python benchmarks/detectors.py [--quick] [--scenes N] [--first SEED]`.

The network was trained on scenes of the first population. One frame a scene, at a random moment, in the light of the high beam without
any dimming and of the low beam. Prints the tables of docs/detectors.md.
"""

from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import torch
from bench import run, show

from luxloop import Simulation, validate
from luxloop.loop.studies.training.evaluate import HEIGHT_PX, INSIDE, VISIBLE, score_frame
from luxloop.loop.studies.training.scenes import CLASSES, MOMENTS_S, SceneObject, tables
from luxloop.perception.camera import expose
from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import Detector, HogParams, NetworkParams
from luxloop.perception.ground_truth import ground_truth
from luxloop.perception.noise import FrameNoise
from luxloop.world.traffic.generator import second_tables
from luxloop.world.traffic.models import MODELS

WORLDS = {"first": tables, "second": second_tables}
CAMERA = {"width_px": 640, "height_px": 360, "pitch_deg": 1.5, "oversampling": 1, "saturation_e": 2000.0}
RATE_HZ = 30.0
BEAMS = ("high", "low")
COUNTS_AS = {"truck": "car", "motorcycle": "cyclist"}  # of the network's classes
Row = dict[str, Any]


def category_and_shape(item: Any) -> tuple[str | None, str]:
    """What an object counts as, parked cars, too, and the name of its shape."""
    if item.kind == "model":
        category = MODELS[item.model][0]
        return COUNTS_AS.get(category, category), item.model
    return ("car", "car") if item.kind == "car" else (item.category, item.kind)


def frames(seed: int, population: str) -> Iterator[tuple[str, torch.Tensor, list[SceneObject], list[str]]]:
    """Beam, frame in 0..1, objects and their shapes."""
    world = {"camera": CAMERA, "detector": {"kind": "network"}, "headlight": {"model": "ssl-hd-lores"}, **WORLDS[population](seed)}
    world["traffic"] |= {"on_road": True}
    steps = round(MOMENTS_S * RATE_HZ)
    scenario = validate({"name": "judged", "steps": steps, "rate_hz": RATE_HZ, "lighting": {}, **world}, f"seed {seed}")
    simulation = Simulation.prepare(scenario)
    view = simulation.world.lit(float(np.random.default_rng([seed, 2]).uniform(0, MOMENTS_S)))
    known = [category_and_shape(item) for item in scenario.all_objects]
    objects, shapes = [], []
    for each in ground_truth(view.surfaces, view.triangles, view.view, [category for category, _ in known]):
        if each.category in CLASSES and each.inside > 0:
            box = np.clip(each.whole, 0.0, (CAMERA["width_px"], CAMERA["height_px"]) * 2).tolist()
            objects.append(SceneObject(each.object_id, CLASSES.index(each.category), tuple(box), each.visible, each.inside))
            shapes.append(known[each.object_id - 1][1])
    for beam in BEAMS:
        lights = [module.lamp.beam(beam)[module.number].to(module.flux) for module in simulation.modules]
        frame = expose(view.light(lights)[1] + view.base, scenario.camera, FrameNoise.of(seed, 0, 0))
        yield beam, frame / (2**scenario.camera.bits - 1), objects, shapes


def judge(seed: int, population: str, detectors: Mapping[str, Detector]) -> tuple[list[Row], list[Row]]:
    """Rows of required objects of the detectors' classes, and of numbers of false boxes, in a scene."""
    found, false = [], []
    for beam, frame, objects, shapes in frames(seed, population):
        required = [e.height >= HEIGHT_PX and e.visible >= VISIBLE and e.inside >= INSIDE for e in objects]
        of_required = [shape for shape, must in zip(shapes, required, strict=True) if must]
        for name, each in detectors.items():
            where = {"population": population, "detector": name, "beam": beam}
            scores = score_frame(each.detect(frame[None])[0], objects, [CLASSES.index(of) for of in each.classes])
            false.append(where | {"false": scores.false})
            found += [
                where | {"shape": shape, "class": CLASSES[label], "found": hit, "right": right}
                for shape, label, hit, right in zip(of_required, scores.labels, scores.found, scores.right, strict=True)
                if CLASSES[label] in each.classes
            ]
    return found, false


def measure(given: Namespace) -> dict[str, Any]:
    detectors = {"network": detector(NetworkParams(), torch.device("cpu")), "hog": detector(HogParams(), torch.device("cpu"))}
    scenes = [judge(seed, name, detectors) for seed in range(given.first, given.first + given.scenes) for name in WORLDS]
    return tables_of([row for found, _ in scenes for row in found], [row for _, false in scenes for row in false])


def tables_of(found: Sequence[Row], false: Sequence[Row]) -> dict[str, Any]:
    """Prints the tables of all rows."""
    objects, boxes = pd.DataFrame(found), pd.DataFrame(false)
    keys = ["detector", "population", "beam"]
    of_all = objects.groupby(keys).agg(objects=("right", "size"), found=("found", "mean"), recall=("right", "mean"))
    of_class = objects.pivot_table(index=keys, columns="class", values="right", aggfunc="mean")
    summary = of_all.join(boxes.groupby(keys)["false"].mean().rename("false a frame")).join(of_class)
    show("Recall and false boxes a frame", {", ".join(key): row.dropna().to_dict() for key, row in summary.iterrows()})
    network = objects[objects["detector"].eq("network")]
    by_shape = network.pivot_table(index=["population", "class", "shape"], columns="beam", values=["found", "right"], aggfunc="mean")
    by_shape.columns = [f"{what}, {beam}" for what, beam in by_shape.columns]
    sizes = network[network["beam"].eq(BEAMS[0])].groupby(["population", "class", "shape"]).size().rename("objects")
    by_shape = by_shape.join(sizes)
    show("The network by shape", {", ".join(key): row.to_dict() for key, row in by_shape.iterrows()})
    return {
        "summary": {" ".join(key): row.dropna().to_dict() for key, row in summary.iterrows()},
        "by_shape": {" ".join(key): row.to_dict() for key, row in by_shape.iterrows()},
    }


if __name__ == "__main__":
    run(measure, __doc__, "scenes", "first")
