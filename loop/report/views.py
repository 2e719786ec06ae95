"""The scene of headlamp pictures: lamps on a car, and views of the road in their light."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.loop.scenario.model import HeadlightParams, Scenario, validate
from luxloop.loop.simulation.lamps import T_world_lamp, T_world_reference
from luxloop.loop.simulation.simulated import build_scene
from luxloop.world.frames import T_ISO_OPENCV, View, pose, pose_from_degrees
from luxloop.world.headlight.lamp import Commands, Lamp, direction
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.light.emitters import Source, ambient_luminance, sources, sun_luminance, surface_light
from luxloop.world.light.volumetric import FARTHEST_M, ShadowMap, airlight, shadow_map
from luxloop.world.rendering.gbuffer import GBuffer, gbuffer
from luxloop.world.rendering.surfaces import FaceSource, face_source
from luxloop.world.scene.air import Medium
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import Triangles

SIDES = ("left", "right")
SHADOW_PX = 1024  # width of a shadow map
BIRDSEYE_X_M, BIRDSEYE_Y_M, BIRDSEYE_CELL_M = (-6.0, 100.0), (-20.0, 20.0), 0.1
BIRDSEYE_HEIGHT_M = 300.0  # of the pinhole: it displaces the top of a body 1.5 m high, 50 m aside, by 25 cm
NIGHT_LX = 0.03  # ambient light of a clouded night near a town, a tenth of the full moon's
NEAR_BY = 0.05  # tolerance of a pixel's place on the road, relative to its distance, since a row of pixels spans metres far ahead
LUMINANCE_OF_RGB = np.array(LUMINANCE, np.float32)
Image = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class LitCar:
    """A car's lamps by side, "left" and "right" or one of them, with utilisations `[n_p]`, one a module, by side."""

    lamps: Mapping[str, Lamp]
    patterns: Mapping[str, Sequence[Tensor]]
    mount: HeadlightParams = field(default_factory=HeadlightParams)

    def under(self, commands: Mapping[str, Commands]) -> "LitCar":
        """The car with modules swivelled, levelled and dimmed. commands: by side, one a module; other sides stay as they are."""
        lamps, patterns = dict(self.lamps), dict(self.patterns)
        for side in lamps.keys() & commands.keys():
            modules = zip(lamps[side].modules, commands[side], strict=True)
            lamps[side] = replace(lamps[side], modules=tuple(replace(m, T_lamp_module=c.turn(m.T_lamp_module)) for m, c in modules))
            patterns[side] = [command.intensity * u for u, command in zip(patterns[side], commands[side], strict=True)]
        return replace(self, lamps=lamps, patterns=patterns)

    @property
    def T_world_middle(self) -> Tensor:
        """As `T_world_reference`."""
        return T_world_reference(self.lamps, self.mount)

    @cached_property
    def sources(self) -> tuple[Source, ...]:
        """All modules that shine, in colour if one of them is coloured."""
        colour = any(module.headlight.chroma is not None for lamp in self.lamps.values() for module in lamp.modules)
        return tuple(
            source
            for side, lamp in self.lamps.items()
            for source in sources(lamp, self.patterns[side], T_world_lamp(side, self.mount), colour)
        )

    def intensity(self, h_deg: Tensor, v_deg: Tensor) -> Tensor:
        """Luminous intensity in cd of all lamps together in the far field, in the shape of the angles."""
        ray = direction(h_deg, v_deg).flatten(1)
        lamps = [lamp.intensity(self.patterns[side], ray) for side, lamp in self.lamps.items()]
        return torch.stack(lamps).sum(0).view(h_deg.shape)


@dataclass(frozen=True)
class RoadView:
    """A view of the road: illuminance `[H, W]` in lx, NaN without a surface; luminance `[H, W]` in cd/m^2, or `[H, W, 3]` linear sRGB."""

    view: View
    surfaces: GBuffer
    illuminance: Image
    luminance: Image

    def on_road(self, x_m: float, y_m: float) -> tuple[float, float] | None:
        """Image point in px of a place on the road; None if the place is not visible."""
        x, y, z = self.surfaces.position.flatten(1)
        away = torch.hypot(x - x_m, y - y_m).masked_fill(self.surfaces.object_id.flatten() != 0, torch.inf)
        nearest = int(away.argmin())
        if away[nearest] > NEAR_BY * x_m:
            return None
        u, v = self.view.project(torch.tensor([[x_m], [y_m], [float(z[nearest])]], dtype=torch.float64))[0][:, 0].tolist()
        return u, v


