"""Process times of several steps in turn, and what the memory gives at best."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

COPY_MB = 256

Step = Callable[[], Any]


def interleaved(steps: dict[str, Step], rounds: int) -> dict[str, dict[str, float]]:
    """Process time in ms of each, in turn. A call that does not count comes before each, so that none finds another's data cached."""
    taken: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            step()
            before = time.process_time_ns()
            step()
            taken[name].append(1e-6 * (time.process_time_ns() - before))
    return {name: statistics(times) for name, times in taken.items()}


def statistics(times: list[float]) -> dict[str, float]:
    low, median, high = np.quantile(times, [0.05, 0.5, 0.95]).tolist()
    return {"min": min(times), "q05": low, "median": median, "q95": high}


class Copy:
    """256 MB from here to there: what the memory gives at best, reading and writing counted."""

    def __init__(self, device: torch.device, quick: bool) -> None:
        self.source = torch.rand(2**18 * (16 if quick else COPY_MB), device=device)
        self.target = torch.empty_like(self.source)
        self.bytes = 2 * self.source.nbytes

    def __call__(self) -> None:
        self.target.copy_(self.source)
