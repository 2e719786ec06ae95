"""Photometric metrics of a step: objects, zones and materials in the camera's view, symbols in their observers' views (T 7.2.2), and
probes, which are luxmeters in the world, on the car or on an object.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import torch
from torch import Tensor

from luxloop.controllers.functions.material import MaterialLightParams, MaterialParams, MaterialState, Quantity
from luxloop.controllers.functions.objects import GlareFreeParams
from luxloop.controllers.functions.planner import Plan
from luxloop.controllers.functions.zone import ZoneParams, region_of
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.rthc import masks
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.situation import Situation, TrackedObject
from luxloop.loop.scenario.probes import ProbeParams
from luxloop.loop.simulation.detection import LEAST_PX
from luxloop.loop.simulation.world import LitScene, ObjectLight, World
from luxloop.perception.eye import veil_per_lux
from luxloop.perception.metrics import iou
from luxloop.world.frames import View, inverse, transform, unit
from luxloop.world.headlight.lamp import REST, Commands
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.rendering.raycast import TOLERANCE_M, sees
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.traffic.tracked import ROAD_USERS

DRIVEN = ROAD_USERS - {"pedestrian"}
DUE_S = 0.3 - 1e-6  # time allowed to dim for an oncoming road user, less the rounding of clocks


@dataclass(frozen=True)
class OnObject:
    """Illuminance from the lamps on an object in the camera's view.

    pixels: number of visible pixels; all lx are NaN without any. lx_min, lx_mean, lx_max: time means over the exposures. lx_peak: maximum
    of any exposure. masked: whether the object must be dark.
    """

    pixels: int
    lx_min: float
    lx_mean: float
    lx_max: float
    lx_peak: float
    masked: bool


def on_objects(
    watched: Mapping[str, int], dark: frozenset[int], metered: Sequence[ObjectLight], shares: Sequence[float]
) -> Mapping[str, OnObject]:
    """Light on objects by name. watched: ids of these objects. dark: ids of masked objects. metered, shares: light and time share of each
    exposure.
    """
    found = {}
    for name, number in watched.items():
        lights = [each.on(number) for each in metered]
        low = mean = high = peak = math.nan
        if all(map(len, lights)):
            each = ([float(what(lx)) for lx in lights] for what in (Tensor.min, Tensor.mean, Tensor.max))
            low, mean, high = (sum(share * lx for share, lx in zip(shares, values, strict=True)) for values in each)
            peak = max(float(lx.max()) for lx in lights)
        found[name] = OnObject(len(lights[0]), low, mean, high, peak, number in dark)
    return found


def near_enough(seen: LitScene, since_s: Mapping[str, float], now_s: float) -> Mapping[str, float]:
    """Start times, by name, of oncoming drivers and riders at least LEAST_PX tall and half visible. since_s: from the previous step."""
    heading = {placed.body.name: placed.T_world_body[:3, 0].double() for placed in seen.triangles.placed if placed.object_id > 0}
    ahead = seen.view.T_world_view[:3, 2].double()
    near = (
        each.name
        for each in seen.objects
        if seen.given[each.object_id - 1].category in DRIVEN
        and each.whole[3] - each.whole[1] >= LEAST_PX
        and each.visible >= 0.5
        and float(heading[each.name] @ ahead) < 0
    )
    return {name: since_s.get(name, now_s) for name in near}


def on_eyes(
    given: Sequence[ObjectParams], due: Collection[str], metered: Sequence[ObjectLight], shares: Sequence[float]
) -> tuple[float | None, float | None, float | None]:
    """Largest illuminance in lx on heads and windscreens: time mean and peak of all road users, time mean of the due ones.

    None where no such surface is in view. given: parameters of the objects 1, 2, ... due: road users who must not be dazzled any more.
    """
    users = {each.name: number for number, each in enumerate(given, 1) if each.category in ROAD_USERS}
    mean, highest = _most(users.values(), metered, shares)
    return mean, highest, _most([users[name] for name in due], metered, shares)[0]


def _most(numbers: Collection[int], metered: Sequence[ObjectLight], shares: Sequence[float]) -> tuple[float | None, float | None]:
    """Largest illuminance in lx on heads and windscreens of objects: time mean and peak; None if none is visible."""
    lights = [each.on_eyes(numbers) for each in metered]
    if not any(map(len, lights)):
        return None, None
    most = [float(lx.max()) if len(lx) else 0.0 for lx in lights]
    return sum(share * lx for share, lx in zip(shares, most, strict=True)), max(most)


def must_be_dark(functions: Mapping[str, Any], each: TrackedObject, now: Situation) -> bool:
    """Whether a glare-free function masks a present object completely, without fading."""
    alone = replace(now, objects=(each,))
    there = each.since_s <= now.time_s < each.until_s
    glare_free = (function for function in functions.values() if isinstance(function, GlareFreeParams))
    return there and any(any(masks(part)) for function in glare_free for part in function.primitives(alone))


@dataclass(frozen=True)
class InZone:
    """A zone in one step. lx: commanded illuminance. luminance: noise-free mean in cd/m^2, None out of the camera's view or without the
    truth. target: wanted luminance in cd/m^2.
    """

    lx: float
    luminance: float | None
    target: float


def in_zones(functions: Mapping[str, Any], states: Mapping[str, Any], luminance: Tensor | None, view: View) -> Mapping[str, InZone]:
    """Zones of a scenario by name. luminance: `[height, width]` cd/m^2, None without the truth."""
    found = {}
    for name, function in functions.items():
        if isinstance(function, ZoneParams):
            mean = None
            if luminance is not None and len(seen := luminance[region_of(function, view).to(luminance.device)]):
                mean = float(seen.mean())
            found[name] = InZone(states[name].lx, mean, function.luminance_cd_m2)
    return found


@dataclass(frozen=True)
class OnMaterial:
    """A material in one step, in lx or cd/m^2 by `quantity`. median: noise-free median of its pixels, None if not visible."""

    quantity: Quantity
    median: float | None
    wanted: float


def quantities(functions: Mapping[str, Any]) -> Mapping[str, Quantity]:
    """Requested quantity by function and label (material or albedo range); of several lights with one label, the first counts."""
    found: dict[str, Quantity] = {}
    for name, function in functions.items():
        if isinstance(function, MaterialParams):
            for light in function.lights:
                for label, _ in _labels(light):
                    found.setdefault(f"{name}.{label}", light.quantity)
    return found


def on_materials(
    functions: Mapping[str, Any],
    states: Mapping[str, Any],
    now: Situation,
    told: Mapping[str, int],
    world: World,
    illuminance: Tensor,
    luminance: Tensor,
) -> Mapping[str, OnMaterial]:
    """Materials by function and label, on the objects and road region that the function selects.

    Of several lights with one label, the first counts. states: None for a function before its first frame. told: ids of objects by their
    names in the situation. illuminance, luminance: `[height, width]` now.
    """
    found: dict[str, OnMaterial] = {}
    for called, function in functions.items():
        if isinstance(function, MaterialParams):
            state, view = states[called], world.lit(now.time_s)
            picture, names = view.materials
            asked = torch.zeros_like(picture, dtype=torch.bool) if state is None else _request_mask(function, state, now, told, view)
            for number, light in enumerate(function.lights):
                arriving = illuminance if light.quantity == "lx" else luminance
                mine = asked if state is None else asked & (state.light == number)
                for label, name in _labels(light):
                    of_it = mine & (picture == names.index(name)) if name in names else mine & (name == "")
                    median = float(arriving[of_it].median()) if bool(of_it.any()) else None
                    found.setdefault(f"{called}.{label}", OnMaterial(light.quantity, median, light.value))
    return found


def _labels(light: MaterialLightParams) -> Iterator[tuple[str, str]]:
    """Labels and their materials, "" for any material."""
    chosen = "" if light.materials and light.albedo == (0.0, 1.0) else "albedo {:g} to {:g}".format(*light.albedo)
    yield from ((f"{name} {chosen}".strip(), name) for name in light.materials or ("",))


def _request_mask(function: MaterialParams, state: MaterialState, now: Situation, told: Mapping[str, int], view: LitScene) -> Tensor:
    """Pixels that a function lights, `[height, width]` bool."""
    surfaces = view.surfaces
    ids = torch.tensor([told[each.name] for each in function.select(now) if each.name in told])
    standing = torch.isin(surfaces.object_id, ids.to(surfaces.object_id)) & ~state.ground
    if function.road_m is None:
        return standing
    T_ground_world = inverse(view.vehicle.T_world_ground).to(surfaces.position)
    x, y, _ = transform(T_ground_world, surfaces.position.flatten(1)).unflatten(1, state.ground.shape)
    near, far = function.road_m
    return standing | state.ground & (x >= near) & (x <= far) & (y.abs() <= function.road_width_m / 2)


WIDTH_PX = 640  # width of the wanted picture, which fills the observer's view
LIT = 0.5  # threshold relative to a white picture


@dataclass(frozen=True, eq=False)
class ObservedSymbol:
    """A symbol in its observer's view. share: luminance `[rows, cols]` relative to a white picture's, NaN out of the lamps' reach. wanted:
    the picture `[rows, cols]`, 0..1.
    """

    share: Tensor
    wanted: Tensor

    @property
    def iou(self) -> float:
        """Intersection over union of lit and wanted pixels."""
        return float(iou(self.share > LIT, self.wanted > LIT))


def pictures(primitives: Primitives) -> list[int]:
    """Indices of pictures for an observer. Images with opacity do not count: they are light distributions in a camera's view."""
    return [p for p in range(len(primitives)) if primitives.has_observer(p) and primitives.image_of(p).ndim == 2]


