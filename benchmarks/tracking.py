"""How well identities are kept: `python benchmarks/tracking.py` prints tables for docs/object_based.md.

Made-up boxes are as noisy and missing as a detector's.
"""

from argparse import Namespace
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import torch
from bench import run, show
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from luxloop import Detections
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.detection.detector import SAME, overlaps
from luxloop.perception.tracking import Tracker, TrackerParams
from luxloop.world.traffic.tracked import Category

CLASSES = ("pedestrian", "cyclist", "car", "animal")
CAMERA = {"width_px": 640, "height_px": 360, "hfov_deg": 30.0, "pitch_deg": 1.5, "oversampling": 1, "saturation_e": 2000.0}
VIEW = camera_view(CameraParams.model_validate(CAMERA))
RATE_HZ = 30.0
TRACKER = Tracker(CLASSES, VIEW, TrackerParams())
SIZES = {"pedestrian": (0.6, 1.75), "cyclist": (0.7, 1.8), "car": (1.8, 1.5)}
EDGES = torch.tensor([VIEW.width, VIEW.height] * 2).double()
NOISE, MISSES, HIDDEN = 0.04, 0.1, 0.6  # of a box's size, of frames, and the share of a box behind another from which on it is not found
Road = Callable[[float], tuple[Category, float, float]]  # class, x and y in m at a time


class Identities:
    """Who is followed how, as for CLEAR MOT (Bernardin & Stiefelhagen 2008): an object's track stays its own while it overlaps.

    numbers: of the tracks that showed each object, by name. seen, missed: frames of objects in sight, and of those without a track; false:
    of tracks that show nobody; switches: frames in which an object's track is another than before.
    """

    def __init__(self) -> None:
        self.numbers, self.owner = defaultdict(set), {}
        self.seen = self.missed = self.false = self.switches = 0

    def look(self, names: Sequence[Hashable], true: Tensor, visible: Sequence[bool], boxes: Tensor, numbers: Sequence[int]) -> None:
        """A frame. true: `[n, 4]` px of all objects, in the order of their names; visible: which of them are in sight."""
        shares, present = overlaps(true, boxes), torch.tensor(visible, dtype=torch.bool)
        usable = torch.where(present[:, None], shares, 0.0)
        for n, name in enumerate(names):
            if self.owner.get(name) in numbers and usable[n, numbers.index(self.owner[name])] > SAME:
                usable[n, numbers.index(self.owner[name])] += 2
        pairs = [(names[n], numbers[j]) for n, j in zip(*linear_sum_assignment(-usable), strict=True) if usable[n, j] > SAME]
        for name, number in pairs:
            self.switches += number != self.owner.get(name, number)
            self.owner[name] = number
            self.numbers[name].add(number)
        self.seen += int(present.sum())
        self.missed += int(present.sum()) - len(pairs)
        self.false += int((shares.amax(0) <= SAME).sum()) if len(true) else len(numbers)

    def counts(self) -> dict[str, Any]:
        several = sum(len(numbers) > 1 for numbers in self.numbers.values())
        own = {name: getattr(self, name) for name in ("seen", "missed", "false", "switches")}
        return own | {"several": several, "mota": 1 - (self.missed + self.false + self.switches) / max(self.seen, 1)}


def seen(objects: list[tuple[Category, float, float]]) -> tuple[Tensor, list[bool]]:
    """Boxes `[n, 4]` px of upright plates on the road, as far as in the image, and which are hidden behind nearer ones or outside."""
    plates = []
    for category, x, y in objects:
        width, height = SIZES[category]
        plates.append(torch.tensor([[x, y + width / 2, height], [x, y - width / 2, 0.0]], dtype=torch.float64).T)
    boxes = torch.stack([VIEW.project(corners)[0].T.flatten() for corners in plates])
    low, high = torch.maximum(boxes[:, None, :2], boxes[None, :, :2]), torch.minimum(boxes[:, None, 2:], boxes[None, :, 2:])
    covered = (high - low).clamp(min=0).prod(-1) / (boxes[:, 2:] - boxes[:, :2]).prod(-1)[:, None]
    away = torch.tensor([each[1] for each in objects])
    inside = torch.minimum(boxes.clamp(min=0), EDGES)
    outside = (inside[:, 2:] - inside[:, :2]).prod(-1) < (1 - HIDDEN) * (boxes[:, 2:] - boxes[:, :2]).prod(-1)
    return inside, (((covered > HIDDEN) & (away[None] < away[:, None])).any(-1) | outside).tolist()


def follow(roads: list[Road], frames: int, seed: int) -> Identities:
    """Made-up traffic, tracked."""
    rng = torch.Generator().manual_seed(seed)
    tracks, found = TRACKER.start(), Identities()
    for k in range(frames):
        objects = [road(k / RATE_HZ) for road in roads]
        true, hidden = seen(objects)
        size = (true[:, 2:] - true[:, :2]).prod(-1, keepdim=True).sqrt()
        noise = NOISE * size * torch.randn(true.shape, generator=rng, dtype=torch.float64)
        boxes = torch.where((true <= 0) | (true >= EDGES), true, true + noise)
        shown = ~torch.tensor(hidden) & (torch.rand(len(roads), generator=rng) > MISSES)
        scores = 0.1 * torch.rand(len(roads), len(CLASSES), generator=rng, dtype=torch.float64)
        for n, (category, _, _) in enumerate(objects):
            scores[n, CLASSES.index(category)] = 0.6 + 0.4 * float(torch.rand(1, generator=rng))
        tracks = TRACKER.step(tracks, Detections(boxes[shown], scores[shown]), k / RATE_HZ)
        visible, present = [not each for each in hidden], tracks.present
        found.look(range(len(roads)), true, visible, TRACKER.boxes(present), present.number.tolist())
    return found


def straight(category: Category, x: float, y: float, vx: float, vy: float) -> Road:
    return lambda t: (category, x + vx * t, y + vy * t)


def crowd(people: int, seed: int) -> list[Road]:
    """Pedestrians who walk to and fro between 10 and 30 m, within the view."""
    rng = np.random.default_rng(seed)

    def walker() -> Road:
        x, wide, phase, way = rng.uniform(10, 30), rng.uniform(0.5, 2.5), rng.uniform(0, 1), rng.uniform(0.8, 1.8)
        return lambda t: ("pedestrian", x, wide * (4 * abs((phase + way * t / (4 * wide)) % 1 - 0.5) - 1))

    return [walker() for _ in range(people)]


def summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A row of the table, of `Identities.counts`."""
    counts = pd.DataFrame(runs)
    seen, missed, switches = (int(counts[key].sum()) for key in ("seen", "missed", "switches"))
    rate, mota = 60 * RATE_HZ * switches / seen, float(counts["mota"].mean())
    return {"runs": len(runs), "switches": switches, "switches a minute": rate, "frames with a track": 1 - missed / seen, "MOTA": mota}


def measure(given: Namespace) -> dict[str, Any]:
    seeds, frames = range(given.seeds), given.frames
    found = {
        name: [follow([straight(*each) for each in objects], min(frames, 110), seed) for seed in seeds]
        for name, objects in given.scenes.items()
    }
    for people in given.crowds:
        runs = [follow(crowd(people, seed), frames, seed) for seed in seeds[: -(-len(seeds) // 2)]]
        found[f"{people} pedestrians to and fro for {frames / RATE_HZ:g} s"] = runs
    rows = {name: summary([each.counts() for each in runs]) for name, runs in found.items()}
    show("Identities", rows)
    return {"identities": rows}


if __name__ == "__main__":
    run(measure, __doc__, "seeds")
