"""Learn to hold a symbol on uneven roads by proximal policy optimisation (PPO): `python train_ppo.py [--minutes 8] [--out learned.pt]`.

Two processes collect episodes on random roads, with 32 copies each. Then the policy is compared with thesis_pid, and with a blind move
straight to the target, on roads not used in training; a picture beside the policy shows this. Needs Gymnasium: pip install 'luxloop[gym]'.
"""

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
import torch
from matplotlib import pyplot
from torch import Tensor, nn

import luxloop

WORLD = ("camera.width_px=640", "camera.height_px=360", "camera.latency_steps=0")
COPIES, STEPS, WORKERS = 32, 16, 2
EVALUATED_STEPS, LAST = 32, 8  # of the comparison, and its last ones
GAMMA, LAMBDA, CLIP, EPOCHS, BATCH, RATE = 0.9, 0.9, 0.2, 8, 256, 1e-3
STARTS = torch.tensor([[13.5, -1.4, -0.09, -0.035], [21.0, 1.4, 0.09, 0.03]])  # least and greatest x, y in m, roll, pitch in rad
# What the policy sees of an observation (SymbolEnv), so that all numbers are about 1: pose about the target, errors, whether it is seen.
CENTRE = torch.tensor([17.0, 0.0, 0.0, 0.0, *[0.0] * 13])
SCALE = torch.tensor([4.0, 1.5, 0.1, 0.05, 2.0, 1.0, 0.08, 0.04, *[1.0] * 7, 30.0, 0.5])
RATE_LIMIT = torch.tensor([1.5, 0.9, 0.0419, 0.0236])  # m, m, rad, rad: an action of 1
SETTLED, HELD_OUT = 0.05, 1_000_000


class Policy(nn.Module):
    """Gaussian policy, and value of an observation."""

    def __init__(self) -> None:
        super().__init__()
        self.mean = nn.Sequential(nn.Linear(17, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 4))
        self.value = nn.Sequential(nn.Linear(17, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))
        self.log_std = nn.Parameter(torch.full((4,), -1.0))
        with torch.no_grad():
            self.mean[-1].weight.mul_(0.1)

    def forward(self, seen: Tensor) -> tuple[torch.distributions.Normal, Tensor]:
        x = (seen - CENTRE) / SCALE
        return torch.distributions.Normal(self.mean(x), self.log_std.exp()), self.value(x)[..., 0]


def roads(first: int, last: int, every: int, steps: int, action: str = "moves") -> luxloop.RandomisedVector:
    """Copies on a mixed road; new bumps and roughness are drawn after `every` episodes."""
    copies = luxloop.make_vec("snowflake", COPIES, *WORLD, f"steps={steps}", action=action, autoreset_mode="Disabled")
    return luxloop.RandomisedVector(copies, [f"road.seed={first}:{last}"], every)


def starts(generator: torch.Generator) -> np.ndarray:
    return (STARTS[0] + (STARTS[1] - STARTS[0]) * torch.rand(COPIES, 4, generator=generator)).numpy()


def begin_worker() -> None:
    global env
    torch.set_num_threads(1)
    env = roads(1, HELD_OUT - 1, 4, STEPS)


def tried(weights: dict[str, Tensor], seed: int) -> dict[str, Tensor]:
    """One episode of all copies with the current policy: observations, actions, their log-probabilities, advantages and returns."""
    policy, generator = Policy(), torch.Generator().manual_seed(seed)
    policy.load_state_dict(weights)
    torch.manual_seed(seed)
    seen, _ = env.reset(seed=seed if tried.first else None, options={"start": starts(generator)})
    tried.first, rows = False, []
    with torch.no_grad():
        for _ in range(STEPS):
            now = torch.from_numpy(seen)
            actions, value = policy(now)
            action = actions.sample()
            seen, reward, _, _, _ = env.step(action.numpy())
            rows.append((now, action, actions.log_prob(action).sum(-1), value, torch.from_numpy(reward).float()))
        last = policy(torch.from_numpy(seen))[1]
    now, action, log_prob, value, reward = (torch.stack(column) for column in zip(*rows, strict=True))
    error, advantage, ahead = torch.zeros(COPIES), torch.zeros_like(reward), torch.cat([value[1:], last[None]])
    for k in reversed(range(STEPS)):
        error = reward[k] + GAMMA * ahead[k] - value[k] + GAMMA * LAMBDA * error
        advantage[k] = error
    return {"seen": now, "action": action, "log_prob": log_prob, "advantage": advantage, "return": advantage + value, "reward": reward}


