"""Light that clients paint on pixels, or want in the world (T 4.2.2), as a value of `lighting.painted`."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.base_beams import PaintedParams, Picture
from luxloop.controllers.pixels.jpo_plane import PlaneModule, Raster, fit_plane, lighting
from luxloop.loop.report.picture import WALL_M
from luxloop.loop.simulation.redrawn import mask_limits
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studio.messages import Paint, Place, Wish
from luxloop.loop.studio.runs import Run, matrix
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import inverse
from luxloop.world.messages import Arrays
from luxloop.world.validation import toml

MOST_CELLS = 20_000
MOST_LX = 100_000.0
# A wall ahead of the lamps: x up, y to the left, z towards the car.
T_BODY_WALL = torch.tensor([[0.0, 0, -1, WALL_M], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)

Layer = tuple[Picture, Picture]  # value and cover `[rows, columns]` of a module's pixels
Answer = tuple[dict[str, Any] | None, str | None]  # head of the message, and the override that paints


def paint(run: Run, message: Paint, arrays: Arrays) -> Answer:
    """Override for painted pixels, without an answer. Raises LuxloopError for an invalid module or pixels."""
    simulation, modules = run.simulation, run.simulation.modules
    if message.module >= len(modules):
        raise LuxloopError(f"paint: there is no module {message.module}; there are {len(modules)}, numbered from 0")
    light = modules[message.module].headlight
    first_row, end_row, first_col, end_col = message.box
    if not (first_row < end_row <= light.pixel_rows and first_col < end_col <= light.pixel_cols):
        size = f"{light.pixel_rows} x {light.pixel_cols}"
        raise LuxloopError(f"paint: the box {list(message.box)} is not within the {size} pixels of the module")
    shape = end_row - first_row, end_col - first_col
    if wrong := [name for name, array in arrays.items() if array.shape != shape]:
        raise LuxloopError(f"paint: {wrong[0]} is no array of {shape[0]} x {shape[1]} pixels, as the box has")
    value, cover = layer(simulation, message.module)
    box = slice(first_row, end_row), slice(first_col, end_col)
    value[box], cover[box] = np.where(arrays["painted"] > 0, arrays["value"], 0), arrays["painted"]
    return None, override(simulation, {message.module: (value, cover)}, message.over)


def place(run: Run, message: Place, arrays: Arrays) -> Answer:
    """Pixels that light a point of the world in the last step, and an override if they are painted."""
    point, modules, layers = torch.tensor(message.point_m, dtype=torch.float64), list[dict[str, Any]](), dict[int, Layer]()
    for k, (module, pose) in enumerate(zip(run.simulation.modules, _poses(run), strict=True)):
        pixels, cd = lighting(module.headlight, pose, point)
        if len(pixels):
            modules.append({"module": k, "pixels": pixels.tolist(), "cd": float(cd.sum())})
            if message.value is not None:
                layers[k] = _cover(layer(run.simulation, k), pixels, message.value)
    head = {"type": "place", "point_m": message.point_m, "modules": modules}
    return head, override(run.simulation, layers, message.over) if layers else None


def wish(run: Run, message: Wish, arrays: Arrays) -> Answer:
    """Light closest to the wanted illuminances, and its override. Raises LuxloopError for an invalid raster, or if no pixel lights it."""
    lx, where = arrays["lx"], arrays["painted"] > 0
    x_min, x_max, y_min, y_max = message.box_m
    if lx.ndim != 2 or lx.shape != where.shape or not 0 < lx.size <= MOST_CELLS:
        shapes = f"{list(lx.shape)} and {list(where.shape)}"
        raise LuxloopError(f"wish: lx and painted have the shapes {shapes}; give both as one raster of at most {MOST_CELLS} cells")
    if not (x_min < x_max and y_min < y_max):
        raise LuxloopError(f"wish: the box {list(message.box_m)} is empty; give least x, largest x, least y, largest y")
    if not where.any():
        raise LuxloopError("wish: nothing is painted; paint where light is wanted")
    if not ((lx[where] >= 0) & (lx[where] <= MOST_LX)).all():
        raise LuxloopError(f"wish: light wanted lies between 0 and {MOST_LX:g} lx")
    raster = Raster(x_min, x_max, y_min, y_max, *lx.shape)
    head, lights, poses = run.snapshots[-1].head, run.snapshots[-1].lights, _poses(run)
    T_plane_world = inverse(matrix(head["T_world_ground"]) if message.on == "road" else matrix(head["T_world_body"]) @ T_BODY_WALL)
    limits = mask_limits(*run.shown) if message.over else tuple(map(torch.ones_like, lights))
    posed = [T_plane_world @ each for each in poses]
    modules = [PlaneModule(each.headlight, *rest) for each, *rest in zip(run.simulation.modules, posed, lights, limits, strict=True)]
    there = torch.from_numpy(where).flatten()
    goal = torch.from_numpy(np.where(where, lx, 0).astype(np.float32)).flatten()
    found = fit_plane(modules, raster, goal, there)
    answer = {
        "type": "wish",
        "on": message.on,
        "wanted_lx": float(goal[there].mean()),
        "given_lx": float(found.lx[there].mean()),
        "rmse_lx": found.rmse_lx,
        "worst_lx": found.worst_lx,
        "pixels": int(sum(each.sum() for each in found.chosen)),
    }
    layers = {
        k: _cover(layer(run.simulation, k), chosen.nonzero()[:, 0], (255 * u[chosen]).round().byte().numpy())
        for k, (u, chosen) in enumerate(zip(found.u, found.chosen, strict=True))
        if chosen.any()
    }
    return answer, override(run.simulation, layers, message.over)


def layer(simulation: Simulation, module: int) -> Layer:
    """Copy of the layer painted on a module."""
    name, light = simulation.modules[module].name, simulation.modules[module].headlight
    nothing = (np.zeros((light.pixel_rows, light.pixel_cols), np.uint8),) * 2
    value, cover = next((each.pictures for each in simulation.scenario.lighting.painted if each.module == name), nothing)
    return value.copy(), cover.copy()


def override(simulation: Simulation, layers: Mapping[int, Layer], over: bool) -> str:
    """Override that sets layers by module, beside all others. Empty layers over the functions are left out."""
    names = [each.name for each in simulation.modules]
    params = {each.module: each for each in simulation.scenario.lighting.painted}
    for k, (value, cover) in layers.items():
        params.pop(names[k], None)
        if cover.any() or not over:
            params[names[k]] = PaintedParams.of(names[k], value, cover, over)
    # a literal string is parsed fast
    tables = (
        f"{{module = {toml(each.module)}, png = '{each.png}', over = {toml(each.over)}}}"
        for each in sorted(params.values(), key=lambda each: names.index(each.module))
    )
    return f"lighting.painted=[{', '.join(tables)}]"


def _cover(old: Layer, pixels: Tensor, values: np.ndarray | int) -> Layer:
    value, cover = old
    value.ravel()[pixels.numpy()], cover.ravel()[pixels.numpy()] = values, 255
    return value, cover


def _poses(run: Run) -> list[Tensor]:
    return [matrix(each["T_world_module"]) for each in run.snapshots[-1].head["modules"]]


ACTS: Mapping[str, Callable[[Run, Any, Arrays], Answer]] = {"paint": paint, "place": place, "wish": wish}  # by type of the message
