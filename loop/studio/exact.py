"""What programs ask for of a step: digital numbers, depths, what is seen at each pixel, and the truth of objects."""

from collections.abc import Collection
from typing import Any

import numpy as np
from torch import Tensor

from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studio.messages import View

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
    if "depth" in wanted:
        arrays["depth"] = _array(lit.depth, np.float32)
    if "instances" in wanted:
        arrays["instances"], head["instances"] = _array(lit.surfaces.object_id + 1, np.uint16), [*world.instances]
    if "materials" in wanted:
        index, materials = lit.materials
        arrays["materials"], head["materials"] = _array(index + 1, np.uint8), ["", *materials]
    if "truth" in wanted:
        head["truth"] = [
            {
                "name": each.name,
                "instance": each.instance,
                "category": each.category,
                "T_world_object": each.boxed.T_world_object.flatten().tolist(),
                "size_m": each.boxed.size_m,
                "box": None if each.seen is None else each.seen.box,
                "visible": 0.0 if each.seen is None else each.seen.visible,
            }
            for each in world.objects_at(result.time_s)
        ]
    return head, arrays


def _array(values: Tensor, dtype: Any) -> np.ndarray:
    array: np.ndarray = np.ascontiguousarray(values.cpu().numpy(), dtype)
    return array
