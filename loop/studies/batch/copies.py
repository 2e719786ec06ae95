"""Copies of one symbol in one standing world: light, measurements and metrics of many poses at once, as in single runs.

A module draws all poses on one window of its light texture, for the pixels and the part of the image that it reaches.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.controllers.pixels.mapping import stroke_light
from luxloop.controllers.pixels.primitives import U_ABS, Primitives
from luxloop.controllers.pixels.rthc import GRAZING, RayBatch
from luxloop.controllers.pixels.ssc import PixelController, Ssc, Utilisation, WindowedSsc, window_suffices
from luxloop.controllers.pixels.windows import row_bands, union
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.controllers.symbol.stages import SURE
from luxloop.loop.scenario.disturbances import UNDISTURBED, DisturbanceParams
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.scenario.plant import SimulatedPlantParams
from luxloop.loop.simulation.simulation import Simulation
from luxloop.perception.appearance import Appearance
from luxloop.perception.camera import expose
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics, evaluate
from luxloop.perception.noise import FrameNoise
from luxloop.world.errors import LuxloopError
from luxloop.world.light.illumination import Transport, added_light
from luxloop.world.rendering.rasterise import check_process
from luxloop.world.spmv import Csr, multiply, numbers, row_of_entries
from luxloop.world.texels import NOWHERE, Window


def rays_at(controller: Ssc, primitives: Primitives, T_world_headlight: Tensor) -> RayBatch:
    """Rays at one primitive in B poses `[B, 1]`: at B primitives of one scene, painted separately so that none hides another."""
    count = len(primitives.origin)
    each = replace(
        primitives,
        **{name: getattr(primitives, name)[:, 0] for name in ("origin", "d1", "d2", "normal", "value", "weight")},
        **{name: getattr(primitives, name).expand(count) for name in ("quantity", "symbol_of", "nearest", "shared")},
        forced=torch.ones(count, dtype=torch.bool),
        priority=torch.arange(count),
        modules=primitives.modules * count,
    )
    return controller.ray_batch(each, T_world_headlight)


@dataclass(frozen=True, eq=False)
class ModulePart:
    """Pixels `[m]` of a module that draw, and their utilisations `[m]` at rest.

    drawn: from primitives in a window of the light texture to these pixels; None if all pixels draw.
    """

    pixels: Tensor
    rest: Tensor
    drawn: WindowedSsc | None

    @classmethod
    def of(cls, controller: PixelController, window: Window | None) -> "ModulePart":
        """Pixels that light a window; all pixels without a window."""
        if window is None:
            return cls(torch.arange(len(controller.default), device=controller.default.device), controller.default, None)
        assert isinstance(controller, Ssc)
        drawn = WindowedSsc.of(controller, window)
        return cls(drawn.pixels, controller.default[drawn.pixels], drawn)

    @property
    def window(self) -> Window | None:
        return None if self.drawn is None else self.drawn.window

    def crop(self, transport: Transport, width: int) -> Window:
        """Window that its pixels light in an image of this width."""
        matrix = transport.matrix
        lit = torch.unique_consecutive(row_of_entries(matrix)[numbers(self.pixels, matrix.n_cols)[matrix.indices] >= 0])
        if not len(lit):
            return NOWHERE
        index = transport.index[lit]
        (top, left), (bottom, right) = (each.tolist() for each in torch.stack([index // width, index % width]).aminmax(dim=1))
        return Window(top, bottom + 1, left, right + 1)


def utilisations(drawn: WindowedSsc, rays: RayBatch) -> Iterator[Tensor]:
    """Utilisations `[m]` of the pixels for each primitive in turn, as `WindowedSsc.utilisation` of one."""
    images = _sample(drawn, rays) if _plain(drawn, rays) else _paint(drawn, rays)
    for image in images:
        yield multiply(drawn.weight, image.flatten()).clamp(0, 1)


def _paint(drawn: WindowedSsc, rays: RayBatch) -> Iterator[Tensor]:
    """Setpoints `[rows, cols]` of the window for each primitive in turn, by rays of any kind, with gradients."""
    height, width = (each.stop - each.start for each in drawn.window.slices)
    strokes = rays.strokes()
    for window in rays.windows:
        image = drawn.ssc.default.new_zeros(height, width)
        if not window.empty:
            stroke = next(strokes)
            image[window.within(drawn.window)] = stroke_light(stroke, drawn.ssc.pixels) * stroke.hit
        yield image


def _plain(drawn: WindowedSsc, rays: RayBatch) -> bool:
    """Whether the setpoints sample one image, seen from the front, without gradients."""
    primitives = rays.primitives
    image = primitives.image_of(0)
    sampled = image.dim() == 2 and image.numel() > 1 and not bool(primitives.nearest[0]) and primitives.observer is None
    absolute = rays.quantities == (U_ABS,) and drawn.ssc.pixels.darkening is None and rays.secondary is None
    return sampled and absolute and None not in rays.front and True not in rays.is_mask and not primitives.origin.requires_grad


def _sample(drawn: WindowedSsc, rays: RayBatch) -> Iterator[Tensor]:
    """Setpoints `[rows, cols]` of the window for each primitive in turn, in few passes over bands of rows. The image yielded is reused."""
    grid, primitives, window = rays.grid, rays.primitives, drawn.window
    y, z = grid.tangents(primitives.origin.dtype, primitives.origin.device)
    products = torch.cat([rays.seen.n[:, None], rays.seen.uv], 1)[..., None]  # [B, 3, 3, 1]: d.n, and twice u d.n and v d.n
    rows, cols = products[:, :, 0] + products[:, :, 2] * z, products[:, :, 1] * y  # [B, 3, R], [B, 3, C]
    symbol, value = primitives.image_of(0)[None, None], float(primitives.value[0])  # common to all
    image = drawn.ssc.default.new_zeros(*(each.stop - each.start for each in window.slices))
    for k, bands in enumerate(row_bands(primitives, grid, rays.T_world_headlight, rays.windows)):
        for band in bands:
            r, c = band.slices
            rays_ = rows[k, :, r, None] + cols[k, :, None, c]  # [3, rows, cols]
            n, uv = rays_[0], rays_[1:]
            off = uv.abs()
            hit = torch.maximum(*off).neg_().add_(n).ge_(0)  # |2 u d.n| <= d.n and |2 v d.n| <= d.n (T eq. 7.3.3)
            uv.div_(n.clamp_(min=GRAZING))
            found = grid_sample(symbol, uv.movedim(0, -1)[None], padding_mode="border", align_corners=False)[0, 0]
            image[band.within(window)] = (found if value == 1 else found.mul_(value)).clamp_(0, 1).mul_(hit)
        yield image
        for band in bands:
            image[band.within(window)].zero_()


Lights = tuple[Utilisation, ...]
MARGIN_PX, MARGIN_TEXELS = 16, 32  # margins of the prepared parts of image and light textures, since poses move
TOGETHER = 16  # images evaluated at once; more do not fit the processor's cache
TIMES = ("start_s", "stop_s", "indicated", "when", "unless")


ONE_BY_ONE = "run it one by one (environments: vectorization_mode='sync')"


def check(simulation: Simulation, otherwise: str = ONE_BY_ONE) -> None:
    """Raise LuxloopError unless a held symbol is the only function in a standing world. otherwise: the remedy in the message."""
    refuse_scenario(simulation.scenario, otherwise)
    name, world = simulation.scenario.name, simulation.world
    if simulation.planner.commanding:
        raise LuxloopError(
            f"{name}: batches leave modules at rest, but functions.{next(iter(simulation.planner.commanding))} commands some"
        )
    if world.moving or not all(isinstance(each, Transport) for each in world.lit(0.0).transports):
        raise LuxloopError(f"{name}: batches are for scenes in which nothing moves; {otherwise}")


def refuse_first(name: str, reasons: Mapping[str, object], otherwise: str = ONE_BY_ONE) -> None:
    """Raise LuxloopError with the first reason that applies to a scenario. otherwise: the remedy in the message."""
    for reason, applies in reasons.items():
        if applies:
            raise LuxloopError(f"{name}: {reason}; leave it out, or {otherwise}")


def refuse_scenario(scenario: Scenario, otherwise: str = ONE_BY_ONE) -> None:
    """Raise LuxloopError as `check`, as far as the scenario's keys tell."""
    key, lighting, symbol = f"functions.{only(scenario.symbols)}", scenario.lighting, scenario.symbol
    timed = next((each for each in TIMES if getattr(symbol, each) is not None), None)
    reasons = {
        "batches are of a single symbol, without other functions, the detector and objects' categories": scenario.meters_light,
        "lighting.painted: batches show no painted pixels": lighting.painted,
        "lighting.power_limit: batches have no limit": lighting.power_limit is not None,
        f"{key}.{timed}: batches show the symbol in all steps": timed,
        "headlight.droop: batches sum the flux of modules, not the power of pixels": scenario.headlight.droop,
        f"{key}.observer: batches evaluate in the camera's view": symbol.observer,
        f"{key}.weight: batches draw with weight 1": symbol.weight != 1,
        "batches do not support disturbances.oncoming": scenario.disturbances.oncoming,
        "batches do not support disturbances.lens": scenario.disturbances.lens,
        "batches do not support light.interreflection": scenario.light.interreflection,
        "batches are in clear air": scenario.air or symbol.extraction.visibility_m,
        f"batches need the simulated plant, not {scenario.plant.kind}": not isinstance(scenario.plant, SimulatedPlantParams),
        "batches are for scenes in which nothing moves": scenario.vehicle is not None,
    }
    refuse_first(scenario.name, reasons, otherwise)


