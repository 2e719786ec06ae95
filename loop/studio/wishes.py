"""Light wanted in the world, painted on the pixels that give it (T 4.2.2)."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.base_beams import Picture
from luxloop.controllers.pixels.jpo_plane import Raster, fit_plane, lighting
from luxloop.loop.report.picture import WALL_M
from luxloop.loop.studio.messages import Place, Wish
from luxloop.loop.studio.painting import layer, override
from luxloop.loop.studio.runs import Run
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import inverse
from luxloop.world.messages import Arrays

MOST_CELLS: Final = 20_000
MOST_LX: Final = 100_000.0
# A wall before the middle of the lamps: x up, y to the left, z towards the car.
T_BODY_WALL: Final = torch.tensor([[0.0, 0, -1, WALL_M], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)

Answer = tuple[dict[str, Any], str | None]  # head of the message, and the override that paints


def placed(run: Run, place: Place) -> Answer:
    """The pixels that light a point of the world in the step that was shown last."""
    point, modules, layers = torch.tensor(place.point_m, dtype=torch.float64), list[dict[str, Any]](), {}
    for k, (module, pose) in enumerate(zip(run.simulation.modules, _poses(run), strict=True)):
        pixels, cd = lighting(module.headlight, pose, point)
        if len(pixels):
            modules.append({"module": k, "pixels": pixels.tolist(), "cd": float(cd.sum())})
            if place.value is not None:
                layers[k] = _painted(layer(run.simulation, k), pixels, torch.full((len(pixels),), place.value, dtype=torch.uint8))
    head = {"type": "place", "point_m": place.point_m, "modules": modules}
    return head, override(run.simulation, layers, place.over) if layers else None


def wished(run: Run, wish: Wish, arrays: Arrays) -> Answer:
    """What comes closest to the light wanted. Raises LuxloopError where the raster is none, or no pixel lights it."""
    lx, where = arrays["lx"], arrays["painted"] > 0
    x_min, x_max, y_min, y_max = wish.box_m
    if lx.ndim != 2 or lx.shape != where.shape or not 0 < lx.size <= MOST_CELLS:
        shapes = f"{list(lx.shape)} and {list(where.shape)}"
        raise LuxloopError(f"wish: lx and painted have the shapes {shapes}; give both as one raster of at most {MOST_CELLS} cells")
    if not (x_min < x_max and y_min < y_max):
        raise LuxloopError(f"wish: the box {list(wish.box_m)} is empty; give least x, largest x, least y, largest y")
    if not where.any():
        raise LuxloopError("wish: nothing is painted; paint where light is wanted")
    if not ((lx[where] >= 0) & (lx[where] <= MOST_LX)).all():
        raise LuxloopError(f"wish: light wanted lies between 0 and {MOST_LX:g} lx")
    raster = Raster(x_min, x_max, y_min, y_max, *lx.shape)
    head, lights, poses = run.snapshots[-1].head, run.snapshots[-1].lights, _poses(run)
    T_plane_world = inverse(_matrix(head["T_world_ground"]) if wish.on == "road" else _matrix(head["T_world_body"]) @ T_BODY_WALL)
    lamps = [(each.headlight, T_plane_world @ poses[k], lights[k]) for k, each in enumerate(run.simulation.modules)]
    there = torch.from_numpy(where).flatten()
    goal = torch.from_numpy(np.where(where, lx, 0).astype(np.float32)).flatten()
    found = fit_plane(lamps, raster, goal, there)
    off = (found.lx - goal)[there]
    answer = {
        "type": "wish",
        "on": wish.on,
        "wanted_lx": float(goal[there].mean()),
        "rmse_lx": float(off.square().mean().sqrt()),
        "worst_lx": float(off.abs().max()),
        "pixels": int(sum(each.sum() for each in found.chosen)),
    }
    layers = {
        k: _painted(layer(run.simulation, k), chosen.nonzero()[:, 0], (255 * u[chosen]).round().byte())
        for k, (u, chosen) in enumerate(zip(found.u, found.chosen, strict=True))
        if chosen.any()
    }
    return answer, override(run.simulation, layers, wish.over)


def _painted(old: Sequence[Picture], pixels: Tensor, values: Tensor) -> tuple[Picture, Picture]:
    value, cover = (each.copy() for each in old)
    value.ravel()[pixels.numpy()], cover.ravel()[pixels.numpy()] = values.numpy(), 255
    return value, cover


def _poses(run: Run) -> list[Tensor]:
    return [_matrix(each["T_world_module"]) for each in run.snapshots[-1].head["modules"]]


def _matrix(numbers: Sequence[float]) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64).view(4, 4)
