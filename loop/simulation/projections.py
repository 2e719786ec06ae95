"""Projections on the road as the driver sees them: place, luminous intensity, contrast and stroke width."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.controllers.functions.symbol import DRIVER_M, SymbolFunctionParams
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.simulation.world import LitScene, World
from luxloop.perception.metrics import THRESHOLD
from luxloop.world.frames import View, inverse, pose, transform, unit
from luxloop.world.headlight.lamp import REST, Commands
from luxloop.world.scene.vehicle import VehiclePath

MOST_PX: Final = 1280  # larger extent of the view
LEAST_ARCMIN: Final = 0.25  # of a pixel of the view
MARGIN: Final = 1.0  # of the symbol's extent, to each side; light farther away is not looked at
NEAREST_M: Final = 1.0  # ahead of the lamps
SURROUND_ARCMIN: Final = 30.0  # width of the surround
PENUMBRA: Final = 0.05  # largest share of the symbol's light in its surround
PLACES: Final = 4000  # of a symbol at most that are looked at from the lamps


@dataclass(frozen=True)
class ProjectionMetrics:
    """A projection in one step, in light averaged over its exposures; NaN where none of it is seen.

    aside_m: largest distance from the vehicle's course. near_m, far_m: least and largest distance ahead of the lamps. cd_max: largest
    intensity of one lamp towards it. h_deg_max, v_deg_max: largest angle from a lamp to the side, and up from its horizontal plane.
    contrast: `(L - L_b) / L_b` of the mean luminances of symbol and surround, the road within 30' of it that has at most 5 % of its light
    (Weber contrast, as in Appl. Sci. 2023, 13, 2964). stroke_arcmin: mean width of its strokes as the driver sees them, four times the
    mean distance from their edges. modulation: `(L - L_g) / (L + L_g)` of the symbol's mean light on its strokes and in the gaps between
    and beside them, within its rectangle (Michelson contrast): near 1 for a sharp one, 0 for a blob; NaN for a symbol without gaps. Light
    that fills the view has neither contrast nor strokes.
    """

    aside_m: float = math.nan
    near_m: float = math.nan
    far_m: float = math.nan
    cd_max: float = math.nan
    h_deg_max: float = math.nan
    v_deg_max: float = math.nan
    contrast: float = math.nan
    stroke_arcmin: float = math.nan
    modulation: float = math.nan


def projection_metrics(  # noqa: PLR0913 (independent values)
    world: World,
    path: VehiclePath,
    symbol: SymbolFunctionParams,
    image: Tensor | None,
    time_s: float,
    lights: Sequence[Tensor],
    without: Sequence[Utilisation],
    commands: Commands = (),
) -> ProjectionMetrics:
    """Metrics of a symbol at a time.

    image: `[h, w]` that it draws, None while it draws none. lights: utilisations `[n_p]` with it, a mean over time. without: without it,
    one a module.
    """
    view = driver_view(symbol)
    seen = world.through(view, time_s)
    dark = seen.light([each.u for each in without], commands)[1] + seen.base
    luminance = seen.light(lights, commands)[1] + seen.base
    added = torch.where(seen.surfaces.object_id == 0, luminance - dark, 0.0).clamp(min=0)
    if not bool(added.any()):
        return ProjectionMetrics()
    median = added[added > THRESHOLD * added.max()].median()
    lit = added > THRESHOLD * median
    arcmin = 60 * math.degrees(1 / view.fx)
    inside = _distance_px(lit)
    surround = (_distance_px(~lit) <= SURROUND_ARCMIN / arcmin) & ~lit & (seen.surfaces.object_id == 0) & (added <= PENUMBRA * median)
    background = float(luminance[surround].mean())
    places = seen.surfaces.position[:, lit].double().cpu()
    T_ground_world = inverse(world.motion.at(time_s).T_world_ground)
    x_m = transform(T_ground_world, places)[0]
    cd, h_deg, v_deg = _from_lamps(seen, lights, commands, places[:, :: math.ceil(places.shape[1] / PLACES)])
    return ProjectionMetrics(
        aside_m=float(np.abs(path.aside_m(places[0].numpy(), places[1].numpy())).max()),
        near_m=float(x_m.min()),
        far_m=float(x_m.max()),
        cd_max=cd,
        h_deg_max=h_deg,
        v_deg_max=v_deg,
        contrast=float(luminance[lit].mean()) / background - 1 if background > 0 else math.nan,
        stroke_arcmin=4 * (float(inside[lit].mean()) - 0.5) * arcmin,  # an edge lies half a pixel from the first pixel beyond
        modulation=math.nan if image is None else _modulation(added, seen, T_ground_world, symbol, image),
    )


def _modulation(added: Tensor, seen: LitScene, T_ground_world: Tensor, symbol: SymbolFunctionParams, image: Tensor) -> float:
    """Michelson contrast of a symbol's light `[height, width]` between strokes and gaps of its image; NaN without gaps."""
    x, y, _ = transform(T_ground_world.to(added), seen.surfaces.position.flatten(1).to(added)).unflatten(1, added.shape)
    yaw = math.radians(symbol.yaw_deg)
    ahead, left = x - symbol.x_m, y - symbol.y_m
    along, across = ahead * math.cos(yaw) + left * math.sin(yaw), left * math.cos(yaw) - ahead * math.sin(yaw)
    uv = torch.stack([-2 * across / symbol.width_m, -2 * along / symbol.length_m], -1)
    within = (uv.abs() <= 1).all(-1) & (seen.surfaces.object_id == 0)
    stroke = grid_sample(image[None, None].to(added), uv[None], align_corners=False)[0, 0] > 0.5
    strokes, gaps = added[within & stroke].mean(), added[within & ~stroke].mean()
    return float((strokes - gaps) / (strokes + gaps))


