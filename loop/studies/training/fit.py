"""Training of the network on parts of scenes, each in full and in object-based light."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate, smooth_l1_loss
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from luxloop.loop.studies.training.light import WELL_LIT_LX, all_light, full_light, lit_share, luminance, object_light
from luxloop.loop.studies.training.scenes import CAMERA, CLASSES, DarkScene, Row, read
from luxloop.perception.camera import expose
from luxloop.perception.detection.network import STRIDE, Network, boxes_of, middles, network_input
from luxloop.perception.noise import FrameNoise

SIZE = (256, 384)  # rows, columns of an example
LEAST_HEIGHT_PX, LEAST_VISIBLE, LEAST_INSIDE = 16, 0.35, 0.4  # least values of required objects; others are optional
LEAST_LIT = 0.15  # least well-lit share of a required object's visible part
UNSEEN_LX = 0.12  # from all light; an object is absent if less than LEAST_LIT of it is brighter
SPREAD = 0.09  # standard deviation of the heat around a middle, as a share of the box


@dataclass(frozen=True)
class Examples:
    """Examples: B scenes in full light, and the same B in object-based light.

    frames: `[2 B, height, width]` in 0..1. heat: `[2 B, C, rows, columns]`, 1 in the middles of required objects. counts: `[2 B, C, rows,
    columns]`, 0 at optional objects. boxes: `[2 B, 4, rows, columns]` px, of each cell's object. share: `[2 B, rows, columns]`, weight of
    the cell for its object, 1 in sum.
    """

    frames: Tensor
    heat: Tensor
    counts: Tensor
    boxes: Tensor
    share: Tensor

    @classmethod
    def draw(cls, rows: Sequence[Row], number: int, rng: np.random.Generator, wide: bool = False) -> "Examples":
        """Random examples, each from one or two of the scenes that `draw` returned as rows. wide: of random aspect, with lit clutter."""
        full, alone = zip(*(_pair(rows, rng, wide) for _ in range(number)), strict=True)
        return cls(*(torch.stack(each) for each in zip(*full + alone, strict=True)))


def _pair(rows: Sequence[Row], rng: np.random.Generator, wide: bool) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Example of one scene in full light, and in object-based light."""
    scene = _scene(rows, rng, wide)
    scene = replace(scene, ambient_lx=scene.ambient_lx * float(np.exp(rng.normal(0, 1))))
    exposure = float(np.exp(rng.uniform(-0.25, 0.25)))
    return example(scene, full_light(scene, rng), exposure, rng), example(scene, object_light(scene, rng, wide), exposure, rng)


def example(scene: DarkScene, light: Tensor, exposure: float, rng: np.random.Generator) -> tuple[Tensor, ...]:
    """Frame, heat, counts, boxes and share as of `Examples`. light: headlamps' illuminance `[height, width]` lx."""
    bright = luminance(scene, light)
    frame = interpolate(exposure * bright[None, None], SIZE, mode="bilinear", antialias=True, align_corners=False)[0, 0]
    frame = expose(frame, CAMERA, FrameNoise(int(rng.integers(2**62)))) / (2**CAMERA.bits - 1)
    to_frame = torch.tensor([SIZE[1] / scene.shape[1], SIZE[0] / scene.shape[0]]).repeat(2)
    seen = lit_share(scene, all_light(scene, bright), UNSEEN_LX) >= LEAST_LIT
    must = lit_share(scene, light, WELL_LIT_LX) >= LEAST_LIT
    boxes = torch.tensor([each.box for each in scene.objects]).view(-1, 4) * to_frame
    must &= torch.tensor([each.visible >= LEAST_VISIBLE and each.inside >= LEAST_INSIDE for each in scene.objects]).bool()
    must &= boxes[:, 3] - boxes[:, 1] >= LEAST_HEIGHT_PX
    return frame, *targets(boxes[seen], torch.tensor([each.label for each in scene.objects]).long()[seen], must[seen])


