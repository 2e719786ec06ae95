"""Pictures and figures of a digitised lamp, and comparisons of a rig's frames and beams with simulated ones."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from torch import Tensor

from luxloop.loop.recording.manifest import write_json
from luxloop.loop.report.style import DEFAULTS, SHARES, drawing, page_title
from luxloop.loop.rig.arrays import Array, Image
from luxloop.loop.rig.calibration.digitise import ModuleMeasurement
from luxloop.loop.rig.calibration.shots import luminous
from luxloop.world.arrays import write_npz
from luxloop.world.headlight import Headlight

SHOWN = 2.5  # range of the colours: standard deviations from the median
LISTED = 200  # faulty pixels in the facts
TWIN_IN, BEAM_IN, DPI = 13.0, 8.0, 130
BAR = 0.04  # height of the colour scale as a share of a frame's
BRIGHT = 0.998  # quantile of both images drawn white, and of their difference drawn in full colour


def facts(module: ModuleMeasurement) -> dict[str, Any]:
    """Figures of one module: lengths in m, rotation vectors in deg, pixel values as shares or in pixels."""
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
        "place_rms_px": geometry.rms["lamp"],
        "photometric_centre_m": geometry.lamp.place.tolist(),
        "photometric_centre_std_m": geometry.std["lamp"][3:].tolist(),
        "turn_deg": np.degrees(geometry.lamp.turn).tolist(),
        "turn_std_deg": np.degrees(geometry.std["lamp"][:3]).tolist(),
        "checked": dict(module.checked),
    }


def write(stem: Path, modules: Sequence[ModuleMeasurement]) -> list[Path]:
    """Write `STEM.json`, `STEM.png` and `STEM_pixels.npz` beside a lamp file; returns the paths."""
    text, picture, pixels = stem.with_suffix(".json"), stem.with_suffix(".png"), stem.with_name(f"{stem.name}_pixels.npz")
    write_json(text, {each.name: facts(each) for each in modules})
    write_npz(pixels, [(f"{k}_{name}", array) for k, each in enumerate(modules) for name, array in _arrays(each).items()])
    _draw_overview(picture, modules)
    return [text, picture, pixels]


def _arrays(module: ModuleMeasurement) -> dict[str, Image]:
    names = ("intensity", "noise", "residual", "shift_row", "shift_col", "background")
    found = {name: getattr(module.measured, name) for name in names} | {"u_px": module.u, "v_px": module.v}
    return {name: each.astype(np.float32) for name, each in found.items()} | {"dead": module.dead, "stuck": module.stuck}


def _draw_overview(file: Path, modules: Sequence[ModuleMeasurement]) -> None:
    with drawing(file, (13, 3.4 * len(modules)), DEFAULTS) as figure:
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


def draw_twin(file: Path, rig: Array, simulated: Array, figures: Mapping[str, Any]) -> None:
    """Draw twin.png: a rig's frame, the simulated frame, and their difference.

    rig, simulated: digital numbers `[height, width]`. figures: row of twin.parquet. Raises LuxloopError if the file cannot be written.
    """
    height, width = rig.shape
    with drawing(file, (TWIN_IN, TWIN_IN / 3 * height / width + 1.1), dpi=DPI) as figure:
        title = f"Exposure {figures['number']} at {figures['time_s']:.2f} s: MAE {figures['mae']:.1f}, RMSE {figures['rmse']:.1f}"
        page_title(figure, f"{title}, SSIM {figures['ssim']:.3f}", size=12)
        panels, below = figure.subplots(2, 3, height_ratios=(1, BAR))
        titles = [f"{name.capitalize()}: {figures[f'mean_{name}']:.1f} on average" for name in ("rig", "simulated")]
        scale = _difference(panels, (rig, simulated), (rig, simulated), (*titles, "Rig minus simulated, in digital numbers"))
        figure.colorbar(scale, cax=below[2], orientation="horizontal", extend="both")
        for axes in below[:2]:
            axes.set_axis_off()


def draw_beam(file: Path, digitised: Tensor, headlight: Headlight, utilisation: Tensor) -> None:
    """Draw beam.png: a digitised light texture, the simulated one, and their difference.

    digitised: `[rows, cols]` in cd, or `[3, rows, cols]` in linear sRGB. utilisation: `[n_p]`, of the simulated one. Raises LuxloopError if
    the file cannot be written.
    """
    simulated = headlight.light_texture(utilisation).cpu().numpy()
    seen, intensity = digitised.cpu().numpy(), luminous(digitised).cpu().numpy()
    rms = float(np.sqrt(np.square(intensity - simulated).mean() / max(np.square(simulated).mean(), 1e-30)))
    height, width = headlight.top - headlight.bottom, headlight.left - headlight.right
    titles = [f"{name}: {each.max():,.0f} cd at most" for name, each in (("Digitised", intensity), ("Simulated", simulated))]
    with drawing(file, (BEAM_IN, 3 * (BEAM_IN * height / width + 0.45)), dpi=DPI) as figure:
        panels, last = figure.subplots(3), f"Digitised minus simulated in cd, {100 * rms:.2g} % rms"
        images = (seen if seen.ndim == 2 else np.moveaxis(seen, 0, -1)), simulated
        scale = _difference(panels, images, (intensity, simulated), (*titles, last), height / width * headlight.cols / headlight.rows)
        figure.colorbar(scale, ax=list(panels), location="bottom", extend="both", aspect=60, fraction=0.03)


def _difference(panels: Sequence[Axes], images: Sequence[Array], pair: Sequence[Array], titles: Sequence[str], aspect: Any = None) -> Any:
    """Draw two images on one scale and the difference of two arrays; returns the difference's image, for a colour scale."""
    white = max(float(np.quantile(np.stack(pair), BRIGHT)), 1.0)
    difference = pair[0] - pair[1]
    most = max(float(np.quantile(np.abs(difference), BRIGHT)), 1.0)
    for axes, image in zip(panels, images, strict=False):
        axes.imshow((image / white).clip(0, 1) ** 0.5, aspect=aspect, **SHARES)
    drawn = panels[2].imshow(difference, aspect=aspect, cmap="RdBu_r", vmin=-most, vmax=most, interpolation="antialiased")
    for axes, title in zip(panels, titles, strict=True):
        axes.set(xticks=[], yticks=[], anchor="N")
        axes.set_title(title, weight="normal")
        axes.grid(False)
    return drawn
