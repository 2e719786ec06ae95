"""twin.png: a rig's frame, the simulated one of the same exposure, and their difference."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from luxloop.loop.report.style import SHARES, STYLE
from luxloop.world.files import whole

WIDE_IN, DPI, TITLES_IN = 13.0, 130, 1.1
BAR: Final = 0.04  # height of the scale, of a frame's
BRIGHT: Final = 0.998  # quantile of both frames that is shown as white, and of their difference that has the full colour


def draw_twin(file: Path, rig: NDArray[np.floating], simulated: NDArray[np.floating], figures: Mapping[str, Any]) -> None:
    """Draw twin.png. rig, simulated: digital numbers `[height, width]`. figures: their row of twin.parquet.

    Raises LuxloopError if the file cannot be written.
    """
    white = max(float(np.quantile(np.stack([rig, simulated]), BRIGHT)), 1.0)
    difference = rig - simulated
    most = max(float(np.quantile(np.abs(difference), BRIGHT)), 1.0)
    height, width = rig.shape
    with rc_context(STYLE):
        figure = Figure((WIDE_IN, WIDE_IN / 3 * height / width + TITLES_IN), DPI, layout="constrained")
        title = f"Exposure {figures['number']} at {figures['time_s']:.2f} s: MAE {figures['mae']:.1f}, RMSE {figures['rmse']:.1f}"
        figure.suptitle(f"{title}, SSIM {figures['ssim']:.3f}", x=0.012, ha="left", fontsize=12, weight="bold")
        (ours, theirs, apart), below = figure.subplots(2, 3, height_ratios=(1, BAR))
        for axes, name, image in ((ours, "rig", rig), (theirs, "simulated", simulated)):
            axes.imshow((image / white).clip(0, 1) ** 0.5, **SHARES)
            _titled(axes, f"{name.capitalize()}: {figures[f'mean_{name}']:.1f} on average")
        shown = apart.imshow(difference, cmap="RdBu_r", vmin=-most, vmax=most, interpolation="antialiased")
        _titled(apart, "Rig minus simulated, in digital numbers")
        figure.colorbar(shown, cax=below[2], orientation="horizontal", extend="both")
        for axes in below[:2]:
            axes.set_axis_off()
        with whole(file) as part:
            figure.savefig(part, format="png")


def _titled(axes: Axes, title: str) -> None:
    axes.set(xticks=[], yticks=[], anchor="N")
    axes.set_title(title, weight="normal")
    axes.grid(False)
