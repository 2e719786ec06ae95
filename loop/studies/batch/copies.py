"""Copies of one symbol in one standing world: many poses are lit, measured and judged at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Ssc, Utilisation, serves
from luxloop.controllers.pixels.windows import Window
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.loop.scenario.model import Scenario, only
from luxloop.loop.scenario.plant import SimulatedPlantParams
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.batch.drawing import Reached, casting, utilisations
from luxloop.loop.studies.batch.judging import judged
from luxloop.loop.studies.batch.looking import Scene, Taken, joined, look, rendered
from luxloop.loop.studies.batch.windows import EMPTY, Windows, hull
from luxloop.perception.extraction import Crop, ExtractionStatus
from luxloop.perception.metrics import Metrics
from luxloop.world.errors import LuxloopError
from luxloop.world.light.illumination import Transport, added_light
from luxloop.world.rendering.rasterise import check_process
from luxloop.world.spmv import Csr, multiply

Lights = tuple[Utilisation, ...]
AROUND_PX = 16  # by which a crop that is kept reaches beyond what was asked for, since poses move on
TOGETHER = 16  # copies whose images are computed at once: more do not fit into the processor's cache


def check(simulation: Simulation, otherwise: str = "run it one by one") -> None:
    """Raises LuxloopError unless a held symbol is the only function in a standing world. otherwise: the remedy in the message."""
    refuse_scenario(simulation.scenario, otherwise)
    name, world = simulation.scenario.name, simulation.world
    if simulation.planner.commanding:
        raise LuxloopError(
            f"{name}: batches leave modules at rest, but functions.{next(iter(simulation.planner.commanding))} commands some"
        )
    if world.moving or not all(isinstance(each, Transport) for each in world.lit(0.0).transports):
        raise LuxloopError(f"{name}: batches are for scenes in which nothing moves; {otherwise}")


def refuse_scenario(scenario: Scenario, otherwise: str = "run it one by one") -> None:
    """The part of `check` that needs only the scenario's keys. Raises LuxloopError as `check`."""
    only(scenario.symbols)
    if scenario.meters_light:
        others = "other functions, the detector and objects' categories"
        raise LuxloopError(f"{scenario.name}: batches are of a single symbol; take {others} out, or {otherwise}")
    if scenario.lighting.painted:
        raise LuxloopError(f"{scenario.name}: lighting.painted: batches show no painted pixels; leave it out, or {otherwise}")
    if scenario.lighting.power_limit is not None:
        raise LuxloopError(f"{scenario.name}: lighting.power_limit: batches have no limit; leave it out, or {otherwise}")
    if timed := [key for key in ("start_s", "stop_s", "indicated", "when", "unless") if getattr(scenario.symbol, key) is not None]:
        key = f"functions.{only(scenario.symbols)}.{timed[0]}"
        raise LuxloopError(f"{scenario.name}: {key}: batches show the symbol in all steps; leave it out, or {otherwise}")
    if scenario.symbol.weight != 1:
        key = f"functions.{only(scenario.symbols)}.weight"
        raise LuxloopError(f"{scenario.name}: {key}: batches draw with weight 1; leave it out, or {otherwise}")
    if scenario.disturbances.oncoming:
        raise LuxloopError(f"{scenario.name}: batches do not support disturbances.oncoming; leave it out, or {otherwise}")
    if not isinstance(scenario.plant, SimulatedPlantParams):
        raise LuxloopError(f"{scenario.name}: batches need the simulated plant, not {scenario.plant.kind}; {otherwise}")
    if scenario.vehicle is not None:
        raise LuxloopError(f"{scenario.name}: batches are for scenes in which nothing moves; {otherwise}")


@dataclass(frozen=True, eq=False)
class Light:
    """Luminances in cd/m^2 that the camera sees of B projections, without noise.

    projection: of poses `[B, 4]`, x, y in m, roll, pitch in rad. crop: the part of the image that has all light of the symbols. added:
    `[B, h, w]` at it, by the symbols. scene: the same and more in each one's own footprint; None where the camera sees none of them.
    sums: `[B, m, 2]`, flux in lm and sum of utilisations of each of the modules that draw. drawn: utilisations of each of them, of each
    copy, all `[n_p]` or those of its pixels `[m]`.
    """

    projection: ProjectionCommand
    crop: Crop
    added: Tensor
    scene: Scene | None
    sums: Tensor
    drawn: Sequence[Sequence[Tensor]]
    pixels: Sequence[Tensor | None]

    @property
    def poses(self) -> Tensor:
        return self.projection.pose


