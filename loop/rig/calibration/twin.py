"""The twin of a rig: simulated frames of a recording's exposures, compared with the rig's frames, and fitted to them after the run.

A fit is by least squares of digital numbers, with the uncertainty of each value.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from torch import Tensor

from luxloop.loop.recording.manifest import TWIN, TWIN_PICTURE, table_of, write_table
from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.geometry import SIDE, blocks, covariance_of, group_residuals
from luxloop.loop.rig.calibration.pictures import draw_twin
from luxloop.loop.rig.matching import mark_surroundings
from luxloop.loop.rig.params import MarkParams
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.frames import (
    image_file,
    inside,
    light_file,
    read_image,
    read_light,
    recorded_rows,
    schema_of,
    twin_file,
    write_image,
)
from luxloop.loop.simulation.lamps import lamp_modules, mount
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.protocol import Exposure
from luxloop.loop.simulation.simulated import SimulatedPlant, simulated_plant
from luxloop.loop.simulation.truth import LampModule
from luxloop.loop.studies.ranges import value_of
from luxloop.perception.camera import CameraParams, expose, luminance_of
from luxloop.perception.metrics import ssim
from luxloop.world.errors import LuxloopError, locate

BLUR = "blur_px"  # standard deviation of the picture's blur, a value of the fit that no scenario has
MOST_PIXELS = 200_000  # of all frames in a fit
SSIM_RADIUS = 1.5
STEP = 0.05  # of finite differences, relative to a value's span
MOST_STEPS = 20
BLURRED = 0.3  # px, start value; at zero the blur has no slope


RecordedExposure = tuple[Exposure, Tensor]  # an exposure, and its digital numbers `[height, width]`


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a fit.

    values, stds: by key; standard deviations are for residuals that are correlated within blocks of the frames (`covariance_of`). before,
    after: MAE and RMSE in digital numbers, and SSIM. noise: rms of the camera's noise in the recorded frames, in digital numbers.
    """

    values: Mapping[str, float]
    stds: Mapping[str, float]
    before: Mapping[str, float]
    after: Mapping[str, float]
    noise: float


def read_exposures(folder: Path, scenario: Scenario, most: int) -> list[RecordedExposure]:
    """Up to `most` exposures of a recording with frames, evenly spread over the run. Raises LuxloopError if all frames are lost."""
    rows = [row for row in recorded_rows(folder)[:-1] if row["lost"] is False]
    if not rows:
        raise LuxloopError(f"{folder}: all frames are lost; record another run with --frames")
    modules = lamp_modules(mount(scenario.headlight))
    pixels, like = [each.headlight.n_pixels for each in modules], modules[0].headlight.matrix.values
    found = []
    for k in np.unique(np.linspace(0, len(rows) - 1, most).astype(int)).tolist():
        row = rows[k]
        lights, _, commands = read_light(inside(light_file(folder, row["light"]), folder), pixels, like.device)
        image = read_image(inside(image_file(folder, row["number"]), folder), scenario.camera, like)
        found.append((Exposure(row["number"], row["time_s"], 0.0, lights, commands=commands), image))
    return found


