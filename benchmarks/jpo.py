"""How near a few iterations of joint pixel optimisation come to the optimum, and what they cost: one thread, process time.

`python benchmarks/jpo.py` prints the tables; `--page` writes docs/jpo.md and its picture; `--quick` is to see that it works.
"""

import argparse
import platform
import time
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from statistics import median

import matplotlib
import numpy as np
import torch

torch.set_num_threads(1)
matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
from bench import processor  # noqa: E402
from torch import Tensor  # noqa: E402

from luxloop.controllers.pixels.jpo import Jpo  # noqa: E402
from luxloop.controllers.pixels.jpo_part import PixelGoal, pixel_goal  # noqa: E402
from luxloop.controllers.pixels.jpo_solvers import least_error, least_squares  # noqa: E402
from luxloop.controllers.pixels.mrpc import MrpcParams, PixelMajor, pixel_major, reduce_setpoints  # noqa: E402
from luxloop.controllers.pixels.primitives import I_V, Primitives, rectangle  # noqa: E402
from luxloop.controllers.pixels.rthc import Setpoints  # noqa: E402
from luxloop.controllers.pixels.ssc import Ssc  # noqa: E402
from luxloop.controllers.pixels.windows import whole  # noqa: E402
from luxloop.loop.report.terminal import markdown  # noqa: E402
from luxloop.loop.scenario.shipped import find_file  # noqa: E402
from luxloop.perception.metrics import mae  # noqa: E402
from luxloop.world.frames import pose_from_degrees  # noqa: E402
from luxloop.world.headlight import Headlight  # noqa: E402
from luxloop.world.lamps.patterns import RECTANGLES  # noqa: E402
from luxloop.world.lamps.presets import lamp  # noqa: E402
from luxloop.world.spmv import multiply  # noqa: E402
from luxloop.world.symbols import load_still  # noqa: E402

TEMPLATE = Path(__file__).with_name("jpo_page.md")
DOCS = Path(__file__).parents[1] / "docs"
LAMPS = ("hd84", "ssl-hd-lores")
EVERY = 41  # of the 1,215 rectangles: 30
# The best of those that were tried for all rectangles alike; sharpening is for pixels that are small beside what they draw.
GOOD = {
    "hd84": {"SSC, a_x = 0.9, a_r = 2": MrpcParams(a_x=0.9, a_r=2.0), "SSC, corrected": MrpcParams(a_x=0.7, a_ac=0.4, corrections=1)},
    "ssl-hd-lores": {
        "SSC, sharpened": MrpcParams(a_x=0.9, a_r=2.0, sharpening=1.0),
        "SSC, corrected": MrpcParams(a_x=0.95, a_ac=0.6, sharpening=2.0, corrections=3),
    },
}
THIN = MrpcParams(a_x=0.95, a_ac=0.4, corrections=3)  # for the arms of a snowflake, which more a_ac would leave out
START = "SSC, a_m = a_r = 1"
BUDGETS = (10, 20, 34, 40, 100)
T_LAMP = pose_from_degrees((0.0, 0.0, 0.75))

Row = tuple[str, list[float], list[float]]  # a method, its error and its cost in ms of each rectangle


def pair_ms(light: Headlight) -> float:
    """One product with the headlight matrix and one with its transpose."""
    u, y = torch.rand(light.n_pixels), torch.rand(light.n_texels)
    taken = []
    for _ in range(15):
        before = time.process_time_ns()
        multiply(light.matrix, u)
        multiply(light.matrix.transpose, y)
        taken.append(1e-6 * (time.process_time_ns() - before))
    return median(taken)


def by_ssc(light: Headlight, tables: PixelMajor, params: MrpcParams, texture: Tensor) -> Tensor:
    """Utilisation of the MapReduce control, every texel being hit that shall be lit."""
    setpoints = Setpoints(texture, (texture > 0).to(texture), whole(light), (I_V,))
    return reduce_setpoints(setpoints, tables, params, torch.zeros(light.n_pixels), dark=True)[0]


def methods(light: Headlight, good: dict[str, MrpcParams]) -> dict[str, Callable[[PixelGoal, Tensor], Tensor]]:
    """Ways to a wanted texture, by name; the joint ones begin at the SSC that is given to them."""
    matrix = light.matrix

    def single(params: MrpcParams) -> Callable[[PixelGoal, Tensor], Tensor]:
        tables = pixel_major(light, params)
        return lambda _, texture: by_ssc(light, tables, params, texture)

    def joint(iterations: int, gap: float | None) -> Callable[[PixelGoal, Tensor], Tensor]:
        return lambda goal, _: least_error(matrix, goal, iterations=iterations, gap=gap).u

    ways: dict[str, Callable[[PixelGoal, Tensor], Tensor]] = {START: lambda goal, _: goal.start}
    ways |= {name: single(params) for name, params in good.items()}
    ways["joint, least squares, converged"] = lambda goal, _: least_squares(matrix, goal)
    ways |= {f"joint, MAE, {budget} iterations": joint(budget, None) for budget in BUDGETS}
    return ways | {"joint, MAE, converged": joint(20_000, 0.005)}


