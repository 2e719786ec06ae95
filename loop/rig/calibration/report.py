"""Report of a digitised lamp: a picture, a table of all pixels, and facts in JSON."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from luxloop.loop.report.style import DEFAULTS
from luxloop.loop.rig.calibration.digitise import Digitised
from luxloop.world.arrays import write_npz
from luxloop.world.files import whole

SHOWN: Final = 2.5  # standard deviations from the median, which colours span
LISTED: Final = 200  # faulty pixels in the facts


def facts(module: Digitised) -> dict[str, Any]:
    """Facts of one module. Lengths in m, angles as rotation vectors in deg, values of pixels as shares or in pixels."""
    measured, geometry = module.measured, module.geometry
    good = ~(module.dead | module.stuck)
    intensity = measured.intensity[good]
    return {
        "pixels": int(good.size),
        "dead": np.argwhere(module.dead)[:LISTED].tolist(),
        "stuck": np.argwhere(module.stuck)[:LISTED].tolist(),
        "dead_count": int(module.dead.sum()),
        "stuck_count": int(module.stuck.sum()),
        "intensity_noise": float(np.median(measured.noise[good] / intensity)),
        "residual_rms": float(np.sqrt(np.mean(measured.residual[good] ** 2))),
        "shift_rms_pixels": float(np.sqrt(np.mean(measured.shift_row[good] ** 2 + measured.shift_col[good] ** 2))),
        "place_rms_px": geometry.rms["lamp"][0],
        "photometric_centre_m": geometry.lamp.place.tolist(),
        "photometric_centre_std_m": geometry.std["lamp"][3:].tolist(),
        "turn_deg": np.degrees(geometry.lamp.turn).tolist(),
        "turn_std_deg": np.degrees(geometry.std["lamp"][:3]).tolist(),
        "checked": dict(module.checked),
    }


@rc_context(DEFAULTS)
def write(stem: Path, modules: Sequence[Digitised]) -> list[Path]:
    """Write `STEM.json`, `STEM.png` and `STEM_pixels.npz` beside a lamp file; returns the paths."""
    text, picture, pixels = stem.with_suffix(".json"), stem.with_suffix(".png"), stem.with_name(f"{stem.name}_pixels.npz")
    with whole(text) as part:
        part.write_text(json.dumps({each.name: facts(each) for each in modules}, indent=1) + "\n", "utf-8")
    with whole(pixels) as part:
        write_npz(part, [(f"{k}_{name}", array) for k, each in enumerate(modules) for name, array in _arrays(each).items()])
    with whole(picture) as part:
        _drawn(modules).savefig(part, format="png", dpi=110)
    return [text, picture, pixels]


def _arrays(module: Digitised) -> dict[str, np.ndarray]:
    measured = module.measured
    names = ("intensity", "noise", "residual", "shift_row", "shift_col", "background")
    found = {name: getattr(measured, name).astype(np.float32) for name in names}
    return {**found, "u_px": module.u.astype(np.float32), "v_px": module.v.astype(np.float32), "dead": module.dead, "stuck": module.stuck}


def _drawn(modules: Sequence[Digitised]) -> Figure:
    figure = Figure(figsize=(13, 3.4 * len(modules)), layout="constrained")
    rows = figure.subplots(len(modules), 3, squeeze=False)
    for axes, module in zip(rows, modules, strict=True):
        measured = module.measured
        panels = (
            ("intensity, cd", measured.intensity, "viridis"),
            ("residual, share of the pixel's peak", measured.residual, "magma"),
            ("shift from smooth places, pixels", np.hypot(measured.shift_row, measured.shift_col), "magma"),
        )
        for axis, (title, values, colours) in zip(axes, panels, strict=True):
            middle, spread = float(np.median(values)), float(values.std()) or 1.0
            low, high = max(float(values.min()), middle - SHOWN * spread), min(float(values.max()), middle + SHOWN * spread)
            shown = axis.imshow(values, cmap=colours, vmin=low, vmax=high, aspect="auto", interpolation="nearest")
            figure.colorbar(shown, ax=axis)
            axis.set_title(f"{module.name}: {title}", fontsize=9)
            axis.set_xlabel("column")
        for what, marker in ((module.dead, "x"), (module.stuck, "o")):
            r, c = np.nonzero(what)
            axes[0].scatter(c[:LISTED], r[:LISTED], marker=marker, s=12, c="red", linewidths=0.7)
        axes[0].set_ylabel("row; x dead, o stuck")
    return figure
