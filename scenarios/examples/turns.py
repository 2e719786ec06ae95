"""Two cars agree by their cameras alone on who draws: `python turns.py [SEEDS] [KEY=VALUE ...]` prints figures of the shipped scenario
`shared_stretch` over seeds, and writes `turns.png`: what both cameras see, and whose turn it is.
"""

import sys
from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from torch import Tensor

import luxloop

ALONE = 10  # steps with one car alone after which both have agreed
COLOURS = ("tab:blue", "tab:orange")


def run(seed: int, changes: Sequence[str]) -> tuple[np.ndarray, list[tuple[Tensor, Tensor]]]:
    """Turns of both cars, `[steps, 2]` of idle, waits or draws, and their frames."""
    scenario = luxloop.load("shared_stretch", [f"seed={seed}", *changes])
    turns, frames = [], []
    for result in luxloop.prepare(scenario, "cpu").run():
        cars = (result, result.reception.plant.result)
        turns.append([each.planning.functions["crossing"].turn for each in cars])
        frames.append(tuple(each.frame for each in cars))
    return np.array(turns), frames


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


def picture(turns: np.ndarray, frames: Sequence[tuple[Tensor, Tensor]], file: str) -> None:
    """Frames of both cars in the middle of the first turn of each, above the timeline."""
    shown = [int(np.median(np.flatnonzero((turns == "draws").sum(1) * (turns[:, car] == "draws") == 1))) for car in (0, 1)]
    figure, axes = plt.subplot_mosaic([["00", "01"], ["10", "11"], ["t", "t"]], figsize=(9, 6.2), height_ratios=(1, 1, 0.7), layout="tight")
    for k, step in enumerate(shown):
        for car in (0, 1):
            axes[f"{car}{k}"].imshow(frames[step][car].numpy() ** 0.5, cmap="gray")
            axes[f"{car}{k}"].set_title(f"camera of car {car + 1}, step {step}: car {k + 1} draws", fontsize=9)
            axes[f"{car}{k}"].axis("off")
    for car, colour in enumerate(COLOURS):
        axes["t"].fill_between(
            range(len(turns)), car - 0.4, np.where(turns[:, car] == "draws", car + 0.4, car - 0.4), step="post", color=colour
        )
    axes["t"].vlines(shown, -0.5, 1.5, color="black", lw=0.8)
    axes["t"].set(yticks=(0, 1), yticklabels=("car 1 draws", "car 2 draws"), ylim=(1.5, -0.5), xlim=(0, len(turns)), xlabel="step")
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    seeds, changes = int((sys.argv[1:] or ["4"])[0]), sys.argv[2:]
    runs = [run(seed, changes) for seed in range(seeds)]
    found = [figures(turns) for turns, _ in runs]
    for name in found[0]:
        values = [each[name] for each in found]
        print(f"{name}: mean {np.mean(values):.3g}, median {np.median(values):.3g}, worst {np.max(values):.3g}")
    picture(*runs[0], "turns.png")