def in_white(plan: Plan) -> Plan | None:
    """The plan with white pictures for all observers, None without observers."""
    if plan.primitives is None or not (shown := pictures(plan.primitives)):
        return None
    symbols = (*plan.primitives.symbols, torch.ones(1, 1).to(plan.primitives.origin))
    symbol_of = plan.primitives.symbol_of.index_fill(0, torch.tensor(shown), len(symbols) - 1)
    return replace(plan, primitives=replace(plan.primitives, symbols=symbols, symbol_of=symbol_of))


def observed_symbols(
    plan: Plan, lights: Sequence[Tensor], white: Sequence[Tensor], world: World, now: Situation
) -> tuple[ObservedSymbol, ...]:
    """Observed symbols of a plan, in its order. lights, white: utilisations `[n_p]` of the plan and of white pictures, one a module."""
    primitives = plan.primitives
    if primitives is None or (who := primitives.observer) is None:
        return ()
    found = []
    for p in pictures(primitives):
        view = picture_view(*(each[p].double() for each in (who.eye, who.origin, who.d1, who.d2)))
        seen = world.through(view, now.time_s)
        (_, drawn), (_, full) = seen.light(lights, now.commands), seen.light(white, now.commands)
        symbol = primitives.symbols[int(primitives.symbol_of[p])].to(drawn)
        wanted = torch.nn.functional.interpolate(symbol[None, None], drawn.shape, mode="bilinear")[0, 0]
        found.append(ObservedSymbol(drawn / full, wanted))
    return tuple(found)


