"""A scene as runs have found it: how far off the symbol is seen at poses shown, from which runs with other gains are predicted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from controllers.symbol.sensing.observer import Seen
from loop.lighting.batch import Rollout, loops
from loop.lighting.simulation import Simulation
from loop.recording.summary import FINAL
from perception.extraction import Loss

NEAR = 0.02  # of the symbol's size: about how far off a symbol may be that has settled


def near(simulation: Simulation) -> Tensor:
    """Errors `[4]` in x, y (m), roll and pitch (rad) of a symbol that is about as near as a settled one has to stay
    (`loop.recording.summary`).

    A turn of the primitive by a share of the angle at which the lamp meets the road shears or stretches the symbol by that share.
    """
    symbol = simulation.scenario.symbol
    grazing = simulation.scenario.headlight.height_m / symbol.x_m
    return NEAR * torch.tensor([symbol.length_m, symbol.width_m, grazing, grazing], device=simulation.device)


@dataclass(frozen=True)
class Learned:
    """poses, offsets: `[n, 4]`, where the symbol was shown, and how much more than its pose its error was. An error is divided by its plant
    gain, so that this is much the same everywhere, but for what the road does. noise: `[4]`, standard deviation of the errors."""

    poses: Tensor
    offsets: Tensor
    noise: Tensor

    @classmethod
    def of(cls, runs: Sequence[Rollout], late: int) -> "Learned":
        """From runs whose frames come so many steps late, of which one has seen the symbol."""
        poses, offsets = [], []
        for each in runs:
            seen, shown = each.seen[0, late:], each.poses[0, : each.poses.shape[1] - late]
            poses.append(shown[seen])
            offsets.append((each.errors[0, late:] - shown)[seen])
        most = max(len(each) for each in offsets)  # a run that has seen little knows nothing of noise
        noise = torch.stack([each[-FINAL:].std(0, correction=0) for each in offsets if len(each) >= min(most, FINAL)]).amin(0)
        return cls(torch.cat(poses), torch.cat(offsets), noise)

    def predicted(self, simulation: Simulation, values: dict[str, Tensor], noise: Tensor) -> Rollout:
        """Runs with gains, values `[B]`; noise: `[steps, B, 4]`, standard normal. Differentiable in the gains, and without any light."""
        apart = near(simulation)

        def looked(poses: Tensor, step: int) -> Seen:
            squares = ((poses[:, None] - self.poses) / apart).square().sum(-1)
            weights = (squares + 1.0) ** -2
            offsets = (weights / weights.sum(-1, keepdim=True)) @ self.offsets
            return replace(simulation.symbol.observer.lost(poses, Loss.SEEN), pose_error=poses + offsets + self.noise * noise[step])

        return loops(simulation, values, looked)
