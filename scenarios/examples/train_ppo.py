"""Learn to hold a symbol on uneven roads by proximal policy optimisation (PPO) of Stable-Baselines3: `python train_ppo.py [--seeds 3]`.

Each seed trains on two groups of 16 copies, each on a new road after four episodes. The policies are then compared with thesis_pid, and
with a blind move straight to the target, on roads not used in training; a picture beside them shows curves and the mean of the seeds with
its 95 % interval. Needs Stable-Baselines3: pip install 'luxloop[sb3]'.
"""

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
import torch
from matplotlib import pyplot
from scipy.stats import t
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

import luxloop

WORLD = ("camera.width_px=640", "camera.height_px=360", "camera.latency_steps=0")
COPIES, STEPS = 16, 16  # of a group, and of an episode
EVALUATED_STEPS, LAST = 32, 8  # of the comparison, and its last ones
STARTS = (13.5, -1.4, -0.09, -0.035), (21.0, 1.4, 0.09, 0.03)  # least and greatest x, y in m, roll, pitch in rad
# What the policy sees of an observation, so that all numbers are about 1: pose about the target, errors, whether it is seen.
CENTRE = (17.0, *[0.0] * 16)
SCALE = (4.0, 1.5, 0.1, 0.05, 2.0, 1.0, 0.08, 0.04, *[1.0] * 7, 30.0, 0.5)
RATE_LIMIT = np.array([1.5, 0.9, 0.0419, 0.0236])  # m, m, rad, rad: an action of 1
SETTLED, HELD_OUT = 0.05, 1_000_000


class Scaled(BaseFeaturesExtractor):
    """Observations in numbers of about 1."""

    def __init__(self, space) -> None:
        super().__init__(space, len(SCALE))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return (seen - torch.tensor(CENTRE)) / torch.tensor(SCALE)


def roads(first: int, last: int, every: int, steps: int, action: str = "moves") -> luxloop.RandomisedVector:
    """Copies on a mixed road; new bumps and roughness are drawn after `every` episodes."""
    copies = luxloop.make_vec("snowflake", COPIES, *WORLD, f"steps={steps}", action=action, autoreset_mode="Disabled")
    return luxloop.RandomisedVector(copies, [f"road.seed={first}:{last}"], every)


def train(seed: int, steps: int, file: Path) -> np.ndarray:
    """Train a policy and save it; mean reward of the copies in each step."""
    torch.set_num_threads(1)
    groups = (roads(1, HELD_OUT - 1, 4, STEPS) for _ in range(2))
    learner, rewards = luxloop.make_sb3(*groups, starts=STARTS), []
    scaled = {"features_extractor_class": Scaled, "log_std_init": -1.0}
    updates = {"n_steps": STEPS, "batch_size": 256, "n_epochs": 8, "learning_rate": 1e-3, "gamma": 0.9, "gae_lambda": 0.9, "ent_coef": 1e-3}
    model = PPO("MlpPolicy", learner, policy_kwargs=scaled, seed=seed, device="cpu", **updates)
    model.learn(steps, callback=lambda now, _: rewards.append(now["rewards"].mean()) or True)
    model.save(file)
    return np.array(rewards)


def evaluate(act: Callable[[np.ndarray], np.ndarray], worlds: int, action: str = "moves") -> tuple[np.ndarray, np.ndarray]:
    """IoU and distance of the centroids in symbol sizes, `[steps, worlds * copies]`, on roads not used in training."""
    held_out = roads(HELD_OUT, 2 * HELD_OUT, 1, EVALUATED_STEPS, action)
    iou, away = [], []
    for world in range(worlds):
        starts = np.random.default_rng(world).uniform(*STARTS, (COPIES, 4))
        seen, _ = held_out.reset(seed=world, options={"start": starts})
        for _ in range(EVALUATED_STEPS):
            seen, _, _, _, info = held_out.step(act(seen))
            iou.append(info["verdict"]["iou"])
            away.append(np.linalg.norm(np.nan_to_num(info["verdict"]["centroid_percent"], nan=100.0), axis=-1) / 100)
    shape = worlds, EVALUATED_STEPS, COPIES
    return tuple(np.reshape(each, shape).swapaxes(0, 1).reshape(EVALUATED_STEPS, -1) for each in (iou, away))


def blind(seen: np.ndarray) -> np.ndarray:
    """Straight to the target without feedback, which is right on a flat road."""
    return np.clip((CENTRE[:4] - seen[:, :4]) / RATE_LIMIT, -1, 1)


def settled(away: np.ndarray) -> np.ndarray:
    """The step from which on the centroid stays within 5 % of the symbol, the number of steps where it does not."""
    return EVALUATED_STEPS - (np.cumprod(away[::-1] < SETTLED, 0)).sum(0)


def interval(values: np.ndarray) -> np.ndarray:
    """Half the 95 % interval of the mean over seeds, the first axis."""
    return t.ppf(0.975, len(values) - 1) * values.std(0, ddof=1) / len(values) ** 0.5 if len(values) > 1 else 0 * values[0]


def predict(model: PPO, seen: np.ndarray) -> np.ndarray:
    return model.predict(seen, deterministic=True)[0]


def draw(axes: pyplot.Axes, x: np.ndarray, values: np.ndarray, name: str) -> None:
    """Mean over seeds, the first axis, and its 95 % interval."""
    mean, half = values.mean(0), interval(values)
    axes.plot(x, mean, label=name)
    axes.fill_between(x, mean - half, mean + half, alpha=0.2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=20_000, help="of all copies together")
    parser.add_argument("--worlds", type=int, default=4, help="roads for the comparison")
    parser.add_argument("--out", type=Path, default=Path("learned.png"), help="picture; the policies lie beside it")
    given = parser.parse_args()
    files = [given.out.with_name(f"{given.out.stem}-{seed}.zip") for seed in range(given.seeds)]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        curves = np.array(list(pool.map(train, range(given.seeds), [given.steps] * given.seeds, files)))
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    curves = curves[:, : curves.shape[1] // STEPS * STEPS].reshape(given.seeds, -1, STEPS).mean(2)  # by episode
    draw(left, 2 * COPIES * STEPS * (1 + np.arange(curves.shape[1])), curves, "learned")
    left.set(xlabel="steps of all copies", ylabel="mean reward of a step in training")
    ways = {
        "thesis_pid": [(lambda seen: np.zeros((len(seen), 6), np.float32), "gains")],  # whose gains stay as they are
        "blind": [(blind, "moves")],
        "learned": [(partial(predict, PPO.load(file, device="cpu")), "moves") for file in files],
    }
    for name, acts in ways.items():
        iou, away = map(np.array, zip(*(evaluate(act, given.worlds, action) for act, action in acts), strict=True))
        steps, final = np.concatenate([settled(each) for each in away]), iou[:, -LAST:].mean((1, 2))
        never = (steps == EVALUATED_STEPS).mean()
        result = f"final IoU {final.mean():.3f}" + (f" ± {interval(final):.3f}" if len(acts) > 1 else "")
        print(f"{name:10}  settled after {np.median(steps):4.1f} steps, never {never:4.0%}, {result}", flush=True)
        draw(right, np.arange(EVALUATED_STEPS), iou.mean(2), name)
    right.set(xlabel="step", ylabel="IoU, mean of roads not seen", ylim=(0, 1))
    right.legend()
    figure.savefig(given.out, dpi=130)


if __name__ == "__main__":
    main()