class Copies:
    """Projections of a scenario's only symbol in its standing world. Raises LuxloopError as `check`.

    The parts of the matrices that one look needed are kept for the next.
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
        self.windowed = all(serves(each.pixel_controller, primitive, each.T_world_headlight) for each in self.projector.modules)
        self._kept: _Kept | None = None

    @cached_property
    def rest(self) -> Tensor:
        """Luminance `[height, width]` in cd/m^2 of everything but the symbols."""
        height, width = self.view.base.shape
        return _luminance(self.view.transports, [self.resting], self.view.base, Crop(0, height, 0, width))[0]

    def show(self, projection: ProjectionCommand | Tensor) -> Light:
        """The light of the symbol for B projections, or for poses `[B, 4]`: x, y in m, roll, pitch in rad."""
        check_process()
        if isinstance(projection, Tensor):
            projection = ProjectionCommand(projection)
        crops = self.projector.footprints(projection, self.sensor.model.eye.view, self.sensor.params.footprint_margin_m)
        windows = Windows.around(crops, (self.view.view.height, self.view.view.width))
        return self._in_windows(projection, windows) if self.windowed else self._one_by_one(projection, windows)

    def measured(self, light: Light, frames: Sequence[Taken], *, quantise: bool = True) -> Measurement:
        """Measurements `[B]` of the symbol's sensor, each in its own footprint. frames: of each copy. quantise: False leaves digital
        numbers unrounded, for gradients.
        """
        if light.scene is None:
            return self.sensor.lost(light.poses, ExtractionStatus.NOTHING)
        camera = self.simulation.scenario.camera
        return joined([look(self.sensor, light.scene[part], camera, frames[part], quantise) for part in _parts(len(frames))])

    def rendered(self, light: Light) -> Tensor:
        """Features `[B, 4]` that a flat road would show, without noise; NaN if it would show nothing."""
        if light.scene is None:
            return torch.full_like(light.poses, torch.nan)
        return torch.cat([rendered(self.sensor, light.scene[part]) for part in _parts(len(light.poses))])

    def judged(self, light: Light) -> Metrics:
        """Verdicts `[B]` of the judge."""
        made = self.symbol.judge
        assert made is not None
        corner = light.crop.u_start, light.crop.v_start
        found = [judged(light.added[part], made.plane, made.goal, *corner) for part in _parts(len(light.poses))]
        return Metrics(*(torch.cat(each) for each in zip(*(vars(each).values() for each in found), strict=True)))

    def _one_by_one(self, projection: ProjectionCommand, windows: Windows) -> Light:
        """Where more than a window of the light texture counts: each with all pixels of the lamps, in all footprints."""
        lights = [self.projector.draw(each) for each in projection.singles()]
        fluxes = [self.simulation.modules[k].flux for k in self.symbol.drawn_by]
        sums = [
            torch.stack([torch.stack([each.u @ flux, each.u.sum()]) for each, flux in zip(light, fluxes, strict=True)]) for light in lights
        ]
        place = _Place.of(self, windows.hull)
        shown = [
            tuple(dict(zip(self.symbol.drawn_by, light, strict=True)).get(k, each) for k, each in enumerate(self.resting))
            for light in lights
        ]
        added = _luminance(self.view.transports, shown, self.view.base, place.crop) - place.resting
        model = self.sensor.model
        flat = _luminance(model.transports, lights, -model.beams, place.crop)
        drawn = [[each.u for each in light] for light in lights]
        return Light(projection, place.crop, added, place.scene(windows, added, flat), torch.stack(sums), drawn, [None] * len(fluxes))

    def _in_windows(self, projection: ProjectionCommand, windows: Windows) -> Light:
        """On the parts of light texture, lamp and image that the symbols touch."""
        modules = self.projector.modules
        rays = [
            casting(cast(Ssc, module.pixel_controller), primitives, module.T_world_headlight)
            for module, primitives in zip(modules, self.projector.primitives(projection), strict=True)
        ]
        kept = self._reached([each.window for each in rays], windows)
        place = kept.place
        shape = place.resting.shape
        images: list[list[Tensor]] = [[], []]  # on the world's road and on the flat one, of each copy
        sums, drawn = [], []
        for lights in zip(*(utilisations(each.drawn, cast_) for each, cast_ in zip(kept.modules, rays, strict=True)), strict=True):
            for seen, roads in zip(images, kept.roads, strict=True):
                parts = [multiply(road, u).view(shape) for road, u in zip(roads, lights, strict=True)]
                seen.append(sum(parts[1:], parts[0]))
            drawn.append(lights)
            sums.append(torch.stack([u @ each.weights for each, u in zip(kept.modules, lights, strict=True)]))
        added, flat = map(torch.stack, images)
        scene, pixels = place.scene(windows, added, flat), [each.drawn.pixels for each in kept.modules]
        return Light(projection, place.crop, added, scene, torch.stack(sums), drawn, pixels)

    def _reached(self, windows: Sequence[Window], footprints: Windows) -> "_Kept":
        """The products of all modules, for what they draw in windows of their light textures."""
        kept = self._kept
        if kept is None or not kept.serve(windows, footprints):
            width, model = self.view.base.shape[1], self.sensor.model
            modules, roads = [], []
            for module, window, number in zip(self.projector.modules, windows, self.symbol.drawn_by, strict=True):
                transport = cast(Transport, self.view.transports[number])
                controller = cast(Ssc, module.pixel_controller)
                modules.append(Reached.of(controller, window, transport, width, self.simulation.modules[number].flux))
            crops = [each.crop for each in modules if each.crop != EMPTY] + ([footprints.hull] if footprints.height else [])
            place = _Place.of(self, hull(crops) if crops else EMPTY)
            for each, flat in zip(modules, model.transports, strict=True):
                roads.append(tuple(each.onto(transport, place.crop) for transport in (each.transport, flat)))
            world, flat_road = zip(*roads, strict=True)
            self._kept = kept = _Kept(place, tuple(modules), (world, flat_road))
        return kept


@dataclass(frozen=True, eq=False)
class _Place:
    """A crop of the image with what is there without the symbols, `[h, w]` cd/m^2: resting light, light without the lamps, the threshold
    of extraction.
    """

    crop: Crop
    resting: Tensor
    base: Tensor
    limit: Tensor

    @classmethod
    def of(cls, copies: Copies, crop: Crop) -> "_Place":
        """With some px around a crop."""
        view = copies.view
        crop = crop.widen(AROUND_PX, *view.base.shape)
        resting = _luminance(view.transports, [copies.resting], view.base, crop)[0]
        return cls(crop, resting, view.base[crop.slices], copies.sensor.model.limit[crop.slices])

    def scene(self, windows: Windows, added: Tensor, flat: Tensor) -> Scene | None:
        """Of light `[B, h, w]` that symbols add to the world and to the flat road; None where no window holds anything."""
        if not windows.height:
            return None
        return Scene(windows, *(windows.cut(each, self.crop) for each in (added, self.resting, self.base, flat, self.limit)))


@dataclass(frozen=True, eq=False)
class _Kept:
    """What modules reach. roads: of each module, from its pixels to the crop on the world's road, and on the flat road."""

    place: _Place
    modules: tuple[Reached, ...]
    roads: tuple[tuple[Csr, ...], tuple[Csr, ...]]

    def serve(self, windows: Sequence[Window], footprints: Windows) -> bool:
        drawn = all(each.drawn.window.holds(window) for each, window in zip(self.modules, windows, strict=True))
        return drawn and (not footprints.height or self.place.crop.holds(footprints.hull))


def _luminance(transports: Any, lights: list[Lights], base: Tensor, crop: Crop) -> Tensor:
    """Luminance `[B, h, w]` in cd/m^2 at a crop, of lights on top of a base `[height, width]`."""
    rows, columns = crop.slices
    return torch.stack([added_light(transports, light, base, rows)[:, columns] for light in lights])


def _parts(count: int) -> list[slice]:
    """Groups of count copies that are computed at once."""
    return [slice(k, k + TOGETHER) for k in range(0, count, TOGETHER)]
