"""Between the world, the ground frame that drives with the car, and the car's body."""

import math

import torch
from torch import Tensor

from luxloop.perception.egomotion import Ego
from luxloop.world.frames import inverse, transform
from luxloop.world.scene.scene import StreetLamp


def attitude(ego: Ego | None) -> Tensor:
    """Pose `[4, 4]` of the body in the ground frame, as measured; level where nothing is."""
    if ego is None or math.isnan(ego.attitude_s):
        return torch.eye(4, dtype=torch.float64)
    return ego.at(ego.time_s).T_ground_body.double().cpu()


def moved(T_ground_body: Tensor, T_body_module: Tensor) -> Tensor:
    """Pose `[4, 4]` of a module in the ground frame."""
    return T_ground_body.to(T_body_module) @ T_body_module


def seen_from(T_world_ground: Tensor, lamp: StreetLamp) -> StreetLamp:
    """A street lamp in the ground frame."""
    x, y, z = transform(inverse(T_world_ground), torch.tensor(lamp.position_m, dtype=torch.float64)[:, None])[:, 0].tolist()
    return lamp.model_copy(update={"position_m": (x, y, z)})