def picture_view(eye: Tensor, origin: Tensor, d1: Tensor, d2: Tensor) -> View:
    """View from an eye that is filled by a rectangular picture. eye, origin, d1, d2: `[3]` m, the last two are the picture's edges."""
    right, down = (torch.nn.functional.normalize(edge, dim=0) for edge in (d1, d2))
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3], T[:3, 3] = torch.stack([right, down, torch.linalg.cross(right, down)], -1), eye
    x, y, depth = (T[:3, :3].T @ (origin - eye)).tolist()
    height = max(round(WIDTH_PX * float(d2.norm() / d1.norm())), 1)
    fx, fy = WIDTH_PX * depth / float(d1.norm()), height * depth / float(d2.norm())
    return View(WIDTH_PX, height, fx, fy, -x * fx / depth, -y * fy / depth, T)


INSIDE_M: Final = 1.5  # in front of an object's probe, which may lie in the object, such as a driver's eye


def illuminance_at(
    probes: Mapping[str, ProbeParams], world: World, time_s: float, lights: Sequence[Utilisation], commands: Commands = ()
) -> dict[str, float]:
    """Illuminance in lx from the lamps on each probe; NaN while its object does not exist."""
    lit = world.lit(time_s)
    arriving = {name: _arriving(probe, world, lit, lights, commands) for name, probe in probes.items()}
    return {name: math.nan if light is None else sum(lx for lx, _ in light) for name, light in arriving.items()}


