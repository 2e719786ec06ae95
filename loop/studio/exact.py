"""What programs ask for of a step: digital numbers, depths, what is seen at each pixel, and the truth of objects."""

from collections.abc import Collection
from typing import Any

import numpy as np
from torch import Tensor

from controllers.situation import TrackedObject
from loop.lighting.result import StepResult
from loop.lighting.simulation import Simulation
from loop.studio.messages import View

Told = tuple[dict[str, Any], dict[str, np.ndarray]]  # what a head says of it, and arrays


def exact(simulation: Simulation, result: StepResult, wanted: Collection[View]) -> Told:
    """What is asked for of a step that was just done, as the protocol has it. It renders, and so runs where the steps do.

    Depth, instances, materials and truth are there where the plant knows the truth.
    """
    head, arrays = dict[str, Any](), dict[str, np.ndarray]()
    if "frames" in wanted:
        dtype = np.uint8 if simulation.scenario.camera.bits <= 8 else np.uint16
        frames = result.frames or (() if result.frame is None else (result.frame,))
        arrays |= {name: _array(frame, dtype) for name, frame in zip(("frames.on", "frames.off"), frames, strict=False)}
    if (world := simulation.truth) is None or not {"depth", "instances", "materials", "truth"} & set(wanted):
        return head, arrays
    lit = world.lit(result.time_s)
    names = ["", "road", *(each.name for each in world.scene.objects)]
    if "depth" in wanted:
        T, seen = lit.view.T_world_view.to(lit.surfaces.position), lit.surfaces.object_id >= 0
        along = (T[:3, 2, None, None] * (lit.surfaces.position - T[:3, 3, None, None])).sum(0)
        arrays["depth"] = _array(along.where(seen, 0 * along), np.float32)
    if "instances" in wanted:
        arrays["instances"], head["instances"] = _array(lit.surfaces.object_id + 1, np.uint16), names
    if "materials" in wanted:
        index, materials = lit.materials
        arrays["materials"], head["materials"] = _array(index + 1, np.uint8), ["", *materials]
    if "truth" in wanted:
        head["truth"] = _truth(simulation, result.time_s)
    return head, arrays


def _truth(simulation: Simulation, time_s: float) -> list[dict[str, Any]]:
    """Of all objects that are there."""
    lit, world = simulation.world.lit(time_s), simulation.world
    there, seen = {each.object_id for each in lit.triangles.placed}, {each.object_id: each for each in lit.objects}
    told = []
    for number, (body, given) in enumerate(zip(world.scene.objects, world.given, strict=True), 1):
        if number in there:
            boxed, found = TrackedObject.of(body, given.category or "car", time_s), seen.get(number)
            told.append(
                {
                    "name": body.name,
                    "instance": number + 1,
                    "category": given.category,
                    "T_world_object": boxed.T_world_object.flatten().tolist(),
                    "size_m": boxed.size_m,
                    "box": None if found is None else found.box,
                    "visible": 0.0 if found is None else found.visible,
                }
            )
    return told


def _array(values: Tensor, dtype: Any) -> np.ndarray:
    array: np.ndarray = np.ascontiguousarray(values.cpu().numpy(), dtype)
    return array