def compare(name: str, every: int) -> tuple[list[Row], float, float]:
    """All ways to every so many-th rectangle; ms of an SpMV pair; the largest proved gap."""
    light = lamp(name).modules[0].headlight
    params = MrpcParams()
    tables, ways = pixel_major(light, params), methods(light, GOOD[name])
    rows: dict[str, tuple[list[float], list[float]]] = {way: ([], []) for way in ways}
    gaps = []
    for each in RECTANGLES[every // 2 :: every]:
        texture = each.texture(light)
        goal = pixel_goal(light, texture, start=by_ssc(light, tables, params, texture))
        for way, drawn in ways.items():
            errors, ms = rows[way]
            before = time.process_time_ns()
            u = drawn(goal, texture)
            ms.append(1e-6 * (time.process_time_ns() - before))
            errors.append(float(mae(light.light_texture(u), texture)))
        proof = least_error(light.matrix, goal)
        gaps.append(float(1 - proof.bound / proof.error))
    return [(way, errors, ms) for way, (errors, ms) in rows.items()], pair_ms(light), max(gaps)


def report(name: str, every: int) -> str:
    rows, pair, gap = compare(name, every)
    best = np.array(rows[-1][1])
    lines = []
    for way, errors, ms in rows:
        ratio = np.array(errors) / best
        cost = ("", "") if way == START else (f"{median(ms):.1f}", f"{median(ms) / pair:.1f}")
        lines.append((way, f"{np.mean(errors):.4f}", f"{np.mean(errors) / best.mean():.3f}", f"{ratio.max():.3f}", *cost))
    head = f"`{name}`, {len(best)} rectangles, an SpMV pair takes {pair:.2g} ms, largest gap of the converged {100 * gap:.2f} %:"
    return f"{head}\n\n{markdown(('', 'mean MAE', 'over converged', 'worst rectangle', 'ms', 'SpMV pairs'), lines)}"


def on_a_wall(y_m: float, symbol: Tensor) -> Primitives:
    """A symbol of 2.4 m x 2.4 m and 8,000 cd on a wall 25 m ahead of the lamp."""
    origin = torch.tensor([25.0, y_m + 1.2, 1.95])
    d1, d2 = torch.tensor([0.0, -2.4, 0.0]), torch.tensor([0.0, 0.0, -2.4])
    return rectangle(origin, d1, d2, 8000.0, "I_v", normal=torch.tensor([-1.0, 0.0, 0.0]), symbol=symbol)


def picture(file: Path) -> str:
    """The snowflake of SSC and of joint optimisation, light above and pixels below (T fig. 8.1); returns their errors in words."""
    light = lamp("ssl-hd-lores").modules[0].headlight
    place = on_a_wall(0.0, load_still(find_file("snowflake", "symbols")))
    jpo = Jpo.prepare(light)
    goal = jpo.goal(place, T_LAMP).target.unflatten(-1, (light.rows, light.cols))
    drawn = {START: Ssc.prepare(light).utilisation(place, T_LAMP).u}
    for name, params in (("SSC, sharpened", GOOD["ssl-hd-lores"]["SSC, sharpened"]), ("SSC, corrected", THIN)):
        drawn[name] = Ssc.prepare(light, params).utilisation(place, T_LAMP).u
    drawn["real-time JPO"] = jpo.utilisation(place, T_LAMP).u
    figure, axes = plt.subplots(2, 5, figsize=(13.5, 6), layout="constrained")
    lit = goal.nonzero()
    (top, left), (bottom, right) = lit.amin(0).tolist(), lit.amax(0).tolist()
    cut = slice(top - 12, bottom + 13), slice(left - 12, right + 13)
    scale = light.pixel_rows / light.rows, light.pixel_cols / light.cols
    pixels = tuple(slice(int(part.start * each), int(part.stop * each) + 1) for part, each in zip(cut, scale, strict=True))
    shown = {"wanted": goal, **{name: light.light_texture(u) for name, u in drawn.items()}}
    errors = {name: float(mae(texture, goal)) for name, texture in shown.items()}
    for axis, (name, texture) in zip(axes[0], shown.items(), strict=True):
        axis.imshow(texture[cut], cmap="inferno", vmin=0, vmax=float(goal.max()))
        axis.set_title(name if name == "wanted" else f"{name}\nMAE {errors[name]:.3f}", fontsize=10)
    for axis, u in zip(axes[1, 1:], drawn.values(), strict=True):
        image = u.view(light.pixel_rows, light.pixel_cols)[pixels]
        drawing = axis.imshow(image, cmap="viridis", vmin=0, vmax=1)
        axis.set_title(f"mean {float(image.mean()):.2f}, largest {float(image.max()):.2f}", fontsize=10)
    figure.colorbar(drawing, ax=axes[1, 1:].tolist(), shrink=0.8, label="utilisation")
    for axis in axes.flat:
        axis.set_axis_off()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return ", ".join(f"{error:.3f} by {name}" for name, error in errors.items() if name != "wanted")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="three rectangles, to see that it works")
    parser.add_argument("--page", nargs="?", type=Path, const=DOCS, help="write jpo.md and its picture into a folder (docs)")
    chosen = parser.parse_args(arguments)
    began = time.monotonic()
    tables = {name.replace("-", "_"): report(name, 405 if chosen.quick else EVERY) for name in LAMPS}
    for table in tables.values():
        print(table, end="\n\n")
    if chosen.page:
        errors = picture(chosen.page / "images" / "jpo-snowflake.png")
        machine = f"{processor()}, Python {platform.python_version()}, torch {torch.__version__}"
        minutes = max(1, round((time.monotonic() - began) / 60))
        words = TEMPLATE.read_text("utf-8").format(**tables, errors=errors, machine=machine, date=date.today(), minutes=minutes)
        (chosen.page / "jpo.md").write_text(words, "utf-8")


if __name__ == "__main__":
    main()
