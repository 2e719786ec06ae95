"""Learn to hold a symbol on uneven roads by proximal policy optimisation (PPO): `python train_ppo.py [--minutes 8] [--out learned.zip]`.

32 copies of a symbol learn on random roads. Then the policy is compared with thesis_pid, and with a blind move straight to the target, on
roads not used in training; a picture beside the policy shows this. Needs Stable-Baselines3: pip install 'luxloop[sb3]'.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

import luxloop

WORLD = ("camera.width_px=640", "camera.height_px=360", "camera.latency_steps=0")
COPIES, STEPS = 32, 16
EVALUATED_STEPS, LAST = 32, 8  # of the comparison, and its last ones
STARTS = ((13.5, -1.4, -0.09, -0.035), (21.0, 1.4, 0.09, 0.03))  # least and greatest x, y in m, roll, pitch in rad
TARGET, RATE_LIMIT = np.array([17.0, 0.0, 0.0, 0.0]), np.array([1.5, 0.9, 0.0419, 0.0236])  # m, m, rad, rad: an action of 1
SETTLED, HELD_OUT = 0.05, 1_000_000


def roads(first: int, last: int, every: int, steps: int, action: str = "moves"):
    """Copies on a mixed road; new bumps and roughness are drawn after `every` episodes."""
    copies = luxloop.make_vec("snowflake", COPIES, *WORLD, f"steps={steps}", action=action, autoreset_mode="Disabled")
    return luxloop.make_sb3(luxloop.RandomisedVector(copies, [f"road.seed={first}:{last}"], every), STARTS)


class Curve(BaseCallback):
    """Mean reward of each rollout by time, until the time is over."""

    def __init__(self, minutes: float) -> None:
        super().__init__()
        self.began, self.ends_s, self.points, self.rewards = time.monotonic(), 60 * minutes, [], []

    def _on_step(self) -> bool:
        self.rewards.append(self.locals["rewards"].mean())
        return time.monotonic() - self.began < self.ends_s

    def _on_rollout_end(self) -> None:
        self.points.append((time.monotonic() - self.began, float(np.mean(self.rewards))))
        self.rewards.clear()
        print(f"{self.points[-1][0]:5.0f} s  step {self.num_timesteps:6d}  mean reward {self.points[-1][1]:+.3f}", flush=True)


def evaluated(act: Callable[[np.ndarray], np.ndarray], worlds: int, action: str = "moves") -> tuple[np.ndarray, np.ndarray]:
    """IoU and distance of the centroids in symbol sizes, `[steps, worlds * copies]`, on roads not used in training."""
    held_out = roads(HELD_OUT, 2 * HELD_OUT, 1, EVALUATED_STEPS, action)
    verdicts = []
    for world in range(worlds):
        held_out.seed(world)
        seen = held_out.reset()
        for _ in range(EVALUATED_STEPS):
            seen, _, _, infos = held_out.step(act(seen))
            verdicts.append([[each["verdict"]["iou"], *each["verdict"]["centroid_percent"]] for each in infos])
    found = np.reshape(verdicts, (worlds, EVALUATED_STEPS, COPIES, 3)).swapaxes(0, 1).reshape(EVALUATED_STEPS, -1, 3)
    return found[..., 0], np.linalg.norm(np.nan_to_num(found[..., 1:], nan=100.0), axis=-1) / 100


def settled(away: np.ndarray) -> np.ndarray:
    """The step from which on the centroid stays within 5 % of the symbol, the number of steps where it does not."""
    return EVALUATED_STEPS - (np.cumprod(away[::-1] < SETTLED, 0)).sum(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--worlds", type=int, default=6, help="roads for the comparison")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("learned.zip"))
    given = parser.parse_args()
    normalised = VecNormalize(roads(1, HELD_OUT - 1, 4, STEPS), norm_reward=False)
    rollouts = {"n_steps": 2 * STEPS, "batch_size": 256, "n_epochs": 8, "gamma": 0.9, "gae_lambda": 0.9}
    policy = {"policy_kwargs": {"log_std_init": -1.0}, "learning_rate": 1e-3, "ent_coef": 1e-3}
    model = PPO("MlpPolicy", normalised, **rollouts, **policy, seed=given.seed, device="cpu")
    curve = Curve(given.minutes)
    model.learn(10**9, curve)
    model.save(given.out)
    normalised.save(str(given.out.with_suffix(".normalised")))
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    left.plot(*np.transpose(curve.points))
    left.set(xlabel="time of learning, s", ylabel="mean reward of a step")
    ways = {
        "thesis_pid": (lambda seen: np.zeros((len(seen), 6)), "gains"),  # whose gains stay as they are
        "blind": (lambda seen: ((TARGET - seen[:, :4]) / RATE_LIMIT).clip(-1, 1), "moves"),  # which is right on a flat road
        "learned": (lambda seen: model.predict(normalised.normalize_obs(seen), deterministic=True)[0], "moves"),
    }
    for name, (act, action) in ways.items():
        iou, away = evaluated(act, given.worlds, action)
        steps = settled(away)
        never = (steps == EVALUATED_STEPS).mean()
        print(f"{name:10}  settled after {np.median(steps):4.1f} steps, never {never:4.0%}, final IoU {iou[-LAST:].mean():.3f}")
        right.plot(iou.mean(1), label=name)
    right.set(xlabel="step", ylabel="IoU, mean of roads not seen", ylim=(0, 1))
    right.legend()
    figure.savefig(given.out.with_suffix(".png"), dpi=130)


if __name__ == "__main__":
    main()
