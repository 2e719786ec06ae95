"""Situations of lighting functions: a car that stands at the origin, two lamps, and others on the road."""

import torch
from torch import Tensor

from luxloop.controllers.geometry import cuboid
from luxloop.controllers.situation import Situation, TrackedObject
from luxloop.world.frames import pose_from_degrees

HERE = torch.eye(4, dtype=torch.float64)
LAMPS = torch.tensor([[0.0, 0.6, 0.75], [0.0, -0.6, 0.75]], dtype=torch.float64)


def car(x: float, y: float, yaw_deg: float = 180.0, **times: float) -> TrackedObject:
    return TrackedObject("car", "car", pose_from_degrees((x, y, 0.0), yaw_deg=yaw_deg), (4.5, 1.8, 1.5), **times)


def now(*objects: TrackedObject, time_s: float = 0.0, **more: object) -> Situation:
    return Situation(time_s, HERE, LAMPS, objects, **more)


def surface(each: TrackedObject, low: float = 0.0, high: float = 1.0, n: int = 15) -> Tensor:
    """Points `[3, N]` m all over the box, corners and edges among them, from one share of its height to another."""
    length, width, height = each.size_m
    bounds = torch.tensor([[-length / 2, -width / 2, low * height], [length / 2, width / 2, high * height]], dtype=torch.float64)
    origin, d1, d2 = cuboid(each.T_world_object, bounds[0], bounds[1])
    s = torch.linspace(0, 1, n, dtype=torch.float64)
    return (origin[:, None, None] + s[:, None, None] * d1[:, None, None] + s[:, None] * d2[:, None, None]).reshape(-1, 3).T