@dataclass(frozen=True)
class Conditions:
    """Conditions of a copy's frames: seed of the noise, step, and the scenario's disturbances."""

    seed: int
    step: int
    disturbances: DisturbanceParams = UNDISTURBED


@dataclass(frozen=True, eq=False)
class Part:
    """The part `[h, w]` of the image that modules light, and what drawing there needs.

    resting: luminance in cd/m^2 without the symbol. base: luminance without the lamps. limit: threshold of extraction in cd/m^2. roads:
    matrices of each module from its pixels to the crop, on the world's road and on the flat road.
    """

    crop: Window
    resting: Tensor
    base: Tensor
    limit: Tensor
    modules: tuple[ModulePart, ...]
    roads: tuple[tuple[Csr, Csr], ...]


@dataclass(frozen=True, eq=False)
class SymbolLight:
    """Noise-free luminances in cd/m^2 of B projections.

    part: of the image, with all light of the symbols. footprints: expected crop of each symbol. windows: crops of equal size around the
    footprints, empty outside the view. added, flat: `[B, h, w]`, luminance that the symbols add on the world's road and on the controller's
    flat road. sums: `[B, m, 2]`, flux in lm and sum of utilisations of each drawing module. drawn: utilisations of each copy, `[m]` of the
    part of each module.
    """

    projection: ProjectionCommand
    part: Part
    footprints: Sequence[Window]
    windows: Sequence[Window]
    added: Tensor
    flat: Tensor
    sums: Tensor
    drawn: Sequence[Sequence[Tensor]]


