"""Picture of a photometric file: luminous intensity over both angles, and curves through the peak."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from luxloop.loop.report import charts
from luxloop.loop.report.style import FOUR, columns, drawing, page_title
from luxloop.loop.report.styles import check_out
from luxloop.loop.report.views import Image
from luxloop.world.photometry import Distribution, Photometry

SAMPLES = (721, 541)  # of the map, horizontally and vertically
FAINT, NEEDLE_DEG = 0.02, 40.0  # a beam with all intensities above 2 % of its peak within 40 deg has no polar curve
LABELS = {"A": ("to the right", "up"), "B": ("to the right", "up"), "C": ("C plane", "from nadir")}


def show_distribution(photometry: Photometry, out: Path) -> Path:
    """Draw a photometric file; returns the picture's file. Raises LuxloopError where the picture cannot be written."""
    check_out(out)
    distribution = photometry.distribution
    with drawing(out, (12.0, 5.3)) as figure:
        peak, flux = _number(distribution.candela.max()), _number(distribution.luminous_flux)
        kind = f"{photometry.format}, type {distribution.type}"
        page_title(figure, photometry.path.name, kind, f"peak {peak} cd", f"{flux} lm")
        left, right = columns(figure, 7.2, 4.8)
        _map(left.subplots(), distribution)
        _curves(right, distribution)
    return out


def cuts(distribution: Distribution) -> tuple[Image, dict[str, Image]]:
    """Angles `[N]` in deg and luminous intensities `[N]` in cd of the two curves through the peak, by name.

    Types A and B: angles to the right and up, from the axis. Type C: from nadir, towards the first named half plane.
    """
    v, h, candela = distribution.full_table
    i, j = np.unravel_index(int(candela.argmax()), candela.shape)
    angles = np.linspace(-180, 180, 1441)
    if distribution.type == "C":
        peak = float(h[i]) % 180
        return angles, {
            f"C{plane:g} – C{plane + 180:g}": distribution.at(np.abs(angles), np.where(angles >= 0, plane, plane + 180))
            for plane in (peak, (peak + 90) % 180)
        }
    return angles, {
        f"across, {charts.degrees(v[j])} up": distribution.at(v[j], angles),
        f"upright, {charts.degrees(h[i])} right": distribution.at(angles, h[i]),
    }


def _map(axes: Axes, distribution: Distribution) -> None:
    v, h, _ = distribution.full_table
    across, up = np.linspace(h[0], h[-1], SAMPLES[0]), np.linspace(v[0], v[-1], SAMPLES[1])
    candela = distribution.at(up[::-1, None], across)
    axes.set_title("Luminous intensity")
    charts.false_colours(axes, candela, (h[0], h[-1], v[0], v[-1]), "cd")
    for axis, label in zip((axes.xaxis, axes.yaxis), LABELS[distribution.type], strict=True):
        axis.set_major_locator(MaxNLocator(9, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))
        axis.set_major_formatter(charts.degrees)
        axis.set_label_text(label)


def _curves(figure: SubFigure, distribution: Distribution) -> None:
    """Draw the curves through the peak in polar coordinates, or over the angle for a narrow beam."""
    angles, curves = cuts(distribution)
    bright = [np.abs(angles[candela > FAINT * candela.max()]).max(initial=0.0) for candela in curves.values()]
    narrow = max(bright) < NEEDLE_DEG
    axes = figure.subplots(subplot_kw={} if narrow else {"projection": "polar"})
    for (name, candela), colour, line in zip(curves.items(), FOUR[:2], ("-", "--"), strict=True):
        axes.plot(angles if narrow else np.deg2rad(angles), candela, color=colour, ls=line, label=name)
    axes.yaxis.set_major_formatter(lambda candela, _: _number(candela))
    axes.set_title("Through the peak, in cd")
    if isinstance(axes, PolarAxes):
        nadir = distribution.type == "C"
        axes.set_theta_zero_location("S" if nadir else "N")
        axes.set_theta_direction(1 if nadir else -1)
        axes.set_thetagrids(range(0, 360, 30), [charts.degrees(min(angle, 360 - angle)) for angle in range(0, 360, 30)])
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.set_rlabel_position(75)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.2), ncols=2)
    else:
        width = 1.3 * max(bright) or NEEDLE_DEG  # nothing shines
        axes.set(xlim=(-width, width), ylim=(0, None))
        axes.xaxis.set_major_formatter(charts.degrees)
        axes.legend(loc="upper right")


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"
