"""Worn pixels found and compensated while driving: `python benchmarks/wear.py [--seconds S] [--seeds N]`.

A car drives at 14 m/s in its low beam over a road of ISO class B; 2 % of the pixels are dead, 5 % have half of their light. Prints the
table of docs/wear.md: worn pixels found among those that light the road in sight, and how even the low beam on the road is then.
"""

import sys
from argparse import Namespace
from typing import Any

import torch
from bench import Goal, run, show, study
from torch import Tensor

from luxloop import Simulation, validate
from luxloop.controllers.pixels.compensation import Compensation
from luxloop.perception.pixel_gains import FARTHEST_M, NEAREST_M
from luxloop.world.frames import View
from luxloop.world.headlight import Headlight
from luxloop.world.light.illumination import illuminance, lit_surface
from luxloop.world.rendering.gbuffer import GBuffer, flat_road

RATE_HZ, SPEED_M_S = 30.0, 14.0
DEAD, AGED, AGED_TO = 0.02, 0.05, 0.5
IN_SIGHT = 0.5  # share of a pixel's light that lies on the road in sight
LEAST_LX = 1.0  # of the new low beam, on road that is to be even
CELL_M = 0.25


def scenario(seed: int, seconds: float, roughness: str) -> dict[str, Any]:
    """A drive with worn lamps."""
    return {
        "name": "worn",
        "steps": round(seconds * RATE_HZ),
        "rate_hz": RATE_HZ,
        "seed": seed,
        "road": {"kind": "iso8608", "roughness_class": roughness, "seed": seed},
        "surface": {"seed": seed},
        "headlight": {"model": "ssl-hd-lores"},
        "lighting": {"base": {"beam": "low"}},
        "camera": {"width_px": 640, "height_px": 360, "pitch_deg": 4.0},
        "vehicle": {"course": [{"speed_m_s": SPEED_M_S}]},
        "pixel_gains": {"update_s": seconds / 6},
        "disturbances": {"wear": {"dead": DEAD, "aged": AGED, "aged_factor": AGED_TO, "seed": seed}},
    }


def drive(seed: int, seconds: float, roughness: str) -> dict[str, Any]:
    """A job: figures of one drive, over both lamps."""
    torch.set_num_threads(1)
    simulation = Simulation.prepare(validate(scenario(seed, seconds, roughness), "worn"))
    assert simulation.gain_loop is not None
    state = simulation.start()
    for _ in range(simulation.scenario.steps):
        state, _ = simulation.step(state)
    assert state.gains is not None
    counts, beams = {"in sight": 0, "known": 0, "worn": 0, "found": 0, "false": 0}, {}
    for module, true, gains in zip(simulation.modules, simulation.world.modules, state.gains.gains, strict=True):
        left = _left(module.headlight, true.headlight)
        seen = in_sight(simulation.view, module.headlight, module.T_world_module) & (module.beam("low") >= 0.05)
        worn = seen & (left < 1)
        more = int(seen.sum()), int((seen & gains.known).sum()), int(worn.sum()), int((worn & gains.worn).sum())
        more += (int((seen & (left == 1) & gains.worn).sum()),)
        counts = {key: count + each for (key, count), each in zip(counts.items(), more, strict=True)}
        u = module.beam("low")
        beams[module.name] = {
            "new": (module.headlight, u),
            "worn": (true.headlight, u),
            "compensated": (true.headlight, Compensation(module.headlight, gains.gain).utilisation(u)),
            "with true gains": (true.headlight, Compensation(module.headlight, left).utilisation(u)),
        }
    road = _road(simulation.view)
    poses = {module.name: module.T_world_module for module in simulation.modules}
    lx = {
        light: sum(_lx(road, poses[name], *each[light]) for name, each in beams.items())
        for light in ("new", "worn", "compensated", "with true gains")
    }
    even = lx["new"] >= LEAST_LX
    off = {light: (each / lx["new"] - 1)[even].abs() for light, each in lx.items() if light != "new"}
    return counts | {f"off 95 %, {light}": float(each.quantile(0.95)) for light, each in off.items()}


def _left(new: Headlight, worn: Headlight) -> Tensor:
    """True gains `[n_p]`."""
    return worn.pixel_flux / new.pixel_flux


def in_sight(view: View, headlight: Headlight, T_world_headlight: Tensor) -> Tensor:
    """Pixels `[n_p]` bool with enough of their light on the flat road that a level camera sees, from NEAREST_M to FARTHEST_M ahead."""
    y, z = (each.flatten() for each in torch.meshgrid(*headlight.tangents()[::-1], indexing="ij")[::-1])
    rays = T_world_headlight.double()[:3, :3] @ torch.stack([torch.ones_like(y), y, z])
    lamp = T_world_headlight.double()[:3, 3:]
    place = lamp + rays * (-lamp[2] / rays[2].clamp(max=-1e-9))
    (u, v), depth = view.project(place)
    seen = (rays[2] < 0) & (place[0] > NEAREST_M) & (place[0] < FARTHEST_M) & (depth > 0)
    seen &= (u > 0) & (u < view.width) & (v > 0) & (v < view.height)
    matrix = headlight.matrix.to_scipy()
    return torch.from_numpy(matrix.T @ seen.double().numpy() > IN_SIGHT * matrix.sum(0).A1)


def _road(view: View) -> GBuffer:
    """The flat road from above, in the camera's field."""
    rows, columns = round((FARTHEST_M - NEAREST_M) / CELL_M), round(24 / CELL_M)
    above = torch.eye(4, dtype=torch.float64)
    above[:3, :3] = torch.tensor([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]], dtype=torch.float64)
    height = 1000.0
    above[:3, 3] = torch.tensor([(NEAREST_M + FARTHEST_M) / 2, 0, height], dtype=torch.float64)
    f = height / CELL_M
    road = flat_road(View(columns, rows, f, f, columns / 2, rows / 2, above), 1.0, torch.float64)
    (u, v), depth = view.project(road.position.flatten(1))
    seen = (depth > 0) & (u > 0) & (u < view.width) & (v > 0) & (v < view.height)
    return GBuffer(road.position, road.normal, road.albedo, torch.where(seen.view_as(road.object_id), road.object_id, -1), road.finish)


def _lx(road: GBuffer, T_world_headlight: Tensor, headlight: Headlight, u: Tensor) -> Tensor:
    surface = lit_surface(road, headlight, T_world_headlight)
    return torch.zeros(road.albedo.numel(), dtype=torch.float64).index_add(
        0, surface.index, illuminance(surface, headlight.light_texture(u).double())
    )


def measure(given: Namespace) -> dict[str, Any]:
    todo = {
        f"class {roughness}, seed {seed}": {"seed": seed, "seconds": given.seconds, "roughness": roughness}
        for roughness in given.classes
        for seed in range(given.seeds)
    }
    found, failures = study(drive, todo, given, [sys.modules[__name__]])
    show("Worn pixels", found)
    rows = found.values()
    total = {key: sum(each[key] for each in rows) for key in ("in sight", "worn", "found", "false")}
    goals = [
        Goal("Worn pixels found, of those that light the road in sight", total["found"] / total["worn"], 0.9, True),
        Goal("Good pixels taken for worn", total["false"] / (total["in sight"] - total["worn"]), 0.005),
        Goal("Deviation of the light on the road, 95 % quantile", max(each["off 95 %, compensated"] for each in rows), 0.05),
    ]
    return {"drives": found, "goals": goals, "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "seconds", "classes", "seeds", "out", "jobs")
