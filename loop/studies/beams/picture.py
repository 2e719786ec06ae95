"""beam.png: what the camera sees and the beams on a wall, before and after a search."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from luxloop.loop.report.marks import Mark, readable
from luxloop.loop.report.picture import WALL_DEG, wall_light
from luxloop.loop.report.style import NIGHT, STYLE
from luxloop.loop.studies.beams.goal import BeamJudge
from luxloop.loop.studies.beams.search import Lights
from luxloop.perception.camera import luminance_of
from luxloop.world.files import whole

WALL_COLUMNS = 360
FAINTEST_LX = 0.1  # on the wall, that is shown as black
CHARACTERS = 250  # of marks, side by side, that fill all pictures of the camera
BRIGHT = 0.995  # quantile of the luminance found that is shown as white


@torch.no_grad()
def write_picture(file: Path, judge: BeamJudge, beams: Mapping[str, Lights], losses: Sequence[float], summary: dict[str, Any]) -> None:
    """Raises LuxloopError if it cannot be written."""
    camera = judge.simulation.scenario.camera
    images = [judge.frame(judge.judged(lights).luminance, 0, True) * (2**camera.bits - 1) for lights in beams.values()]
    seen = [luminance_of(image, camera).cpu() for image in images]
    walls = [wall_light(judge.simulation.modules, lights, WALL_COLUMNS).cpu() for lights in beams.values()]
    white = float(torch.quantile(seen[-1].flatten()[::7], BRIGHT)) * 1.3
    scale = LogNorm(FAINTEST_LX, max(1.0, *(float(wall.max()) for wall in walls)))  # one for all, so that they can be compared
    side, down, up = WALL_DEG
    with rc_context(STYLE):
        figure = Figure((13.0, 6.4), 110, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(3, len(beams), height_ratios=(4.2, 2.4, 1.5))
        for k, name in enumerate(beams):
            figures = summary["beams"][name]
            axes = figure.add_subplot(grid[0, k])
            axes.imshow((seen[k].numpy() / white).clip(0, 1) ** 0.5, cmap=NIGHT, vmin=0, vmax=1)
            named = []
            for (each, score), (left, top, right, bottom) in zip(figures["scores"].items(), judge.boxes.tolist(), strict=True):
                axes.plot([left, right, right, left, left], [top, top, bottom, bottom, top], color="#4fd17a", linewidth=0.7)
                named.append(Mark((), text=f"{each} {score:.2f}", at=(round(left), round(top))))
            for mark in readable(named, camera.width_px * len(beams) / CHARACTERS, camera.width_px):
                axes.annotate(mark.text, mark.at, (0, 2), textcoords="offset points", color="#4fd17a", fontsize=6, clip_on=True)
            axes.set(xticks=[], yticks=[], xlim=(-0.5, camera.width_px - 0.5), ylim=(camera.height_px - 0.5, -0.5))
            axes.set_title(f"{name}: {figures['flux_lm']:.0f} lm, mean score {figures['score_mean']:.2f}")
            axes.grid(False)
            wall = figure.add_subplot(grid[1, k])
            light = walls[k].clamp(min=FAINTEST_LX).numpy()
            shown = wall.imshow(light, cmap="inferno", norm=scale, extent=(-side, side, -down, up), aspect="auto")
            title = f"Both lamps on a wall at 25 m: {float(walls[k].max()):.3g} lx at most"
            wall.set(title=title, xlabel="to the right in deg", ylabel="up in deg" if k == 0 else "")
            wall.grid(False)
            figure.colorbar(shown, ax=wall, label="lx", pad=0.01, format="{x:g}")
        course = figure.add_subplot(grid[2, :])
        course.plot(losses)
        course.set(xlabel="step", title=f"Loss, {summary['method']}, {summary['metric']}")
        with whole(file) as part:
            figure.savefig(part, format="png")