def veils_at(
    probes: Mapping[str, ProbeParams], world: World, time_s: float, lights: Sequence[Utilisation], commands: Commands, age_years: float
) -> dict[str, float]:
    """Veiling luminance in cd/m^2 by the lamps in an eye at each probe that looks along `facing`; NaN while its object does not exist."""
    lit, found = world.lit(time_s), dict[str, float]()
    for name, probe in probes.items():
        if (light := _arriving(probe, world, lit, lights, commands)) is None:
            found[name] = math.nan
            continue
        lx, cos = torch.tensor([(0.0, 1.0), *light], dtype=torch.float64).T
        found[name] = float(lx @ veil_per_lux(torch.rad2deg(cos.clamp(max=1).acos()), age_years))
    return found


def _arriving(
    probe: ProbeParams, world: World, lit: LitScene, lights: Sequence[Utilisation], commands: Commands
) -> list[tuple[float, float]] | None:
    """Illuminance in lx from each module that shines on a probe, and the cosine of its angle; None while its object does not exist."""
    T_world_frame = _frame(probe, world, lit.time_s)
    if T_world_frame is None:
        return None
    place = transform(T_world_frame, torch.tensor(probe.position_m, dtype=torch.float64)[:, None])
    normal = None if probe.facing is None else unit(T_world_frame[:3, :3] @ torch.tensor(probe.facing, dtype=torch.float64)[:, None])
    found = list[tuple[float, float]]()
    for module, light, command in zip(lit.modules, lights, commands or (REST,) * len(lit.modules), strict=True):
        if not bool(light.u.any()):
            continue
        T_world_headlight = lit.vehicle.T_world_body @ module.turned(command)
        away = T_world_headlight[:3, 3:] - place
        per_cd, medium = float(lux_per_cd(away, normal)), lit.scene.air_at(lit.time_s)
        near = TOLERANCE_M if probe.frame in ("world", "car") else INSIDE_M
        if per_cd and bool(sees(lit.triangles, T_world_headlight[:3, 3], place, near)):
            texture = module.textures.light_texture(light.u).cpu()
            ray = T_world_headlight[:3, :3].T @ -away
            lx = command.intensity * float(module.headlight.intensity(texture, ray)) * per_cd
            through = 1.0 if medium is None else float(medium.transmittance(away))
            found.append((through * lx, per_cd / float(lux_per_cd(away))))
    return found


def _frame(probe: ProbeParams, world: World, time_s: float) -> Tensor | None:
    """`T_world_frame` `[4, 4]` of a probe, None while its object does not exist."""
    if probe.frame == "world":
        return torch.eye(4, dtype=torch.float64)
    if probe.frame == "car":
        return world.motion.at(time_s).T_world_body
    track = next(each.track for each in world.scene.objects if each.name == probe.frame)
    return track.pose_at(time_s) if track.visible_at(time_s) else None
