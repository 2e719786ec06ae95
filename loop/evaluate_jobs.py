"""What an evaluation computes: jobs for `loop.jobs`, each a function of plain values, and the version that its results have."""

from functools import lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy.typing import NDArray
from torch import Tensor

from controllers import tuning
from controllers.tuning import RANGES, Part, TextureControl, Trial, part, tune
from loop import rectangles
from loop.jobs import digest_of
from loop.rectangles import Rectangle
from perception import metrics
from perception.metrics import dssim, mae, mare, rmse
from world import parametric
from world.headlight import Headlight
from world.presets import hd84, lamp, ssl_hd

# One set for all setpoints, beside the default: medians of the thesis' optima (T B.4).
THESIS_MEDIAN = {"hd84": Trial(0.99, 0.87, 0.001), "ssl-hd-lores": Trial(1.025, 0.98, 0.001)}
WIDE = Rectangle(-6.05, -0.25, 8.9, 7.7)  # the one of T 8.5; on which side of the axis plays no role for lamps that are alike on both
REFERENCE = Trial(None, 0.5, 1.0, "rectangle")  # T 8.5: pixels taken as their bounding rectangles at half of their peak, no mapping
GAP = 1e-3  # by how much the joint optimum may be lower than what is called so


@lru_cache(maxsize=2)
def headlight(name: str) -> Headlight:
    return lamp(name).finest.headlight


def version() -> str:
    """Changes with everything that decides a result."""
    import loop.evaluate_jobs as here

    return digest_of(here, tuning, rectangles, metrics, parametric, hd84, ssl_hd)


def setpoint(name: str, h: float, v: float, width: float, height: float, turn: float) -> dict[str, Any]:
    """MAE of a rectangle by joint optimisation of all pixels, and by MRPC: tuned for it, by default, and with the thesis' median."""
    control = _control(name, Rectangle(h, v, width, height, turn))
    joint, gap = joint_optimum(control.part)
    best = tune(lambda trial: _mae(control.part, control.utilisation(trial)))
    u = control.utilisation(best)
    lit = ((u > 0) | (joint > 0)).nonzero().flatten()
    return {
        "jpo_mae": _mae(control.part, joint),
        "jpo_gap": gap,
        "mrpc_mae": _mae(control.part, u),
        "default_mae": _mae(control.part, control.utilisation(Trial())),
        "median_mae": _mae(control.part, control.utilisation(THESIS_MEDIAN.get(name, Trial()))),
        **{parameter: getattr(best, parameter) for parameter in RANGES},
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


def joint_optimum(part: Part, gap: float = GAP, most: int = 20_000) -> tuple[Tensor, float]:
    """Utilisations `[n]` of the least MAE (T 3.5.2, 8.4), float32, and by what share that might still be lower.

    min |A u - s|_1 over 0 <= u <= 1 by primal-dual steps, with step widths from the sums of rows and columns; the dual value proves it.
    """
    s = part.wanted.flatten().double().numpy()
    peak = s.max()
    A = part.headlight.matrix.to_scipy().astype(np.float64) / peak
    texels = (np.diff(A.indptr) > 0) | (s > 0)
    A, s = A[texels], s[texels] / peak
    At: sp.csr_matrix = A.T.tocsr()
    down, up = (1 / np.maximum(np.asarray(m.sum(axis=1)).ravel(), 1e-12) for m in (At, A))
    u, dual = np.zeros(A.shape[1]), np.zeros(A.shape[0])
    best, least, bound = u, float(s.sum()), 0.0  # all pixels off
    for step in range(1, most + 1):
        before = u
        u = np.clip(u - down * (At @ dual), 0, 1)
        dual = np.clip(dual + up * (A @ (2 * u - before) - s), -1, 1)
        if step % 50 == 0:
            best, least = min((best, least), (u, float(np.abs(A @ u - s).sum())), key=lambda each: each[1])
            bound = max(bound, float(-s @ dual + np.minimum(At @ dual, 0).sum()))
            if least - bound <= gap * least:
                break
    return torch.from_numpy(best.astype(np.float32)), (least - bound) / least


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
    light, wanted = (torch.zeros(whole.rows, whole.cols) for _ in range(2))
    light[control.part.window] = control.part.headlight.light_texture(control.utilisation(trial))
    wanted[control.part.window] = control.part.wanted
    rows, cols = ((wanted > 0).any(axis).sum() for axis in (1, 0))
    structure = dssim(light, wanted, float(rows + cols), _peak_cd(name))
    return {
        "mae": float(mae(light, wanted)),
        "rmse": float(rmse(light, wanted)),
        "dssim": float(structure),
        "mare": float(mare(light, wanted)),
    }


@lru_cache(maxsize=2)
def _peak_cd(name: str) -> float:
    return headlight(name).peak_cd
