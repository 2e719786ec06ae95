"""Copies of one symbol in one standing world: many poses are drawn, seen and judged at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor

from controllers.pixels.ssc import Ssc, Utilisation
from controllers.pixels.windowed import WindowedSsc, serves
from controllers.pixels.windows import Window, union
from controllers.symbol.sensing.projection import ProjectionCommand
from controllers.symbol.sensing.symbol_sensor import Measurement
from loop.lighting.simulation import Simulation
from loop.scenario.model import only
from loop.scenario.plant import SimulatedPlantParams
from perception.camera import expose
from perception.extraction import Crop, Loss, symbol_image
from perception.judge import Verdict, judge
from perception.noise import FrameNoise
from world.errors import LuxloopError
from world.light.illumination import Transport, added_light
from world.spmv import Csr, multiply

Lights = tuple[Utilisation, ...]
AROUND_TEXELS, AROUND_PX = 32, 16  # by which products that are kept reach beyond what was asked for, since poses move on


def check(simulation: Simulation, otherwise: str = "run it one by one") -> None:
    """Raises LuxloopError where a scenario is no lone symbol in a standing world, or something disturbs it at some steps alone.

    otherwise: what is advised to keep it.
    """
    scenario = simulation.scenario
    only(scenario.controlled)
    if scenario.metered:
        others = "other functions, the detector and objects' categories"
        raise LuxloopError(f"{scenario.name}: batches are of a single symbol; take {others} out, or {otherwise}")
    if scenario.lighting.painted:
        raise LuxloopError(f"{scenario.name}: lighting.painted: batches show no painted pixels; leave it out, or {otherwise}")
    if timed := [key for key in ("start_s", "stop_s", "indicated") if getattr(scenario.symbol, key) is not None]:
        key = f"functions.{only(scenario.controlled)}.{timed[0]}"
        raise LuxloopError(f"{scenario.name}: {key}: batches show the symbol in all steps; leave it out, or {otherwise}")
    if found := [name for name in ("oncoming", "ambient", "noise", "drops") if getattr(scenario.disturbances, name)]:
        raise LuxloopError(f"{scenario.name}: batches do not support disturbances.{found[0]}; leave it out, or {otherwise}")
    if not isinstance(scenario.plant, SimulatedPlantParams):
        raise LuxloopError(f"{scenario.name}: batches need the simulated plant, not {scenario.plant.kind}; {otherwise}")
    world = simulation.world
    if scenario.vehicle is not None or world.moving or not all(isinstance(each, Transport) for each in world.lit(0.0).transports):
        raise LuxloopError(f"{scenario.name}: batches are for scenes in which nothing moves; {otherwise}")


@dataclass(frozen=True, eq=False)
class Light:
    """What the camera gets of B poses, without noise, at one crop of its image: luminances in cd/m^2.

    poses: `[B, 4]`, x, y in m, roll, pitch in rad. lit: `[B, h, w]`, of all light. resting: `[h, w]`, of all but the symbols'. flat:
    `[B, h, w]`, what the symbols would add on the flat road that the controller assumes.
    """

    poses: Tensor
    crop: Crop
    lit: Tensor
    resting: Tensor
    flat: Tensor


class Copies:
    """Poses of a scenario's only symbol in its world at rest. Raises LuxloopError as `check`.

    The parts of the matrices that one look needed are kept for the next.
    """

    def __init__(self, simulation: Simulation) -> None:
        check(simulation)
        self.simulation, self.symbol = simulation, simulation.symbol
        self.projector, self.model = self.symbol.projector, self.symbol.sensor.model
        self.view, planner = simulation.world.lit(0.0), simulation.planner
        plan = planner.composed(simulation.situation(0.0), planner.start(), {})
        beams = [module.base(plan) for module in simulation.modules]
        self.resting = tuple(Utilisation(beam, None if bool(beam.any()) else slice(0, 0)) for beam in beams)
        primitive = self.projector.primitive(self.projector.target)
        self.windowed = all(serves(each.pixel_controller, primitive, each.T_world_headlight) for each in self.projector.modules)
        self._kept: list[_Products] = []

    def show(self, poses: Tensor) -> Light:
        """The light of poses `[B, 4]`."""
        crop = self.symbol.footprint(ProjectionCommand(poses))
        if crop.v_stop - crop.v_start < 2 or crop.u_stop - crop.u_start < 2:
            dark = poses.new_zeros(len(poses), 0, 0)
            return Light(poses, Crop(0, 0, 0, 0), dark, dark[0], dark)
        resting = _luminance(self.view.transports, [self.resting], self.view.base, crop)[0]
        if self.windowed:
            added, flat = self._in_windows(poses, crop)
            return Light(poses, crop, resting + added, resting, flat)
        # One by one: the few rays and pixels that each pose touches are quicker than all of a batch.
        lights = [self.projector.light(pose) for pose in poses]
        shown = [self._among_resting(light) for light in lights]
        lit = _luminance(self.view.transports, shown, self.view.base, crop)
        return Light(poses, crop, lit, resting, _luminance(self.model.transports, lights, -self.model.beams, crop))

    def measured(self, light: Light, noises: Sequence[tuple[int, int]], *, quantise: bool = True) -> Measurement:
        """What the symbol's sensor makes of it, `[B]`. noises: seed and step of each copy's frames, or those of all copies.

        quantise: false leaves digital numbers unrounded, for gradients.
        """
        if not light.lit.numel():
            return self.symbol.sensor.lost(light.poses, Loss.NOTHING)
        part, camera = light.crop.slices, self.simulation.scenario.camera

        def exposed(luminance: Tensor, frame: int) -> Tensor:
            noise = [FrameNoise.of(seed, step, frame).part(part, luminance) for seed, step in noises] if camera.noise else []
            drawn = torch.stack(noise) if len(noise) > 1 else noise[0] if noise else None
            luminance = luminance.expand(len(noise), *luminance.shape) if luminance.dim() < len(noise[1:2]) + 2 else luminance
            return expose(luminance, camera, drawn, quantise=quantise)

        expected = symbol_image(light.flat, self.model.limit[part], self.model.params)
        return self.symbol.sensor.compare(exposed(light.lit, 0), exposed(light.resting, 1), expected, light.crop)

    def judged(self, light: Light) -> Verdict:
        """What the judge says of it, `[B]`."""
        made = self.symbol.judge
        assert made is not None
        added = light.lit - light.resting
        return judge(added, made.plane, made.goal, light.crop.u_start, light.crop.v_start)

    def _among_resting(self, light: Lights) -> Lights:
        """Lights of all modules, of which those that draw show a light in place of their base beams."""
        drawn = dict(zip(self.symbol.drawn_by, light, strict=True))
        return tuple(drawn.get(k, each) for k, each in enumerate(self.resting))

    def _in_windows(self, poses: Tensor, crop: Crop) -> tuple[Tensor, Tensor]:
        """Luminances `[B, h, w]` that the symbols add to the world and to the flat road."""
        primitives = [self.projector.primitive(pose) for pose in poses]
        added: list[Tensor] = []
        for k, module in enumerate(self.projector.modules):
            controller = cast(Ssc, module.pixel_controller)
            castings = [controller.casting(each, module.T_world_headlight) for each in primitives]
            products = self._products(k, controller, union([each.window for each in castings]), crop)
            lit = [products.drawn.utilisation(each) for each in castings]
            added.append(torch.stack([torch.stack([products.seen(road, u, crop) for u in lit]) for road in products.roads]))
        world, flat = sum(added[1:], added[0])
        return world, flat

    def _products(self, k: int, controller: Ssc, window: Window, crop: Crop) -> "_Products":
        """Those of the k-th module that draws."""
        if k == len(self._kept) or not self._kept[k].serves(window, crop):
            drawn = WindowedSsc.of(controller, window.widened(AROUND_TEXELS, controller.headlight))
            around = crop.widened(AROUND_PX, *self.view.base.shape)
            transports = cast(Transport, self.view.transports[self.symbol.drawn_by[k]]), self.model.transports[k]
            roads = tuple(each.onto(around.slices, self.view.base.shape[1], drawn.pixels) for each in transports)
            self._kept[k : k + 1] = [_Products(around, drawn, roads)]
        return self._kept[k]


@dataclass(frozen=True, eq=False)
class _Products:
    """Of a module. drawn: from primitives to pixels. roads: from these `[m]` to a crop of the image `[h * w]`, of the world and of the flat
    road.
    """

    crop: Crop
    drawn: WindowedSsc
    roads: tuple[Csr, ...]

    def serves(self, window: Window, crop: Crop) -> bool:
        return self.drawn.window.holds(window) and self.crop.holds(crop)

    def seen(self, road: Csr, u: Tensor, crop: Crop) -> Tensor:
        """Luminance at a crop `[h, w]` that lies within."""
        kept = self.crop
        image = multiply(road, u).view(kept.v_stop - kept.v_start, kept.u_stop - kept.u_start)
        return image[crop.v_start - kept.v_start : crop.v_stop - kept.v_start, crop.u_start - kept.u_start : crop.u_stop - kept.u_start]


def _luminance(transports: Any, lights: list[Lights], base: Tensor, crop: Crop) -> Tensor:
    """Luminance `[B, h, w]` in cd/m^2 at a crop, of lights on top of a base `[height, width]`."""
    width = base.shape[-1]
    parts = [each.within(crop.v_start * width, crop.v_stop * width) for each in transports]
    rows, columns = crop.slices
    return torch.stack([added_light(parts, light, base[rows])[:, columns] for light in lights])