def _scene(rows: Sequence[Row], rng: np.random.Generator, wide: bool) -> DarkScene:
    """Random part of a scene, of random size, half of them with the objects of another scene."""
    scale, aspect = float(np.exp(rng.uniform(-0.3, 0.35))), float(np.exp(rng.uniform(-0.15, 0.15))) if wide else 1.0
    height, width = min(round(SIZE[0] / (scale * aspect)), CAMERA.height_px), min(round(SIZE[1] * aspect / scale), CAMERA.width_px)
    top = int(rng.integers(CAMERA.height_px - height + 1))

    def part() -> DarkScene:
        row = rows[int(rng.integers(len(rows)))]
        middle = float(rng.uniform(0, CAMERA.width_px))
        if row["objects"] and rng.random() < 0.7:
            box = row["objects"][int(rng.integers(len(row["objects"])))]["box"]
            middle = (box[0] + box[2]) / 2 + float(rng.normal(0, 0.25 * width))
        left = int(np.clip(middle - width / 2, 0, CAMERA.width_px - width))
        scene = read(row, slice(top, top + height), slice(left, left + width))
        return scene.mirror() if rng.random() < 0.5 else scene

    scene = part()
    return scene.behind(part()) if rng.random() < 0.5 else scene


def targets(boxes: Tensor, labels: Tensor, must: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Heat, counts, boxes and share as of `Examples`, from boxes `[n, 4]` px, their labels `[n]`, and which are required `[n]`."""
    rows, columns = SIZE[0] // STRIDE, SIZE[1] // STRIDE
    at = middles(rows, columns, boxes.device)
    x, y = at[0], at[1]
    left, top, right, bottom = boxes[:, :, None, None].unbind(1)
    inside = (x > left - STRIDE) & (x < right + STRIDE) & (y > top - STRIDE) & (y < bottom + STRIDE)
    counts = (~(inside & ~must[:, None, None])).all(0).float().expand(len(CLASSES), -1, -1)
    # at the cell's middle, so that the heat is 1 there
    middle = (torch.stack([left + right, top + bottom]) / 2 / STRIDE).floor().mul(STRIDE).add(STRIDE / 2)
    width, height = (SPREAD * side.clamp(min=STRIDE / SPREAD / 2) for side in (right - left, bottom - top))
    near = (-0.5 * (((x - middle[0]) / width) ** 2 + ((y - middle[1]) / height) ** 2)).exp() * must[:, None, None]
    heat = torch.zeros(len(CLASSES), rows, columns)
    for label in range(len(CLASSES)):
        of_class = near[labels == label]
        heat[label] = of_class.amax(0) if len(of_class) else 0
    if not len(boxes):
        return heat, counts, torch.zeros(4, rows, columns), torch.zeros(rows, columns)
    small_first = torch.where(near > 0.2, 1 / ((right - left) * (bottom - top)), 0)
    owner = small_first.argmax(0)
    owned = near.gather(0, owner[None])[0] * (small_first.amax(0) > 0)
    total = torch.zeros(len(boxes)).index_add(0, owner.flatten(), owned.flatten())
    return heat, counts, boxes[owner].permute(2, 0, 1), owned / total[owner].clamp(min=1e-6)


BATCH = 8  # scenes, each in two lights
RATE, TUNING_RATE = 4e-3, 1e-3  # greatest learning rates of a new network, and of one that has learnt the first population
BOX_WEIGHT, AGREE_WEIGHT = 2.0, 0.5
RARE = 0.02  # initial score of the network: share of cells with an object


def fit(rows: Sequence[Row], steps: int, seed: int, on_step: Callable[[float], None], start: Network | None = None) -> Network:
    """Network trained on `steps` batches, ready to detect, with the mean of its late weights. on_step: called with the loss.

    rows: of scenes, from `luxloop.loop.studies.training.scenes.draw`. start: a network to go on from, with wide scenes.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network, rate, wide = Network(len(CLASSES)), RATE, start is not None
    network.expect(RARE)
    if start is not None:
        network.load_state_dict(start.state_dict())
        rate = TUNING_RATE
    network.train()
    averaged = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(min(0.99, 1 - 10 / (steps + 10))), use_buffers=True)
    optimiser = torch.optim.AdamW(network.parameters(), rate, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps, pct_start=0.15)
    with ThreadPoolExecutor(1) as ahead:  # a second core draws the next examples
        coming = ahead.submit(Examples.draw, rows, BATCH, rng, wide)
        for _ in range(steps):
            examples, coming = coming.result(), ahead.submit(Examples.draw, rows, BATCH, rng, wide)
            # half the precision: twice the speed with AVX-512, a seventh without
            with torch.autocast("cpu", torch.bfloat16, enabled=torch.backends.cpu.get_cpu_capability() == "AVX512"):
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
    """Loss per object that is well lit in both lights: shortfall of its logits in object-based light against those in full light, held
    fixed.
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
