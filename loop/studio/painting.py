"""What is painted on pixels, as another value of `lighting.painted`."""

from collections.abc import Mapping, Sequence

import numpy as np

from luxloop.controllers.functions.base_beams import PaintedParams, Picture
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studio.messages import Paint
from luxloop.world.errors import LuxloopError
from luxloop.world.messages import Arrays
from luxloop.world.validation import toml


def painted(simulation: Simulation, paint: Paint, arrays: Arrays) -> str:
    """The override of a message to paint. Raises LuxloopError where there is no such module, or no such pixels."""
    modules = simulation.modules
    if paint.module >= len(modules):
        raise LuxloopError(f"paint: there is no module {paint.module}; there are {len(modules)}, numbered from 0")
    light = modules[paint.module].headlight
    first_row, end_row, first_col, end_col = paint.box
    if not (first_row < end_row <= light.pixel_rows and first_col < end_col <= light.pixel_cols):
        size = f"{light.pixel_rows} x {light.pixel_cols}"
        raise LuxloopError(f"paint: the box {list(paint.box)} is not within the {size} pixels of the module")
    shape = end_row - first_row, end_col - first_col
    if wrong := [name for name, array in arrays.items() if array.shape != shape]:
        raise LuxloopError(f"paint: {wrong[0]} is no array of {shape[0]} x {shape[1]} pixels, as the box has")
    value, cover = (each.copy() for each in layer(simulation, paint.module))
    box = slice(first_row, end_row), slice(first_col, end_col)
    value[box], cover[box] = np.where(arrays["painted"] > 0, arrays["value"], 0), arrays["painted"]
    return override(simulation, {paint.module: (value, cover)}, paint.over)


def layer(simulation: Simulation, module: int) -> tuple[Picture, Picture]:
    """Value and cover `[rows, columns]` of what is painted on a module."""
    name, light = simulation.modules[module].name, simulation.modules[module].headlight
    nothing = np.zeros((light.pixel_rows, light.pixel_cols), np.uint8)
    return next((each.pictures for each in simulation.scenario.lighting.painted if each.module == name), (nothing, nothing))


def override(simulation: Simulation, layers: Mapping[int, tuple[Picture, Picture]], over: bool) -> str:
    """What sets these layers, by module, beside all others. Layers over the functions that paint nothing are left out."""
    changed = {simulation.modules[k].name: each for k, each in layers.items()}
    kept = [each for each in simulation.scenario.lighting.painted if each.module not in changed]
    made = [PaintedParams.of(name, *each, over) for name, each in changed.items() if each[1].any() or not over]
    return f"lighting.painted=[{', '.join(map(_table, _ordered(simulation, [*kept, *made])))}]"


def _ordered(simulation: Simulation, params: Sequence[PaintedParams]) -> list[PaintedParams]:
    names = [each.name for each in simulation.modules]
    return sorted(params, key=lambda each: names.index(each.module))


def _table(params: PaintedParams) -> str:
    """The picture is a literal string, which is read fast."""
    return f"{{module = {toml(params.module)}, png = '{params.png}', over = {toml(params.over)}}}"
