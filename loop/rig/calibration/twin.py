"""The twin of a rig: simulated frames of the exposures that a rig has shown, compared with the rig's frames.

It is computed from the recording after the run, so that it does not slow down the loop.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import torch

from luxloop.loop.recording.manifest import TWIN, TWIN_PICTURE, table_of, write_table
from luxloop.loop.rig.calibration.fit import scores
from luxloop.loop.rig.calibration.twin_picture import draw_twin
from luxloop.loop.rig.mark import surroundings
from luxloop.loop.rig.params import MarkParams
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.frames import image_file, light_file, read_image, read_light, twin_file, write_image
from luxloop.loop.simulation.recorded import inside, recorded_rows
from luxloop.loop.simulation.simulated import SimulatedPlant, simulated_plant
from luxloop.loop.simulation.truth import LampModule

# name: (type, unit, description)
COLUMNS: Final[dict[str, tuple[pa.DataType, str, str]]] = {
    "number": (pa.int64(), "1", "number of the exposure, as in frames/exposures.parquet"),
    "time_s": (pa.float64(), "s", "when it began"),
    "mae": (pa.float64(), "DN", "mean absolute difference of the rig's and the simulated frame, in digital numbers"),
    "rmse": (pa.float64(), "DN", "root of the mean squared difference, in digital numbers"),
    "ssim": (pa.float64(), "1", "structural similarity of the two"),
    "mean_rig": (pa.float64(), "DN", "mean digital number of the rig's frame"),
    "mean_simulated": (pa.float64(), "DN", "mean digital number of the simulated frame"),
}
SCHEMA: Final = pa.schema(
    pa.field(name, kind, metadata={"unit": unit, "description": text}) for name, (kind, unit, text) in COLUMNS.items()
)
FIGURES: Final = ("mae", "rmse", "ssim", "mean_rig", "mean_simulated")


def twin_plant(scenario: Scenario, modules: Sequence[LampModule]) -> SimulatedPlant:
    """The simulated plant of a scenario, without camera noise, so that differences are the rig's noise and errors of the simulation.

    modules: of the scenario's lamps. Raises LuxloopError if a file is missing or damaged.
    """
    camera = scenario.camera.model_copy(update={"noise": False})
    return simulated_plant(scenario.model_copy(update={"camera": camera}), modules)


def write_twin(
    folder: Path, plant: SimulatedPlant, mark: MarkParams | None = None, on_frame: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Write the simulated frames of a rig's recording with frames beside them, their figures, and a picture of the last on frame.

    Returns the number of `exposures` that have a frame, and the means of the figures of their `on` and `off` frames. plant: of
    `twin_plant`. mark: in the rig's light, which is left out. on_frame: called after each.
    Raises LuxloopError if a file of the recording cannot be read, or a file cannot be written.
    """
    camera, modules, per_step = plant.world.camera, plant.world.modules, len(plant.shares)
    like, pixels = modules[0].headlight.matrix.values, [each.headlight.n_pixels for each in modules]
    exposures = [row for row in recorded_rows(folder)[:-1] if row["lost"] is False]

    @lru_cache(maxsize=2)  # with the symbol and without it, which exposures share
    def light_of(number: int) -> Any:
        return read_light(inside(light_file(folder, number), folder), pixels, like.device)

    rows, last = list[dict[str, Any]](), None
    for row in exposures:
        number = row["number"]
        lights, _, commands = light_of(row["light"])
        rig = read_image(inside(image_file(folder, number), folder), camera, like)
        simulated = plant.exposed(*plant.world.luminance(row["time_s"], lights, commands), *divmod(number, per_step))
        write_image(twin_file(folder, number), simulated, camera.bits)
        pair = _without(mark, rig), _without(mark, simulated)
        rows.append({"number": number, "time_s": row["time_s"], **_figures(*pair, 2**camera.bits - 1)})
        if number % per_step == 0:
            last = rows[-1], pair
        on_frame()
    write_table(folder / TWIN, table_of(rows, SCHEMA))
    if last is not None:
        draw_twin(folder / TWIN_PICTURE, *last[1], last[0])
    on, off = ([row for row in rows if (row["number"] % per_step == 0) == first] for first in (True, False))
    means = {
        name: {key: float(np.mean([row[key] for row in some])) for key in FIGURES} for name, some in (("on", on), ("off", off)) if some
    }
    return {"exposures": len(rows), **means}


def _without(mark: MarkParams | None, image: torch.Tensor) -> np.ndarray:
    shown = image.double().cpu().numpy()
    if mark is not None:
        shown[surroundings(mark)] = 0
    return shown


def _figures(rig: np.ndarray, simulated: np.ndarray, levels: int) -> dict[str, float]:
    return {**scores([simulated], [rig], levels), "mean_rig": float(rig.mean()), "mean_simulated": float(simulated.mean())}