def driver_view(symbol: SymbolFunctionParams) -> View:
    """View in the ground frame from the driver's eye that holds a symbol and its surround, in as many pixels as there may be."""
    return view_from(torch.tensor(DRIVER_M, dtype=torch.float64), symbol)


def view_from(eye: Tensor, symbol: SymbolFunctionParams) -> View:
    """View in the ground frame from an eye at `[3]` m that holds a symbol and its surround, in as many pixels as there may be."""
    yaw = math.radians(symbol.yaw_deg)
    along, across = (0.5 + MARGIN) * symbol.length_m, (0.5 + MARGIN) * symbol.width_m
    corners = torch.tensor([[along, along, -along, -along], [across, -across, across, -across]], dtype=torch.float64)
    turn = torch.tensor([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]], dtype=torch.float64)
    x, y = turn @ corners + torch.tensor([[symbol.x_m], [symbol.y_m]], dtype=torch.float64)
    points = torch.stack([x.clamp(min=NEAREST_M), y, torch.zeros_like(x)])
    forward = unit(torch.tensor([symbol.x_m, symbol.y_m, 0.0], dtype=torch.float64) - eye)
    right = unit(torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)))
    R = torch.stack([right, torch.linalg.cross(forward, right), forward], -1)
    u, v, depth = R.T @ (points - eye[:, None])
    (left, top), (last, bottom) = ((each(u / depth).item(), each(v / depth).item()) for each in (torch.min, torch.max))
    focal = min(MOST_PX / max(last - left, bottom - top), 60 * math.degrees(1) / LEAST_ARCMIN)
    width, height = (max(math.ceil(focal * extent), 1) for extent in (last - left, bottom - top))
    return View(width, height, focal, focal, -left * focal, -top * focal, pose(eye, R))


def _distance_px(mask: Tensor) -> Tensor:
    """Distance in px of each pixel of a mask `[height, width]` bool from the nearest one outside of it, NaN if there is none."""
    if bool(mask.all()):
        return torch.full(mask.shape, torch.nan, device=mask.device)
    distance = cv2.distanceTransform(mask.cpu().numpy().astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return torch.from_numpy(distance).to(mask.device)


def _from_lamps(seen: LitScene, lights: Sequence[Tensor], commands: Commands, places: Tensor) -> tuple[float, float, float]:
    """Largest intensity in cd of one lamp towards places `[3, N]` m of the world, and their largest angles in deg aside and up from it."""
    T_body_world = inverse(seen.vehicle.T_world_body)
    here = transform(T_body_world, places)
    total, h_deg, v_deg = dict[str, Tensor](), -math.inf, -math.inf
    for module, u, command in zip(seen.modules, lights, commands or (REST,) * len(seen.modules), strict=True):
        T = module.turned(command)
        ray = here - T[:3, 3:]
        side = module.name.partition(" ")[0]
        texture = module.textures.light_texture(u).double().cpu()
        cd = command.intensity * module.headlight.to(torch.device("cpu")).intensity(texture, T[:3, :3].T @ ray)
        total[side] = total.get(side, torch.zeros(())) + cd
        x, y, z = ray
        h_deg = max(h_deg, float(torch.rad2deg(torch.atan2(y, x)).abs().max()))
        v_deg = max(v_deg, float(torch.rad2deg(torch.atan2(z, torch.hypot(x, y))).max()))
    return max(float(each.max()) for each in total.values()), h_deg, v_deg
