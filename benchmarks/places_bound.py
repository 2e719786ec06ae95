"""What lamp and camera allow at a place: the symbol drawn for the true road, by a ray a texel."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projector import DrawingModule
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.copies import Lights
from luxloop.perception.birdseye import rectify
from luxloop.perception.metrics import THRESHOLD
from luxloop.world.rendering.raycast import depths, first_hits
from luxloop.world.scene.triangles import Triangles

SOME = 4  # along and across, one of so many texels tells where the symbol's light goes
OFF = 9.0  # a place that is not on the symbol, which lies from -1 to 1


@dataclass(frozen=True)
class Bound:
    """lights: utilisations, one a module that draws the symbol. iou: of the judge. visible: share of the target's cells in the judge's
    plane that they light."""

    lights: Lights
    iou: float
    visible: float


def bound(simulation: Simulation) -> Bound:
    """The symbol as an appearance that this lamp and camera can have on the true road of a standing world; its value is a share, u_abs.

    A texel takes what of the symbol lies where the camera sees its light on the plane z = 0, a pixel the mean of its texels weighted by
    its light: `u = A^T s / A^T 1`.
    """
    world = simulation.world
    triangles = world.scene.at(0.0, world.motion.at(0.0).T_world_ground)
    lights = tuple(_drawn(simulation, triangles, module) for module in simulation.symbol.projector.modules)
    judge, all_lights = simulation.symbol.judge, simulation.of_all(simulation.symbol, lights)
    lit = rectify(judge.plane, world.lit(0.0).luminance(all_lights)) > THRESHOLD * judge.goal.median
    visible = (lit & judge.goal.mask).sum() / judge.goal.mask.sum()
    return Bound(lights, judge.verdict(all_lights, 0.0).iou.item(), visible.item())


def _drawn(simulation: Simulation, triangles: Triangles, module: DrawingModule) -> Utilisation:
    headlight = module.pixel_controller.headlight
    rows, cols = headlight.rows, headlight.cols
    some, every = (headlight.view(module.T_world_headlight, cols // n, rows // n) for n in (SOME, 1))
    inside = (_behind(simulation, triangles, some.origin, some.rays().flatten(1)).abs() <= 1).all(-1).view(some.height, some.width)
    near_row, near_col = (_spread(inside.any(axis), n) for axis, n in ((1, rows), (0, cols)))
    near = near_row[:, None] & near_col
    where = _behind(simulation, triangles, every.origin, every.rays()[:, near])
    symbol = torch.zeros(rows, cols, dtype=torch.float64)
    symbol[near] = grid_sample(simulation.symbol.projector.symbol.double()[None, None], where[None, None], align_corners=False)[0, 0, 0]
    matrix = headlight.matrix.to_scipy()
    share = (matrix.T @ symbol.flatten().numpy()) / (matrix.T @ np.ones(rows * cols)).clip(1e-12)
    value = simulation.scenario.symbol.value / len(simulation.symbol.projector.modules)
    return Utilisation(torch.from_numpy(value * share).float())  # without a band, outside of which light would be hidden


def _spread(some: Tensor, n: int) -> Tensor:
    """Which of n texels `[n]` lie in or beside the marked ones of fewer and larger `[m]`."""
    beside = torch.nn.functional.max_pool1d(some[None].float(), 3, 1, 1)[0] > 0
    return beside[torch.arange(n) * len(some) // n]


def _behind(simulation: Simulation, triangles: Triangles, origin: Tensor, rays: Tensor) -> Tensor:
    """Where on the symbol `[N, 2]` (right and down, -1 to 1 over it) the camera sees light of rays `[3, N]` from a place `[3]` m.

    Light on the true road is seen on the plane z = 0 behind it; far off the symbol where a ray or the line of sight meets nothing.
    """
    params, eye = simulation.scenario.symbol, simulation.world.view.origin[:, None]
    face = first_hits(triangles, origin, rays)
    met = face >= 0
    road = origin[:, None] + rays[:, met] * depths(triangles, face[met], origin, rays[:, met])
    down = eye[2] - road[2]
    x, y = (road if params.target == "place" else eye + (road - eye) * eye[2] / down)[:2]
    on_symbol = torch.stack([2 * (params.y_m - y) / params.width_m, 2 * (params.x_m - x) / params.length_m], -1)
    where = torch.full((rays.shape[1], 2), OFF, dtype=torch.float64)
    where[met] = torch.where((down > 0)[:, None], on_symbol, OFF)
    return where