tried.first = True


def learn(policy: Policy, adam: torch.optim.Optimizer, episodes: list[dict[str, Tensor]]) -> None:
    """PPO's clipped objective (Schulman et al. 2017), squared error of the value, and an entropy bonus."""
    data = {key: torch.cat([each[key].flatten(0, 1) for each in episodes]) for key in episodes[0]}
    data["advantage"] = (data["advantage"] - data["advantage"].mean()) / data["advantage"].std()
    for _ in range(EPOCHS):
        for part in torch.randperm(len(data["seen"])).split(BATCH):
            actions, value = policy(data["seen"][part])
            ratio = (actions.log_prob(data["action"][part]).sum(-1) - data["log_prob"][part]).exp()
            advantage = data["advantage"][part]
            gain = torch.minimum(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
            loss = -gain + 0.5 * (value - data["return"][part]).square().mean() - 1e-3 * actions.entropy().mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
            adam.step()


def evaluated(act: Callable[[Tensor], Tensor], worlds: int, action: str = "moves") -> tuple[np.ndarray, np.ndarray]:
    """IoU and distance of the centroids in symbol sizes, `[steps, worlds * copies]`, on roads not used in training."""
    held_out = roads(HELD_OUT, 2 * HELD_OUT, 1, EVALUATED_STEPS, action)
    iou, away = [], []
    for world in range(worlds):
        seen, _ = held_out.reset(seed=world, options={"start": starts(torch.Generator().manual_seed(world))})
        for _ in range(EVALUATED_STEPS):
            with torch.no_grad():
                seen, _, _, _, info = held_out.step(act(torch.from_numpy(seen)).numpy())
            iou.append(info["verdict"]["iou"])
            away.append(np.linalg.norm(np.nan_to_num(info["verdict"]["centroid_percent"], nan=100.0), axis=-1) / 100)
    shape = worlds, EVALUATED_STEPS, COPIES
    return tuple(np.reshape(each, shape).swapaxes(0, 1).reshape(EVALUATED_STEPS, -1) for each in (iou, away))


def blind(seen: Tensor) -> Tensor:
    """Straight to the target without feedback, which is right on a flat road."""
    return ((CENTRE[:4] - seen[:, :4]) / RATE_LIMIT).clamp(-1, 1)


def settled(away: np.ndarray) -> np.ndarray:
    """The step from which on the centroid stays within 5 % of the symbol, the number of steps where it does not."""
    return EVALUATED_STEPS - (np.cumprod(away[::-1] < SETTLED, 0)).sum(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--worlds", type=int, default=6, help="roads for the comparison")
    parser.add_argument("--out", type=Path, default=Path("learned.pt"))
    given = parser.parse_args()
    torch.manual_seed(0)
    policy, began, curve = Policy(), time.monotonic(), []
    adam = torch.optim.Adam(policy.parameters(), RATE)
    with ProcessPoolExecutor(WORKERS, get_context("spawn"), begin_worker) as pool:
        while not curve or time.monotonic() - began < 60 * given.minutes:
            seeds = (WORKERS * len(curve) + k for k in range(WORKERS))
            episodes = list(pool.map(tried, [policy.state_dict()] * WORKERS, seeds))
            learn(policy, adam, episodes)
            curve.append((time.monotonic() - began, float(torch.stack([each["reward"] for each in episodes]).mean())))
            print(f"{curve[-1][0]:5.0f} s  episode {WORKERS * COPIES * len(curve):6d}  mean reward {curve[-1][1]:+.3f}", flush=True)
    torch.save(policy.state_dict(), given.out)
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    left.plot(*np.transpose(curve))
    left.set(xlabel="time of learning, s", ylabel="mean reward of a step")
    ways = {
        "thesis_pid": (lambda seen: torch.zeros(len(seen), 6), "gains"),  # whose gains stay as they are
        "blind": (blind, "moves"),
        "learned": (lambda seen: policy(seen)[0].mean, "moves"),
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
