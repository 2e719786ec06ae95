"""Two cars agree by their cameras alone on who draws: `python turns.py [SEEDS] [KEY=VALUE ...]` prints figures of the shipped scenario
`shared_stretch` over seeds, and writes `turns.png`: what both cameras see, and whose turn it is.
"""

import sys
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from torch import Tensor

import luxloop

NAME = "crossing"
ALONE = 10  # steps with one car alone after which both have agreed
COLOURS = ("tab:blue", "tab:orange")


def run(seed: int, changes: Sequence[str]) -> tuple[np.ndarray, np.ndarray, list[tuple[Tensor, Tensor]]]:
    """Turns of both cars, `[steps, 2]` of idle, waits or draws; whether their light is on the stretch, `[steps, 2]`; and their frames."""
    scenario = luxloop.load("shared_stretch", [f"seed={seed}", *changes])
    turns, lit, frames = [], [], []
    for result in luxloop.prepare(scenario, "cpu").run():
        cars = (result, result.reception.plant.result)
        turns.append([each.planning.functions[NAME].turn for each in cars])
        lit.append([bool(each.planning.drawn[NAME]) for each in cars])
        frames.append(tuple(each.frame for each in cars))
    return np.array(turns), np.array(lit), frames


def figures(turns: np.ndarray) -> dict[str, float]:
    """Shares of the steps in which a car wants to draw, steps to agreement (NaN without one), and steps of the cars' turns."""
    wanted = turns[(turns != "idle").any(1)]
    drawing = (wanted == "draws").sum(1)
    agreed = [k for k in range(len(drawing) - ALONE + 1) if (drawing[k : k + ALONE] == 1).all()]
    first, second = (wanted == "draws").sum(0).tolist()
    return {
        "both draw": float((drawing == 2).mean()),
        "none draws": float((drawing == 0).mean()),
        "steps to agreement": float(agreed[0]) if agreed else np.nan,
        "steps of the first car": first,
        "steps of the second car": second,
    }


def picture(lit: np.ndarray, frames: Sequence[tuple[Tensor, Tensor]], file: str) -> None:
    """Frames of both cars while each of them lights the stretch alone, above the timeline of their light."""
    alone = [np.flatnonzero(lit[:, car] & ~lit[:, 1 - car]) for car in (0, 1)]
    shown = sorted((int(steps[len(steps) // 2]), car) for car, steps in enumerate(alone))
    figure, axes = plt.subplot_mosaic([["00", "01"], ["10", "11"], ["t", "t"]], figsize=(9, 5), height_ratios=(1, 1, 0.8), layout="tight")
    for k, (step, drawing) in enumerate(shown):
        for car in (0, 1):
            image = frames[step][car]
            axes[f"{car}{k}"].imshow(image[len(image) // 2 : 3 * len(image) // 4].sqrt(), cmap="gray", aspect="auto")
            axes[f"{car}{k}"].set_title(f"camera of car {car + 1}, step {step}: car {drawing + 1} draws", fontsize=9)
            axes[f"{car}{k}"].axis("off")
    for car, colour in enumerate(COLOURS):
        axes["t"].broken_barh([(step, 1) for step in np.flatnonzero(lit[:, car])], (car - 0.4, 0.8), color=colour, lw=0)
    axes["t"].vlines([step + 0.5 for step, _ in shown], -0.5, 1.5, color="black", lw=0.8)
    axes["t"].set(yticks=(0, 1), yticklabels=("light of car 1", "light of car 2"), ylim=(1.5, -0.5), xlim=(0, len(lit)), xlabel="step")
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    seeds, changes = int((sys.argv[1:] or ["4"])[0]), sys.argv[2:]
    runs = [run(seed, changes) for seed in range(seeds)]
    found = [figures(turns) for turns, _, _ in runs]
    for name in found[0]:
        values = [each[name] for each in found]
        print(f"{name}: mean {np.mean(values):.3g}, median {np.median(values):.3g}, worst {np.max(values):.3g}")
    picture(*runs[0][1:], "turns.png")
