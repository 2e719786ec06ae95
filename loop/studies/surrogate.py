"""A surrogate of a scene: the symbol's errors at shown poses, learnt from runs, to predict runs with other gains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.recording.summary import FINAL
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.rollouts import loops
from luxloop.perception.extraction import ExtractionStatus

NEAR = 0.02  # of the symbol's size: approximate error of a settled symbol


def near(simulation: Simulation) -> Tensor:
    """Errors `[4]` in x, y (m), roll and pitch (rad) of a symbol at the limit of being settled (`luxloop.loop.recording.summary`).

    A rotation of the primitive by a share of the lamp's grazing angle at the road shears or stretches the symbol by that share.
    """
    symbol = simulation.scenario.symbol
    grazing = simulation.scenario.headlight.height_m / symbol.x_m
    return NEAR * torch.tensor([symbol.length_m, symbol.width_m, grazing, grazing], device=simulation.device)


@dataclass(frozen=True)
class Learned:
    """The surrogate. poses, offsets: `[n, 4]`, poses shown, and the symbol's errors less these poses. Errors are divided by their plant
    gains, so that offsets vary only with the road. noise: `[4]`, standard deviation of the errors.
    """

    poses: Tensor
    offsets: Tensor
    noise: Tensor

    @classmethod
    def of(cls, runs: Sequence[Rollout], late: int) -> "Learned":
        """Learn from runs whose frames are `late` steps late; at least one must have seen the symbol."""
        poses, offsets = [], []
        for each in runs:
            seen, shown = each.seen[0, late:], each.poses[0, : each.poses.shape[1] - late]
            poses.append(shown[seen])
            offsets.append((each.errors[0, late:] - shown)[seen])
        most = max(len(each) for each in offsets)  # a run with few measurements does not show the noise
        noise = torch.stack([each[-FINAL:].std(0, correction=0) for each in offsets if len(each) >= min(most, FINAL)]).amin(0)
        return cls(torch.cat(poses), torch.cat(offsets), noise)

    def predicted(self, simulation: Simulation, values: dict[str, Tensor], noise: Tensor) -> Rollout:
        """Predicted runs. values: gains `[B]` by key. noise: `[steps, B, 4]`, standard normal. Differentiable in the gains; nothing is
        rendered.
        """
        apart = near(simulation)

        def looked(poses: Tensor, step: int) -> Measurement:
            squares = ((poses[:, None] - self.poses) / apart).square().sum(-1)
            weights = (squares + 1.0) ** -2
            offsets = (weights / weights.sum(-1, keepdim=True)) @ self.offsets
            return replace(
                simulation.symbol.sensor.lost(poses, ExtractionStatus.SEEN), pose_error=poses + offsets + self.noise * noise[step]
            )

        return loops(simulation, values, looked)
