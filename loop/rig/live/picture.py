"""beam.png: a digitised light texture, the simulated one for the same utilisations, and their difference."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from luxloop.loop.report.style import SHARES, STYLE
from luxloop.loop.rig.live.digitiser import luminous
from luxloop.world.files import whole
from luxloop.world.headlight import Headlight

WIDE_IN, DPI, TITLE_IN = 8.0, 130, 0.45
BRIGHT: Final = 0.998  # quantile of the textures that is shown as white, and of their difference that has the full colour


def draw_beam(file: Path, digitised: Tensor, headlight: Headlight, utilisation: Tensor) -> None:
    """Draw beam.png. digitised: light texture `[rows, cols]` in cd, or `[3, rows, cols]` in linear sRGB. headlight: simulates the texture
    of utilisation `[n_p]`.

    Raises LuxloopError if the file cannot be written.
    """
    simulated = headlight.light_texture(utilisation).cpu().numpy()
    seen, intensity = digitised.cpu().numpy(), luminous(digitised).cpu().numpy()
    white = max(float(np.quantile(np.stack([intensity, simulated]), BRIGHT)), 1.0)
    difference = intensity - simulated
    most = max(float(np.quantile(np.abs(difference), BRIGHT)), 1.0)
    rms = float(np.sqrt(np.square(difference).mean() / max(np.square(simulated).mean(), 1e-30)))
    height, width = headlight.top - headlight.bottom, headlight.left - headlight.right
    aspect = height / width * headlight.cols / headlight.rows
    with rc_context(STYLE):
        figure = Figure((WIDE_IN, 3 * (WIDE_IN * height / width + TITLE_IN)), DPI, layout="constrained")
        ours, theirs, apart = figure.subplots(3)
        for axes, name, texture, peak in ((ours, "Digitised", seen, intensity.max()), (theirs, "Simulated", simulated, simulated.max())):
            axes.imshow(_shown(texture / white), aspect=aspect, **SHARES)
            _titled(axes, f"{name}: {peak:,.0f} cd at most")
        shown = apart.imshow(difference, aspect=aspect, cmap="RdBu_r", vmin=-most, vmax=most, interpolation="antialiased")
        _titled(apart, f"Digitised minus simulated in cd, {100 * rms:.2g} % rms")
        figure.colorbar(shown, ax=[ours, theirs, apart], location="bottom", extend="both", aspect=60, fraction=0.03)
        with whole(file) as part:
            figure.savefig(part, format="png")


def _shown(share: NDArray[np.floating]) -> NDArray[np.floating]:
    """A picture of light relative to white, `[rows, cols]` or `[3, rows, cols]`."""
    return (share if share.ndim == 2 else np.moveaxis(share, 0, -1)).clip(0, 1) ** 0.5


def _titled(axes: Axes, title: str) -> None:
    axes.set(xticks=[], yticks=[], anchor="N")
    axes.set_title(title, weight="normal")
    axes.grid(False)