class Road:
    """A scenario's road and objects at one time."""

    def __init__(self, scenario: Scenario | None = None, time_s: float = 0.0) -> None:
        """scenario: by default flat asphalt with a lane's markings."""
        plain = {"name": "flat road", "surface": {"markings": True}, "light": {"ambient_lx": NIGHT_LX}}
        self.scenario, self.time_s = scenario or validate(plain, "flat road"), time_s

    @property
    def lane_width_m(self) -> float:
        return self.scenario.surface.lane_width_m

    @cached_property
    def _scene(self) -> Scene:
        return build_scene(self.scenario)

    @cached_property
    def _triangles(self) -> Triangles:
        return self._scene.at(self.time_s)

    @cached_property
    def _face_source(self) -> FaceSource:
        return face_source(self.scenario.renderer)

    def look(self, car: LitCar, view: View, air: Medium | None = None) -> RoadView:
        """The road in the light of the car. air: fog that attenuates and scatters light; None for clear air.

        Raises LuxloopError if the scenario names missing data.
        """
        surfaces = gbuffer(self._triangles, view, self._face_source.face_ids(self._triangles, view)).in_air(air, view.origin)
        illuminance, luminance = surface_light(surfaces, car.sources, self._shades)
        others = self._scene.spotlights_at(self.time_s)
        luminance = luminance + ambient_luminance(surfaces, self._scene.ambient_lx, self._scene.street_lamps, others)
        if self._scene.sun is not None:
            luminance = luminance + sun_luminance(surfaces, self._scene.sun, self._triangles, view.origin)
        if air:
            luminance = luminance + self._airlight(air, surfaces, view, car.sources)
        total = np.where(surfaces.object_id.numpy() < 0, np.nan, grey(picture(illuminance)))
        return RoadView(view, surfaces, total, picture(luminance))

    def _airlight(self, air: Medium, surfaces: GBuffer, view: View, lit: Sequence[Source]) -> Tensor:
        """Luminance `[..., H, W]` in cd/m^2 of the lamps' light that the air scatters towards the eye."""
        rays = view.rays().flatten(1)
        directions = (rays / rays.norm(dim=0)).float()
        distance = (surfaces.position.flatten(1) - view.origin[:, None]).norm(dim=0).float()
        distance = torch.where(surfaces.object_id.flatten() >= 0, distance, FARTHEST_M)
        total = distance.new_zeros(())
        for source in lit:
            shadow = None if self._shades is None else self._shadow(source)
            total = total + airlight(source, view.origin, directions, distance, air, shadow=shadow)
        return total.unflatten(-1, surfaces.albedo.shape) if lit else total

    @property
    def _shades(self) -> Triangles | None:
        """Triangles that cast shadows; None where nothing does."""
        return None if self.scenario.road.kind == "flat" and not self.scenario.all_objects else self._triangles

    def _shadow(self, source: Source) -> ShadowMap:
        light = source.headlight
        height = math.ceil(SHADOW_PX * (light.top - light.bottom) / (light.left - light.right))
        view = light.view(source.T_world_source, SHADOW_PX, min(max(height, 64), SHADOW_PX))
        return shadow_map(self._triangles, view, self._face_source)


def picture(light: Tensor) -> Image:
    """Light `[H, W]`, or linear sRGB `[3, H, W]`, as an array `[H, W]` or `[H, W, 3]`."""
    return (light if light.dim() == 2 else light.movedim(0, -1)).cpu().numpy()


def grey(image: Image) -> Image:
    """Luminance `[H, W]` of an image `[H, W]`, or `[H, W, 3]` in linear sRGB."""
    return image if image.ndim == 2 else image @ LUMINANCE_OF_RGB


def driver(width_px: int = 1280) -> View:
    """The view of a driver who sits on the left: 40 deg wide, 16 : 9, the horizon above the middle."""
    return _pinhole((-1.5, 0.36, 1.2), 4.0, 0.0, 40.0, width_px)


def oncoming(width_px: int = 1280) -> View:
    """The view of the driver of another car, who sits on the left, in the frame of that car: as of `driver`."""
    return _pinhole((0.3, 0.36, 1.2), 4.0, 0.0, 40.0, width_px)


def beside(width_px: int = 960) -> View:
    """The view from behind, above and to the left of the car, for beams in fog: 56 deg wide, 16 : 9."""
    return _pinhole((-10.5, 6.5, 3.4), 8.0, -27.0, 56.0, width_px)


def birdseye(cell_m: float = BIRDSEYE_CELL_M, x_m: tuple[float, float] = BIRDSEYE_X_M) -> View:
    """The view from above: columns along x, ahead to the right, row 0 at the far left of the car."""
    (x0, x1), (y0, y1) = x_m, BIRDSEYE_Y_M
    width, height = round((x1 - x0) / cell_m), round((y1 - y0) / cell_m)
    focal = BIRDSEYE_HEIGHT_M / cell_m
    down = torch.tensor([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]], dtype=torch.float64)
    eye = torch.tensor([(x0 + x1) / 2, (y0 + y1) / 2, BIRDSEYE_HEIGHT_M], dtype=torch.float64)
    return View(width, height, focal, focal, width / 2, height / 2, pose(eye, down))


def chase(width_px: int = 1280) -> View:
    """The view from behind and above the car: 46 deg wide, 16 : 9."""
    return _pinhole((-14.5, 0.0, 3.8), 8.0, 0.0, 46.0, width_px)


def above(width_px: int = 1280) -> View:
    """The view from above, x to the right: 71 m long, from 6 m behind the lamps, 16 : 9."""
    return birdseye((BIRDSEYE_Y_M[1] - BIRDSEYE_Y_M[0]) / round(width_px * 9 / 16), (BIRDSEYE_X_M[0], BIRDSEYE_X_M[0] + 71.1))


def _pinhole(position_m: tuple[float, float, float], pitch_deg: float, yaw_deg: float, hfov_deg: float, width: int) -> View:
    """A view from a place in m, nose down by the pitch, 16 : 9."""
    height = round(width * 9 / 16)
    focal = width / 2 / math.tan(math.radians(hfov_deg) / 2)
    T = pose_from_degrees(position_m, pitch_deg=pitch_deg, yaw_deg=yaw_deg) @ T_ISO_OPENCV
    return View(width, height, focal, focal, width / 2, height / 2, T)