def fit(
    scenario_of: Callable[[Mapping[str, float]], Scenario],
    exposures: Sequence[RecordedExposure],
    spans: Mapping[str, float],
    on_step: Callable[[], None] = lambda: None,
) -> FitResult:
    """Least-squares fit of simulated to recorded frames.

    scenario_of: scenario by changed values of keys. spans: expected error of each fitted value, by key. Unrounded, noise-free digital
    numbers are compared; saturated pixels of the recording are left out. Raises LuxloopError if the scenario lacks a key, or a key has no
    effect.
    """
    scenario = scenario_of({})
    start = np.array([0.0 if key == BLUR else _value(scenario, key) for key in spans])
    span = np.array(list(spans.values()))
    levels = 2**scenario.camera.bits - 1
    some = max(1, sum(image.numel() for _, image in exposures) // MOST_PIXELS)
    wanted = np.stack([image.double().numpy() for _, image in exposures])  # [n, height, width]
    used = (wanted < levels) & (np.arange(wanted[0].size) % some == 0).reshape(wanted[0].shape)
    cache = PartCache()

    def values_at(x: Array) -> dict[str, float]:
        values = dict(zip(spans, (start + span * (x - 1)).tolist(), strict=True))
        return values | ({BLUR: abs(values[BLUR])} if BLUR in values else {})

    def pictures(x: Array) -> list[Array]:
        nonlocal cache
        cache, values = PartCache(cache), values_at(x)
        blur = values.pop(BLUR, 0.0)
        on_step()
        return _pictures(scenario_of(values), exposures, cache, blur)

    def residuals(x: Array) -> Array:
        return (np.stack(pictures(x)) - wanted)[used]

    at = np.ones(len(spans))  # so that steps, which are relative, are shares of the spans
    before = scores(pictures(at), wanted, levels)
    at += [BLURRED / each if key == BLUR else 0.0 for key, each in spans.items()]
    scale = max(1.48 * float(np.median(np.abs(residuals(at)))), 1.0)
    solved: Any = least_squares(
        residuals, at, loss="soft_l1", f_scale=scale, diff_step=STEP, x_scale=1.0, xtol=1e-4, ftol=1e-6, max_nfev=MOST_STEPS
    )
    after = scores(pictures(solved.x), wanted, levels)
    length = np.linalg.norm(solved.jac, axis=0)
    if dead := [key for key, size in zip(spans, length, strict=True) if not size > 0]:
        raise LuxloopError(f"{dead[0]}: has no effect on the recorded frames; leave it out, or record others")
    plain = residuals(solved.x)
    variance = float(plain @ plain) / max(len(plain) - len(spans), 1)
    robust = plain * (1 + (plain / scale) ** 2) ** 0.25  # which belongs to the Jacobian that `least_squares` gives with soft_l1
    block = blocks(np.argwhere(np.ones(wanted[0].shape)).astype(float)).reshape(wanted[0].shape)
    groups = (SIDE**2 * np.arange(len(wanted))[:, None, None] + block)[used]
    covariance = covariance_of(*group_residuals(solved.jac, robust, groups), variance)
    stds = dict(zip(spans, (span * np.sqrt(np.diag(covariance))).tolist(), strict=True))
    return FitResult(values_at(solved.x), stds, before, after, _noise([image for _, image in exposures], scenario.camera))


def _pictures(scenario: Scenario, exposures: Sequence[RecordedExposure], cache: PartCache, blur: float) -> list[Array]:
    """Unrounded, noise-free digital numbers of the exposures in a scenario. blur: standard deviation in px."""
    modules = cache("modules", lambda headlight: lamp_modules(mount(headlight)), scenario.headlight)
    world = simulated_plant(scenario, modules, cache).world
    seen = (world.luminance(each.start_s, each.lights, each.commands)[0].double().numpy() for each, _ in exposures)
    blurred = (gaussian_filter(each, blur) if blur else each.copy() for each in seen)
    return [expose(torch.from_numpy(each), world.camera, quantise=False).numpy() for each in blurred]


def _noise(images: Sequence[Tensor], camera: CameraParams) -> float:
    """Rms of the camera's noise in digital numbers, at the luminances of frames `[height, width]`."""
    drawn = torch.Generator().manual_seed(0)
    noise = [expose(luminance_of(each, camera), camera, torch.randn(each.shape, generator=drawn)) - each for each in images]
    return float(torch.stack([each.square().mean() for each in noise]).mean().sqrt())


def scores(pictures: Iterable[Array], wanted: Iterable[Array], levels: int) -> dict[str, float]:
    """MAE and RMSE in digital numbers and SSIM of pictures `[height, width]`, over all of them. levels: largest digital number."""
    left = [a - b for a, b in zip(pictures, wanted, strict=True)]
    alike = [float(ssim(torch.from_numpy(a), torch.from_numpy(b), SSIM_RADIUS, levels)) for a, b in zip(pictures, wanted, strict=True)]
    return {
        "mae": float(np.mean([np.abs(each).mean() for each in left])),
        "rmse": float(np.sqrt(np.mean([(each**2).mean() for each in left]))),
        "ssim": float(np.mean(alike)),
    }


def _value(scenario: Scenario, key: str) -> float:
    """Number at a key such as `disturbances.aim[0].pitch_deg`. Raises LuxloopError if the scenario has none there."""
    with locate(key):
        if (value := value_of(scenario, key)) is None:
            raise LuxloopError("the scenario has no number there; see `luxloop schema`, and give it first with --set")
    return float(value)


# name: (type, unit, description)
COLUMNS: dict[str, tuple[pa.DataType, str, str]] = {
    "number": (pa.int64(), "1", "number of the exposure, as in frames/exposures.parquet"),
    "time_s": (pa.float64(), "s", "when it began"),
    "mae": (pa.float64(), "DN", "mean absolute difference of the rig's and the simulated frame, in digital numbers"),
    "rmse": (pa.float64(), "DN", "root of the mean squared difference, in digital numbers"),
    "ssim": (pa.float64(), "1", "structural similarity of the two"),
    "mean_rig": (pa.float64(), "DN", "mean digital number of the rig's frame"),
    "mean_simulated": (pa.float64(), "DN", "mean digital number of the simulated frame"),
}
SCHEMA = schema_of(COLUMNS)
FIGURES = tuple(COLUMNS)[2:]


def twin_plant(scenario: Scenario, modules: Sequence[LampModule]) -> SimulatedPlant:
    """Simulated plant of a scenario without camera noise; a difference to the rig is then the rig's noise or a simulation error.

    modules: of the scenario's lamps. Raises LuxloopError if a file is missing or damaged.
    """
    camera = scenario.camera.model_copy(update={"noise": False})
    return simulated_plant(scenario.model_copy(update={"camera": camera}), modules)


def write_twin(
    folder: Path, plant: SimulatedPlant, mark: MarkParams | None = None, on_frame: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Write simulated frames beside a rig recording's frames, their figures, and a picture of the last on frame.

    Returns the number of exposures with a frame, and mean figures of on and off frames. plant: from `twin_plant`. mark: in the rig's light,
    left out of the figures. on_frame: called after each frame. Raises LuxloopError if a recorded file cannot be read, or a file cannot be
    written.
    """
    camera, modules, per_step = plant.world.camera, plant.world.modules, len(plant.shares)
    like, pixels = modules[0].headlight.matrix.values, [each.headlight.n_pixels for each in modules]
    exposures = [row for row in recorded_rows(folder)[:-1] if row["lost"] is False]

    @lru_cache(maxsize=2)  # lights of on and off frames, which exposures share
    def light_of(number: int) -> Any:
        return read_light(inside(light_file(folder, number), folder), pixels, like.device)

    rows, last = list[dict[str, Any]](), None
    for row in exposures:
        number = row["number"]
        lights, _, commands = light_of(row["light"])
        rig = read_image(inside(image_file(folder, number), folder), camera, like)
        simulated = plant.exposed(*plant.world.luminance(row["time_s"], lights, commands), *divmod(number, per_step))
        write_image(twin_file(folder, number), simulated, camera.bits)
        pair = [each.double().cpu().numpy() for each in (rig, simulated)]
        if mark is not None:
            for each in pair:
                each[mark_surroundings(mark)] = 0
        means = {"mean_rig": float(pair[0].mean()), "mean_simulated": float(pair[1].mean())}
        rows.append({"number": number, "time_s": row["time_s"], **scores(pair[1:], pair[:1], 2**camera.bits - 1), **means})
        if number % per_step == 0:
            last = rows[-1], pair
        on_frame()
    write_table(folder / TWIN, table_of(rows, SCHEMA))
    if last is not None:
        draw_twin(folder / TWIN_PICTURE, last[1][0], last[1][1], last[0])
    on, off = ([row for row in rows if (row["number"] % per_step == 0) == first] for first in (True, False))
    found = {
        name: {key: float(np.mean([row[key] for row in some])) for key in FIGURES} for name, some in (("on", on), ("off", off)) if some
    }
    return {"exposures": len(rows), **found}
