"""The jobs of an evaluation for `luxloop.loop.studies.jobs.runner`, each a function of plain values."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.controllers.pixels.jpo_part import pixel_goal
from luxloop.controllers.pixels.jpo_solvers import least_error
from luxloop.controllers.pixels.mrpc_tuning import OPTIONS, THESIS, Part, TextureControl, Trial, part, tune
from luxloop.perception.metrics import dssim, mae, mare, rmse
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.patterns import Rectangle
from luxloop.world.lamps.presets import lamp

# One set for all setpoints, beside the default: medians of the thesis' optima (T B.4).
THESIS_MEDIAN = {"hd84": Trial(0.99, 0.87, 0.001), "ssl-hd-lores": Trial(1.025, 0.98, 0.001)}
OURS = {  # the best of a few hundred trials on ten of the rectangles
    "hd84": Trial(a_x=0.7, a_ac=0.4, corrections=1),
    "ssl-hd-lores": Trial(a_x=0.95, a_ac=0.6, sharpening=2.0, corrections=3),
}
WIDE = Rectangle(-6.05, -0.25, 8.9, 7.7)  # the one of T 8.5; on which side of the axis plays no role for lamps that are alike on both
REFERENCE = Trial(None, 0.5, 1.0, "rectangle")  # T 8.5: pixels taken as their bounding rectangles at half of their peak, no mapping
CORRECTIONS = 3  # a product with the matrix and one with its transpose each
GAP = 1e-3  # largest share by which the true joint optimum may be lower


def headlight(name: str) -> Headlight:
    return lamp(name).finest.headlight


def setpoint(name: str, h: float, v: float, width: float, height: float, turn: float) -> dict[str, Any]:
    """MAE of a rectangle by joint optimisation of all pixels, and by MRPC: tuned for it as in the thesis, tuned with the options of T 7.5.2
    as well, with corrections on top, and with one set for all: ours, the default, the thesis' median."""
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
    """Errors of the wide rectangle, MRPC being tuned for its MAE; nothing is tuned for an empty list (T tables 8.2, 8.3)."""
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
    """Utilisations `[n]` of the least MAE (T 3.5.2, 8.4), and the share by which the true minimum may be lower."""
    light = part.headlight
    found = least_error(light.matrix, pixel_goal(light, part.wanted), gap=GAP)
    return found.u, float((found.error - found.bound) / found.error)


def light_of(name: str, pixels: list[int], u: list[float]) -> NDArray[np.float32]:
    """Light texture `[rows, cols]` in cd of the pixels that are lit."""
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
    """All four errors over the whole texture. SSIM's range is the lamp's peak, its radius twice the setpoint's mean extent (T 8.3)."""
    whole = headlight(name)
    light, target = (torch.zeros(whole.rows, whole.cols) for _ in range(2))
    light[control.part.window] = control.part.headlight.light_texture(control.utilisation(trial))
    target[control.part.window] = control.part.wanted
    rows, cols = ((target > 0).any(axis).sum() for axis in (1, 0))
    structure = dssim(light, target, float(rows + cols), whole.peak_cd)
    return {
        "mae": float(mae(light, target)),
        "rmse": float(rmse(light, target)),
        "dssim": float(structure),
        "mare": float(mare(light, target)),
    }
