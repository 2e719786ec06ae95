"""`luxloop evaluate`: MapReduce control against the joint optimum of all pixels, and the effect of its parameters (T 8.4, 8.5)."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.pixels.jpo_solvers import least_error, pixel_goal
from luxloop.controllers.pixels.mrpc_tuning import OPTIONS, THESIS, Part, TextureControl, Trial, part, tune
from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.studies.jobs import ALL_CORES, Executor, Job, Results, digest_of, run
from luxloop.perception.metrics import dssim, mae, mare, rmse
from luxloop.world.files import output_folder
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.patterns import QUICK, RECTANGLES, Rectangle
from luxloop.world.lamps.presets import lamp

LAMPS = ("hd84", "ssl-hd-lores")
JOBS, SETPOINTS, TABLES, SENSITIVITY = "jobs.jsonl", "setpoints.parquet", "tables.parquet", "sensitivity.parquet"
CONTROLS = ("mrpc", "options", "corrected", "ours", "median", "default")  # sets of parameters compared with the joint optimum
Row = dict[str, Any]

# Rows of T tables 8.2 and 8.3: name, a_m (None: no mapping), shape, what is tuned.
ROWS: dict[str, tuple[float | None, str, list[str]]] = {
    "reference": (None, "rectangle", []),
    "exclusion": (None, "rectangle", ["a_x"]),
    "exclusion, mapping": (1.0, "rectangle", ["a_m", "a_x"]),
    "exclusion, mapping, free shape": (1.0, "arbitrary", ["a_m", "a_x"]),
    "exclusion, mapping, free shape, reduction": (1.0, "arbitrary", ["a_m", "a_x", "a_r"]),
}
FIXED_A_M = {"hd84": 1.0, "ssl-hd-lores": 1.015}  # of T figures 8.15 and 8.19


@dataclass(frozen=True)
class Evaluation:
    """Result of an evaluation: rows of its three parts, and reasons of failed jobs by key."""

    setpoints: list[Row]
    tables: list[Row]
    sensitivity: list[Row]
    failures: dict[str, str]

    @property
    def lamps(self) -> list[str]:
        return [name for name in LAMPS if any(row["name"] == name for row in self.setpoints)]

    def of(self, name: str) -> "Evaluation":
        """Result for one lamp."""
        parts = (self.setpoints, self.tables, self.sensitivity)
        setpoints, tables, sensitivity = ([row for row in rows if row["name"] == name] for rows in parts)
        return Evaluation(setpoints, tables, sensitivity, self.failures)


def evaluate(
    out: Path,
    lamps: Sequence[str] = LAMPS,
    *,
    quick: bool = False,
    executor: Executor = ALL_CORES,
    setpoints: Sequence[Rectangle] | None = None,
    grid: int | None = None,
) -> Evaluation:
    """Compute the results that `out` does not hold yet, and write three Parquet files into it.

    quick: 45 instead of 1,215 rectangles, evenly spread over all five degrees of freedom, and coarser sensitivities. executor: by default a
    process per core. setpoints, grid: other rectangles, and another number of steps per parameter. Raises as
    `luxloop.loop.studies.jobs.run` and `luxloop.world.files.output_folder`.
    """
    chosen = setpoints or (QUICK if quick else RECTANGLES)
    parts: dict[str, tuple[Callable[..., Row], list[Job]]] = {
        SETPOINTS: (setpoint, [job for name in lamps for job in _setpoints(name, chosen)]),
        TABLES: (table_row, [job for name in lamps for job in _tables(name)]),
        SENSITIVITY: (sensitivity_row, [job for name in lamps for job in _sensitivities(name, grid or (8 if quick else 40))]),
    }
    version = digest_of_code() + digest_of(sys.modules[__name__])
    results = dict[str, Results]()
    with output_folder(out):
        for file, (function, wanted) in parts.items():
            results[file] = run(function, wanted, out / JOBS, version=version, executor=executor, title=file.removesuffix(".parquet"))
            if results[file].rows:
                results[file].write(out / file)
            else:
                (out / file).unlink(missing_ok=True)  # from another evaluation
    failures = {key: text for each in results.values() for key, text in each.failures.items()}
    return Evaluation(results[SETPOINTS].rows, results[TABLES].rows, results[SENSITIVITY].rows, failures)


def summary(rows: Sequence[Row]) -> dict[str, float]:
    """Means and medians over the setpoints of one lamp: MAE, ratios to the joint optimum, and tuned parameters."""
    values = {name: np.array([row[f"{name}_mae"] for row in rows]) for name in ("jpo", *CONTROLS)}
    values |= {f"{name}_ratio": values[name] / values["jpo"] for name in CONTROLS}
    values |= {
        name: np.array([row[name] for row in rows])
        for name in [*THESIS, *(f"{kind}_{each}" for kind in ("options", "corrected") for each in OPTIONS)]
    }
    means = {f"{name}_mean": float(each.mean()) for name, each in values.items()}
    medians = {f"{name}_median": float(np.median(each)) for name, each in values.items()}
    return {"setpoints": len(rows), "gap": max(row["jpo_gap"] for row in rows), **means, **medians}


def _setpoints(name: str, rectangles: Sequence[Rectangle]) -> list[Job]:
    return [
        Job(f"{name}, {r.width:g} x {r.height:g} deg at {r.h:g}, {r.v:g}, turned {r.turn:g}", {"name": name, **asdict(r)})
        for r in rectangles
    ]


def _tables(name: str) -> list[Job]:
    return [
        Job(f"{name}, {key}", {"name": name, "a_m": a_m, "a_r": 1.0, "shape": shape, "tuned": tuned})
        for key, (a_m, shape, tuned) in ROWS.items()
    ]


def _sensitivities(name: str, steps: int) -> list[Job]:
    """Jobs of constant a_m and a_r: a_m varies for a_r of 0, 1 and 2, then a_r varies for a fixed a_m; each for both shapes."""
    thresholds, potentials, exponents = (np.linspace(0, top, steps + 1).round(6).tolist() for top in (1, 2, 3))
    pairs = [(a_m, a_r) for a_r in (0.0, 1.0, 2.0) for a_m in [None, *potentials]]
    pairs += [(FIXED_A_M.get(name, 1.0), a_r) for a_r in exponents]
    return [
        Job(f"{name}, a_m {a_m}, a_r {a_r:g}, {shape}", {"name": name, "a_m": a_m, "a_r": a_r, "shape": shape, "thresholds": thresholds})
        for a_m, a_r in dict.fromkeys(pairs)
        for shape in ("rectangle", "arbitrary")
    ]


# One set of parameters for all setpoints: medians of the thesis' optima (T B.4).
THESIS_MEDIAN = {"hd84": Trial(0.99, 0.87, 0.001), "ssl-hd-lores": Trial(1.025, 0.98, 0.001)}
OURS = {  # the best of a few hundred trials on ten of the rectangles
    "hd84": Trial(a_x=0.7, a_ac=0.4, corrections=1),
    "ssl-hd-lores": Trial(a_x=0.95, a_ac=0.6, sharpening=2.0, corrections=3),
}
WIDE = Rectangle(-6.05, -0.25, 8.9, 7.7)  # of T 8.5; its side does not matter for symmetric lamps
REFERENCE = Trial(None, 0.5, 1.0, "rectangle")  # T 8.5: pixels taken as their bounding rectangles at half of their peak, no mapping
CORRECTIONS = 3  # a product with the matrix and one with its transpose each
GAP = 1e-3  # largest relative gap of the joint optimum to its lower bound


def headlight(name: str) -> Headlight:
    return lamp(name).finest.headlight


def setpoint(name: str, h: float, v: float, width: float, height: float, turn: float) -> dict[str, Any]:
    """MAE of a rectangle with joint optimisation of all pixels, and with MRPC: parameters tuned for it as in the thesis, with the options
    of T 7.5.2, with corrections on top, and with one set for all rectangles: ours, the default, the thesis' median.
    """
    control = _control(name, Rectangle(h, v, width, height, turn))
    joint, gap = joint_optimum(control.part)

    def cost(trial: Trial) -> float:
        return _mae(control.part, control.utilisation(trial))

    best = tune(cost)
    finest = tune(cost, best, OPTIONS)
    corrected = tune(cost, replace(finest, corrections=CORRECTIONS), OPTIONS)
    u = control.utilisation(best)
    lit = ((u > 0) | (joint > 0)).nonzero().flatten()
    return {
        "jpo_mae": _mae(control.part, joint),
        "jpo_gap": gap,
        "mrpc_mae": _mae(control.part, u),
        "options_mae": cost(finest),
        "corrected_mae": cost(corrected),
        "ours_mae": cost(OURS.get(name, Trial())),
        "default_mae": cost(Trial()),
        "median_mae": cost(THESIS_MEDIAN.get(name, Trial())),
        **{parameter: getattr(best, parameter) for parameter in THESIS},
        **{f"options_{parameter}": getattr(finest, parameter) for parameter in OPTIONS},
        **{f"corrected_{parameter}": getattr(corrected, parameter) for parameter in OPTIONS},
        "pixels": control.part.pixels[lit].tolist(),
        "mrpc_u": [round(value, 5) for value in u[lit].tolist()],
        "jpo_u": [round(value, 5) for value in joint[lit].tolist()],
    }


def table_row(name: str, a_m: float | None, a_r: float, shape: Any, tuned: list[str]) -> dict[str, Any]:
    """Errors of the wide rectangle with MRPC tuned for its MAE; nothing is tuned for an empty list (T tables 8.2, 8.3)."""
    control = _control(name, WIDE)
    best = Trial(a_m, REFERENCE.a_x, a_r, shape)
    if tuned:
        best = tune(lambda trial: _mae(control.part, control.utilisation(trial)), best, tuple(tuned))
    return {"best_a_m": best.a_m, "best_a_x": best.a_x, "best_a_r": best.a_r, **_errors(name, control, best)}


def sensitivity_row(name: str, a_m: float | None, a_r: float, shape: Any, thresholds: list[float]) -> dict[str, Any]:
    """Errors of the wide rectangle over a_x, as lists (T figures 8.12 to 8.19)."""
    control = _control(name, WIDE)
    errors = [_errors(name, control, Trial(a_m, a_x, a_r, shape)) for a_x in thresholds]
    return {error: [each[error] for each in errors] for error in ("mae", "rmse", "dssim")}


def joint_optimum(part: Part) -> tuple[Tensor, float]:
    """Utilisations `[n]` of the least MAE (T 3.5.2, 8.4), and their relative gap to its lower bound."""
    light = part.headlight
    found = least_error(light.matrix, pixel_goal(light, part.wanted), gap=GAP)
    return found.u, float((found.error - found.bound) / found.error)


def light_of(name: str, pixels: list[int], u: list[float]) -> NDArray[np.float32]:
    """Light texture `[rows, cols]` in cd of some pixels."""
    light = headlight(name)
    utilisation = torch.zeros(light.n_pixels)
    utilisation[torch.tensor(pixels, dtype=torch.int64)] = torch.tensor(u, dtype=torch.float32)
    texture: NDArray[np.float32] = light.light_texture(utilisation).numpy()
    return texture


def _control(name: str, rectangle: Rectangle) -> TextureControl:
    light = headlight(name)
    return TextureControl(part(light, rectangle.texture(light)))


def _mae(part: Part, u: Tensor) -> float:
    return float(mae(part.headlight.light_texture(u), part.wanted))


def _errors(name: str, control: TextureControl, trial: Trial) -> dict[str, float]:
    """The four errors over the whole texture. SSIM's range is the lamp's peak, its radius twice the setpoint's mean extent (T 8.3)."""
    whole = headlight(name)
    light, target = (torch.zeros(whole.rows, whole.cols) for _ in range(2))
    light[control.part.window] = control.part.headlight.light_texture(control.utilisation(trial))
    target[control.part.window] = control.part.wanted
    rows, cols = ((target > 0).any(axis).sum() for axis in (1, 0))
    return {
        "mae": float(mae(light, target)),
        "rmse": float(rmse(light, target)),
        "dssim": float(dssim(light, target, float(rows + cols), whole.peak_cd)),
        "mare": float(mare(light, target)),
    }