class Copies:
    """Copies of a scenario's only symbol in its standing world. Raises LuxloopError as `check`.

    Prepared parts of matrices and image are reused, and grow.
    """

    def __init__(self, simulation: Simulation) -> None:
        check(simulation)
        self.simulation, self.symbol = simulation, simulation.symbol
        self.projector, self.sensor = self.symbol.projector, self.symbol.sensor
        self.view, planner = simulation.world.lit(0.0), simulation.planner
        plan = planner.compose(simulation.situation(0.0), planner.start(), {})
        beams = [module.base(plan) for module in simulation.modules]
        self.resting = tuple(Utilisation(beam, None if bool(beam.any()) else slice(0, 0)) for beam in beams)
        primitive = self.projector.primitive(self.projector.target)
        self.windowed = all(window_suffices(each.pixel_controller, primitive, each.T_body_headlight) for each in self.projector.modules)
        self._part: Part | None = None

    def show(self, projection: ProjectionCommand | Tensor) -> SymbolLight:
        """Light of the symbol for B projections, or for poses `[B, 4]`: x, y in m, roll, pitch in rad."""
        check_process()
        if isinstance(projection, Tensor):
            projection = ProjectionCommand(projection)
        footprints = self.projector.footprints(projection, self.sensor.model.eye.view, self.sensor.params.footprint_margin_m)
        windows = same_size(
            [NOWHERE if min(each.v_stop - each.v_start, each.u_stop - each.u_start) < 2 else each for each in footprints],
            self.view.base.shape,
        )
        needed = union(windows)
        drawn: list[tuple[Tensor, ...]]
        if self.windowed:  # on the parts of light texture, lamp and image that the symbols touch
            modules = self.projector.modules
            rays = [
                rays_at(cast(Ssc, module.pixel_controller), primitives, module.T_body_headlight)
                for module, primitives in zip(modules, self.projector.primitives(projection), strict=True)
            ]
            part = self._reach(needed, [ray.window for ray in rays])
            of_modules = (utilisations(cast(WindowedSsc, each.drawn), ray) for each, ray in zip(part.modules, rays, strict=True))
            drawn = list(zip(*of_modules, strict=True))
        else:  # each with all pixels of the lamps
            part = self._reach(needed, [None] * len(self.projector.modules))
            drawn = [tuple(each.u for each in self.projector.draw(single)) for single in projection.singles()]
        added, flat, sums = list[Tensor](), list[Tensor](), list[Tensor]()
        fluxes = [self.simulation.modules[k].flux[each.pixels] for k, each in zip(self.symbol.drawn_by, part.modules, strict=True)]
        weights = [torch.stack([flux, torch.ones_like(flux)], 1) for flux in fluxes]
        for lights in drawn:
            above = [u - module.rest for u, module in zip(lights, part.modules, strict=True)]
            for images, k in ((added, 0), (flat, 1)):
                seen = [multiply(roads[k], u).view(part.resting.shape) for roads, u in zip(part.roads, above, strict=True)]
                images.append(sum(seen[1:], seen[0]))
            sums.append(torch.stack([u @ each for u, each in zip(lights, weights, strict=True)]))
        return SymbolLight(projection, part, footprints, windows, torch.stack(added), torch.stack(flat), torch.stack(sums), drawn)

    def measure(self, light: SymbolLight, frames: Sequence[Conditions], *, quantise: bool = True) -> list[Measurement]:
        """Measurements of each copy in its own footprint. frames: of each copy. quantise: False leaves digital numbers unrounded, for
        gradients.
        """
        seen = [self.sensor.lost(pose, ExtractionStatus.NOTHING) for pose in light.projection.pose]
        in_view = [k for k, window in enumerate(light.windows) if window != NOWHERE]
        together = 1 if self.sensor.model.eye.plane is not None else TOGETHER  # plane coordinates are of one window
        for first in range(0, len(in_view), together):
            some = in_view[first : first + together]
            for k, each in zip(some, self._look(light, some, [frames[k] for k in some], quantise), strict=True):
                seen[k] = each
        return seen

    def evaluate(self, light: SymbolLight) -> Metrics:
        """Metrics `[B]` of the symbols on the road."""
        evaluator, crop = self.symbol.evaluator, light.part.crop
        assert evaluator is not None
        found = [evaluate(each, evaluator.plane, evaluator.goal, crop.u_start, crop.v_start) for each in light.added.split(TOGETHER)]
        return Metrics(*(torch.cat(each) for each in zip(*(vars(each).values() for each in found), strict=True)))

    def finds_another_road(self, light: SymbolLight, k: int, conditions: Conditions) -> bool:
        """Whether a single run finds another road than the plane z = 0 in the frames of the k-th copy, by the rule of `RoadStage`."""
        height, width = self.view.base.shape
        on = self._resting.clone()
        on[light.part.crop.slices] += light.added[k]
        lights = [
            Utilisation(module.pixel_controller.default.index_copy(0, part.pixels, u))
            for module, part, u in zip(self.projector.modules, light.part.modules, light.drawn[k], strict=True)
        ]
        found = self.sensor.relocalise(self._expose(on, self._resting, self.view.base, conditions, Window(0, height, 0, width)), lights)
        risen = found.shape[0].abs() > self.sensor.params.footprint_margin_m
        return bool(found.match > SURE) and bool(found.found) and bool(risen)

    @cached_property
    def _resting(self) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 without the symbols."""
        return added_light(self.view.transports, self.resting, self.view.base)

    def _look(self, light: SymbolLight, chosen: Sequence[int], frames: Sequence[Conditions], quantise: bool) -> list[Measurement]:
        """Measurements of some copies at once; each window counts as a crop at the place of the first one."""
        part, windows = light.part, [light.windows[k] for k in chosen]
        parts, own = [], []  # frames, and flat light with threshold; footprint in the window
        for k, window, conditions in zip(chosen, windows, frames, strict=True):
            at, footprint = window.within(part.crop), light.footprints[k].slices
            inside = [
                slice(each.start - start, each.stop - start)
                for each, start in zip(footprint, (window.v_start, window.u_start), strict=True)
            ]
            on, off = self._expose(part.resting[at] + light.added[k][at], part.resting[at], part.base[at], conditions, window, quantise)
            beside = torch.ones_like(on, dtype=torch.bool)
            beside[*inside] = False
            parts.append((torch.where(beside, off, on), off, light.flat[k][at].masked_fill(beside, 0.0), part.limit[at]))
            own.append(inside)
        on, off, flat, limit = map(torch.stack, zip(*parts, strict=True))
        seen = self.sensor.compare(on, off, (flat, limit), windows[0])
        moved = on.new_tensor([(each.u_start - windows[0].u_start, each.v_start - windows[0].v_start) for each in windows])
        errors = torch.cat([seen.errors[:, :2] + moved, seen.errors[:, 2:]], 1)
        pose_error, centroids = self.sensor.pose_error(errors), seen.appearance.centroids + moved[:, None]
        return [
            replace(
                seen,
                code=seen.code[n],
                errors=errors[n],
                pose_error=pose_error[n],
                area_ratio=seen.area_ratio[n],
                appearance=replace(
                    seen.appearance,
                    centroids=centroids[n],
                    **{name: getattr(seen.appearance, name)[n] for name in ("area", "shear", "length")},
                ),
                symbol=seen.symbol[n][*inside],
                crop=light.footprints[chosen[n]],
            )
            for n, inside in enumerate(own)
        ]

    def _expose(
        self, on: Tensor, off: Tensor, base: Tensor, conditions: Conditions, crop: Window, quantise: bool = True
    ) -> tuple[Tensor, Tensor]:
        """On and off frames of luminances `[h, w]` at a crop of the image. base: luminance without the lamps."""
        camera, noisy = self.simulation.scenario.camera, conditions.disturbances.noise_factor(conditions.step)

        def frame(number: int, luminance: Tensor) -> Tensor:
            ambient = conditions.disturbances.ambient_factor(conditions.step, number)
            luminance = luminance if ambient == 1 else luminance + (ambient - 1) * base
            noise = FrameNoise.of(conditions.seed, conditions.step, number).part(crop.slices, luminance) if camera.noise else None
            return expose(luminance, camera, noise if noise is None or noisy == 1 else noisy * noise, quantise=quantise)

        return frame(0, on), frame(1, off)

    def _reach(self, needed: Window, windows: Sequence[Window | None]) -> Part:
        """Part of the image with a crop, and parts of the modules with windows of their light textures; None for whole textures."""
        old, width = self._part, self.view.base.shape[1]
        if old is not None:
            before = [each.window for each in old.modules]
            if (needed == NOWHERE or old.crop.holds(needed)) and all(
                a is None or b is None or a.holds(b) for a, b in zip(before, windows, strict=True)
            ):
                return old
        controllers = [each.pixel_controller for each in self.projector.modules]
        around = [
            window and window.widen(MARGIN_TEXELS, each.headlight.rows, each.headlight.cols)
            for window, each in zip(windows, controllers, strict=True)
        ]
        if old is not None:
            around = [a and b and union([a, b]) for a, b in zip(before, around, strict=True)]
        modules = tuple(map(ModulePart.of, controllers, around))
        transports = [cast(Transport, self.view.transports[number]) for number in self.symbol.drawn_by]
        reached = [each.crop(transport, width) for each, transport in zip(modules, transports, strict=True)] if self.windowed else []
        crop = union([needed, *reached]).widen(MARGIN_PX, *self.view.base.shape)
        crop = crop if old is None else union([crop, old.crop])
        roads = tuple(
            (on_world.onto(crop.slices, width, each.pixels), on_flat.onto(crop.slices, width, each.pixels))
            for each, on_world, on_flat in zip(modules, transports, self.sensor.model.transports, strict=True)
        )
        self._part = Part(
            crop, self._resting[crop.slices], self.view.base[crop.slices], self.sensor.model.limit[crop.slices], modules, roads
        )
        return self._part


def same_size(crops: Sequence[Window], shape: Sequence[int]) -> list[Window]:
    """Crops of equal size around given crops, within an image of a shape; empty ones stay empty."""
    rows, columns = (max((each.stop - each.start for each in (crop.slices[n] for crop in crops)), default=0) for n in (0, 1))
    places = ((min(each.v_start, shape[0] - rows), min(each.u_start, shape[1] - columns)) for each in crops)
    return [each if each == NOWHERE else Window(v, v + rows, u, u + columns) for each, (v, u) in zip(crops, places, strict=True)]


def stack(seen: Sequence[Measurement]) -> Measurement:
    """Measurements of B copies as one, without symbol images, which differ in size."""
    code, errors, pose_error, area_ratio = (
        torch.stack([getattr(each, name) for each in seen]) for name in ("code", "errors", "pose_error", "area_ratio")
    )
    shapes = zip(*(vars(each.appearance).values() for each in seen), strict=True)
    appearance = Appearance(*map(torch.stack, shapes))
    return Measurement(code, errors, pose_error, area_ratio, appearance, errors.new_zeros(len(seen), 0, 0), NOWHERE)
