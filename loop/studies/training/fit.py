"""Fit the network to examples."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from luxloop.loop.studies.training.examples import Examples
from luxloop.loop.studies.training.scenes import CLASSES
from luxloop.perception.detection.network import Network, boxes_of, network_input

BATCH = 8  # scenes, each in two lights
RATE = 4e-3
BOX_WEIGHT, AGREE_WEIGHT = 2.0, 0.5
RARE = 0.02  # initial score of the network: share of cells with an object


def fit(rows: Sequence[dict[str, Any]], steps: int, seed: int, on_step: Callable[[float], None]) -> Network:
    """Train a network on `steps` batches; returns it ready to detect, with the mean of its late weights. on_step: called with the loss.

    rows: of scenes, as `luxloop.loop.studies.training.scenes.draw` gives them.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = Network(len(CLASSES))
    network.expect(RARE)
    network.train()
    averaged = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(min(0.99, 1 - 10 / (steps + 10))), use_buffers=True)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps, pct_start=0.15)
    with ThreadPoolExecutor(1) as ahead:  # a second core draws the next examples meanwhile
        coming = ahead.submit(Examples.draw, rows, BATCH, rng)
        for _ in range(steps):
            examples, coming = coming.result(), ahead.submit(Examples.draw, rows, BATCH, rng)
            # half the precision and twice the speed on processors that support it
            with torch.autocast("cpu", torch.bfloat16):
                logits, sides = network(network_input(examples.frames))
            logits = logits.float()
            loss = (
                heat_loss(logits, examples) + BOX_WEIGHT * box_loss(sides.float(), examples) + AGREE_WEIGHT * agree_loss(logits, examples)
            )
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
            optimiser.step()
            schedule.step()
            averaged.update_parameters(network)
            on_step(float(loss.detach()))
    network.load_state_dict(averaged.module.state_dict())
    return network.eval()


def heat_loss(logits: Tensor, examples: Examples) -> Tensor:
    """Focal loss per object, reduced near centres (Law & Deng 2018)."""
    p = logits.sigmoid().clamp(1e-4, 1 - 1e-4)
    there = examples.heat == 1
    hit = (1 - p).square() * p.log() * there
    false = p.square() * (1 - p).log() * (1 - examples.heat) ** 4 * examples.counts * ~there
    return -(hit + false).sum() / there.sum().clamp(min=1)


def agree_loss(logits: Tensor, examples: Examples) -> Tensor:
    """Loss per object that is well lit in both lights: by how much its logits in object-based light are below those in full light, which
    are fixed.
    """
    own = logits.gather(1, examples.heat.argmax(1, keepdim=True))[:, 0]
    (full, alone), (share_full, share_alone) = own.chunk(2), examples.share.chunk(2)
    share = torch.minimum(share_full, share_alone)
    lost = (full.detach() - alone).clamp(min=0)
    return (share * smooth_l1_loss(lost, torch.zeros_like(lost), reduction="none", beta=0.5)).sum() / share.sum().clamp(min=1)


def box_loss(sides: Tensor, examples: Examples) -> Tensor:
    """1 - generalised IoU (Rezatofighi et al. 2019), per object."""
    found, truth = boxes_of(sides), examples.boxes
    low, high = torch.maximum(found[:, :2], truth[:, :2]), torch.minimum(found[:, 2:], truth[:, 2:])
    both = (high - low).clamp(min=0).prod(1)
    areas = (found[:, 2:] - found[:, :2]).prod(1) + (truth[:, 2:] - truth[:, :2]).prod(1)
    hull = (torch.maximum(found[:, 2:], truth[:, 2:]) - torch.minimum(found[:, :2], truth[:, :2])).prod(1)
    union = (areas - both).clamp(min=1e-6)
    return (examples.share * (2 - both / union - union / hull.clamp(min=1e-6))).sum() / examples.share.sum().clamp(min=1)
