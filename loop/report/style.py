"""Style of all figures: type, colours, legends, panels, and writing to files."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import Any

from matplotlib import rc_context, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure, SubFigure
from numpy.typing import ArrayLike

from luxloop.world.files import whole

# Matplotlib's own, since a matplotlibrc in the working folder could start LaTeX
DEFAULTS: Any = {key: value for key, value in rcParamsDefault.items() if key != "backend"}
STYLE: Any = DEFAULTS | {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.framealpha": 0.75,
    "legend.edgecolor": "none",
    "legend.fontsize": 8,
}
FOUR = ("#0072b2", "#e69f00", "#009e73", "#cc79a7")  # Okabe and Ito, for colour-blind readers too
NIGHT = LinearSegmentedColormap.from_list("night", ["#05070c", "#3a3f4a", "#a9a598", "#fffbe8"])
SHARES: Any = {"cmap": NIGHT, "vmin": 0, "vmax": 1, "interpolation": "antialiased"}  # of an image in 0..1
BOLD_IN = 0.0081  # width of a bold character a point of its size
CHARACTER_IN, LINE_IN, AROUND_IN = 0.053, 0.38, 0.6  # width of a legend's character and of its line with margins; margins of a chart


def heading(axes: Axes, title: str, *more: Axes) -> None:
    """Draw a title with the legend below, above the chart. more: further axes of the same chart with labels."""
    found = [each for one in (axes, *more) for each in one.get_legend_handles_labels()[0]]
    if not found:
        axes.set_title(title)
        return
    longest = max(len(str(each.get_label())) for each in found) * CHARACTER_IN + LINE_IN
    width = axes.figure.bbox.width / axes.figure.dpi - AROUND_IN
    axes.legend(
        handles=found,
        title=title,
        title_fontproperties={"weight": "bold", "size": STYLE["axes.titlesize"]},
        ncols=max(1, min(len(found), int(width / longest))),
        loc="lower left",
        bbox_to_anchor=(0, 1),
        alignment="left",
        borderaxespad=0.2,
        borderpad=0.2,
        handlelength=1.6,
        columnspacing=1.2,
    )


def field(axes: Axes, values: ArrayLike, extent: tuple[float, float, float, float], label: str = "", **style: Any) -> ScalarMappable:
    """Draw values `[H, W]` in colours over the whole axes, without a grid. label: of a colour bar; empty for none."""
    drawn = axes.imshow(values, extent=extent, **{"cmap": "inferno", "aspect": "auto", "interpolation": "antialiased"} | style)
    axes.grid(False)
    if label:
        axes.figure.colorbar(drawn, ax=axes, label=label, pad=0.01)
    return drawn


def scale(axes: Axes, drawn: ScalarMappable, label: str) -> Colorbar:
    """Draw a slim colour bar beside axes."""
    return axes.figure.colorbar(drawn, ax=axes, label=label, pad=0.015, fraction=0.05, aspect=24)


def rows(figure: Figure | SubFigure, *heights: float) -> list[SubFigure]:
    """Parts of a figure one below the other. heights: their ratios."""
    return [*figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]]


def columns(figure: Figure | SubFigure, *widths: float) -> list[SubFigure]:
    """Parts of a figure side by side. widths: their ratios."""
    return [*figure.subfigures(1, len(widths), squeeze=False, width_ratios=widths)[0]]


def no_frame(axes: Axes) -> None:
    """Remove ticks, grid and box of axes with a picture."""
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def page_title(figure: Figure | SubFigure, *parts: str, size: float = 11.5) -> None:
    """Write a page's title on its upper left, in lines that fit and end between parts; empty parts are left out."""
    characters = int(figure.bbox.width / figure.dpi / (BOLD_IN * size))
    figure.suptitle(
        fill("  ·  ".join(part.replace(" ", "\u00a0") for part in parts if part), characters),
        x=0.012,
        ha="left",
        fontsize=size,
        weight="bold",
    )


@contextmanager
def drawing(out: Path, inches: tuple[float, float], style: Any = STYLE, dpi: int = 110) -> Iterator[Figure]:
    """A figure to draw into, saved by `write` at the end of the block."""
    with rc_context(style):
        figure = Figure(inches, dpi, layout="constrained")
        yield figure
        write(figure, out)


def write(figure: Figure, out: Path) -> None:
    """Save a figure in the format of its suffix, whole or not at all. Raises LuxloopError where the file cannot be written."""
    FigureCanvasAgg(figure)
    with whole(out) as part:
        figure.savefig(part, format=out.suffix[1:].lower())
