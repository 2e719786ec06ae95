"""Whether a symbol's light can be drawn and measured at its target at all."""

import math

from torch import Tensor

from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import DrawingModule, Projector, SymbolParams
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.loop.simulation.judging import Judge
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import saturation_luminance
from luxloop.perception.metrics import THRESHOLD
from luxloop.world.errors import LuxloopError
from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.rendering.gbuffer import flat_road


def check_light(sensor: SymbolSensor, judge: Judge | None, beam: str) -> None:
    """Raises LuxloopError where lamps cannot draw the symbol at its target, or the camera cannot measure it.

    beam: name of the base beam.
    """
    projector, camera, model = sensor.projector, sensor.camera, sensor.model
    where = _target(projector.params)
    if projector.params.quantity == "u_rel" and not any(bool(each.u.any()) for each in projector.resting):
        raise LuxloopError('quantity: u_rel is a multiple of the base beam, but there is none; give lighting.base.beam = "low", say')
    if judge is not None and not judge.goal.mask.any():
        if beam != "off" and model.beams.any():
            raise LuxloopError(f"{where} is nowhere brighter than the {beam} beam; raise value, or name a dimmer beam")
        raise LuxloopError(
            f"{where} is out of the lamps' reach, or the symbol is too small for their pixels ({_pixels_there(projector)}); move it, "
            "draw it larger, or let another lamp draw it"
        )
    if not (model.gains.isfinite() & (model.gains != 0)).all():
        raise LuxloopError(
            f"{where} cannot be distinguished from noise on a flat road ({_pixels_there(projector)}); raise value or "
            "headlight.intensity_cd, draw the symbol larger or with wider strokes, or take a lamp with finer pixels or a finer camera"
        )
    brightest = float(brightness(sensor, judge) + model.beams.median())
    if judge is not None:
        brightest += float(_without_headlamps(sensor, judge.world).median())
    if brightest > saturation_luminance(camera):
        raise LuxloopError(
            f"the symbol on the road has {brightest:.3g} cd/m^2, but the camera saturates at "
            f"{saturation_luminance(camera):.3g} cd/m^2; shorten camera.exposure_s, or raise camera.saturation_e"
        )


def brightness(sensor: SymbolSensor, judge: Judge | None) -> Tensor:
    """Median luminance `[]` in cd/m^2 of the symbol at its target on a flat road."""
    if judge is not None:
        return judge.goal.median
    flat = sensor.model.luminance(sensor.projector.light(sensor.projector.target))
    return flat[flat > THRESHOLD * flat.max()].median()


def _without_headlamps(sensor: SymbolSensor, world: World) -> Tensor:
    """Luminance `[h, w]` in cd/m^2 of a flat road where the symbol's target lies, in the light of all but the vehicle's headlamps."""
    target = ProjectionCommand(sensor.projector.target)
    crop = sensor.projector.footprint(target, world.view, sensor.params.footprint_margin_m)
    road, scene = flat_road(world.view.within(*crop.slices), sensor.model.albedo), world.scene
    return ambient_luminance(road, scene.ambient_lx, scene.street_lamps, scene.spotlights_at(0.0))


def _target(symbol: SymbolParams) -> str:
    return f"the target at x_m = {symbol.x_m:g}, y_m = {symbol.y_m:g}"


def _pixels_there(projector: Projector) -> str:
    """How large the finest pixels are, and how large the symbol, seen from the lamp: coarse pixels draw no symbol."""

    def size_deg(module: DrawingModule) -> tuple[float, float]:
        light = module.pixel_controller.headlight
        left, right, bottom, top = (math.degrees(math.atan(tangent)) for tangent in (light.left, light.right, light.bottom, light.top))
        return (left - right) / light.pixel_cols, (top - bottom) / light.pixel_rows

    symbol, module = projector.params, min(projector.modules, key=lambda each: math.prod(size_deg(each)))
    across, down = size_deg(module)
    height = max(float(module.T_world_headlight[2, 3]), 0.1)  # a mount may put it below the road
    distance, half = math.hypot(symbol.x_m, symbol.y_m), 0.5 * symbol.length_m
    width_deg = math.degrees(2 * math.atan2(0.5 * symbol.width_m, distance))
    length_deg = math.degrees(math.atan2(height, distance - half) - math.atan2(height, distance + half))
    return (
        f"a pixel of {module.name} spans about {across:.3g} x {down:.3g} deg across and down, and the symbol "
        f"{width_deg:.3g} x {length_deg:.3g} deg seen from the lamp"
    )
