"""The controller's internal model (T 9.4.1): noise-free image of the projected symbol on a flat, empty road."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import Projector
from luxloop.perception.appearance import Appearance, Axes, appearance, area, error_indices, features, image_axes, probes
from luxloop.perception.birdseye import BirdsEye, birds_eye, rectify, region_around
from luxloop.perception.camera import CameraParams, average_rows, camera_view
from luxloop.perception.extraction import Extraction, noise_limit, symbol_image
from luxloop.world.frames import View
from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.light.illumination import Transport, added_light, lit_surface, transport
from luxloop.world.materials.library import RoadSurfaceParams
from luxloop.world.params import Params
from luxloop.world.rendering.gbuffer import flat_road
from luxloop.world.texels import Window


class FeatureParams(Params):
    """Features of the symbol that the controller uses."""

    view: Literal["raw", "birdseye"] = Field("raw", description="the camera's image, or the z = 0 plane rectified")
    shape: Literal["quadrants", "moments"] = Field("quadrants", description="quadrant centroids as in the thesis, or second moments")


@dataclass(frozen=True)
class Eye:
    """Features of symbol images, in the camera's image or in a bird's-eye view. plane: the bird's-eye view, None for the camera's image."""

    view: View
    plane: BirdsEye | None
    shape: str

    def look(self, symbol: Tensor, crop: Window) -> Appearance:
        """Appearance of a symbol image `[..., h, w]` at a crop of the camera's image."""
        return appearance(self._image(symbol, crop), self._axes(symbol, crop))

    def look_beside(self, symbol: Tensor, expected: Tensor, crop: Window) -> tuple[Appearance, Tensor]:
        """Appearance of a symbol image, and area `[...]` of the expected symbol image `[..., h, w]`."""
        axes = self._axes(symbol, crop)
        return appearance(self._image(symbol, crop), axes), area(self._image(expected, crop), axes)

    def _image(self, symbol: Tensor, crop: Window) -> Tensor:
        return symbol if self.plane is None else rectify(self.plane, symbol, crop.u_start, crop.v_start)

    def _axes(self, symbol: Tensor, crop: Window) -> Axes:
        height, width = symbol.shape[-2:]
        return image_axes(height, width, crop.u_start, crop.v_start, symbol) if self.plane is None else self.plane.axes

    def features(self, seen: Appearance) -> Tensor:
        """Features `[..., 4]`: centre u, centre v, roll, pitch."""
        return features(seen, self.shape)


@dataclass(frozen=True)
class FlatModel:
    """Forward model of the symbol on a flat road.

    transports: matrices from utilisations to the camera's pixels, one a module. beams: luminance of the base beams, `[height, width]`
    cd/m^2. limit: threshold of extraction, `[height, width]` cd/m^2. params: of extraction. eye: features of symbol images. target: `[n]`,
    features at the target. gains: `[n]`, plant gains at the target: change of the paired feature per m or rad of x, y, roll, pitch. albedo:
    of the road.
    """

    transports: tuple[Transport, ...]
    beams: Tensor
    limit: Tensor
    params: Extraction
    eye: Eye
    target: Tensor
    gains: Tensor
    albedo: float

    def luminance(self, lights: Sequence[Utilisation], rows: slice | None = None) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 that the lamps add to their base beams on the flat road; rows: by default all."""
        return added_light(self.transports, lights, self._without_beams, rows)

    @cached_property
    def _without_beams(self) -> Tensor:
        return -self.beams

    def contrast(self, lights: Sequence[Utilisation], crop: Window) -> tuple[Tensor, Tensor]:
        """Luminance `[..., h, w]` that the lamps add to their base beams, and threshold `[h, w]`, in cd/m^2 at a crop of the image."""
        rows, columns = crop.slices
        return self.luminance(lights, rows)[..., columns], self.limit[crop.slices]

    def symbol(self, lights: Sequence[Utilisation], crop: Window) -> Tensor:
        """Symbol image `[..., h, w]` that extraction would find without noise."""
        return symbol_image(*self.contrast(lights, crop), self.params)


def flat_model(
    projector: Projector,
    camera: CameraParams,
    surface: RoadSurfaceParams,
    ambient_lx: float,
    params: Extraction,
    what: FeatureParams,
) -> FlatModel:
    """Build the model for a camera and an assumed road of uniform, unmarked asphalt under ambient light in lx; measure target and gains."""
    view, samples = camera_view(camera), camera.oversampling
    ground = flat_road(view.with_rows(samples), surface.seen_albedo, material=surface.ground).to(projector.symbol.device)
    transports = []
    for module in projector.modules:
        headlight = module.pixel_controller.headlight
        transports.append(transport(lit_surface(ground, headlight, module.T_body_headlight), headlight, view.width, samples))
    ambient = average_rows(ambient_luminance(ground, ambient_lx), samples)
    beams = added_light(transports, projector.resting, torch.zeros_like(ambient))
    limit = noise_limit(ambient + beams, camera, params)
    symbol = projector.params
    region = region_around(symbol.x_m, symbol.y_m, symbol.length_m, symbol.width_m)
    plane = birds_eye(region, view).to(limit.device) if what.view == "birdseye" else None
    model = FlatModel(
        tuple(transports), beams, limit, params, Eye(view, plane, what.shape), torch.zeros(()), torch.ones(()), surface.seen_albedo
    )

    def seen(pose: Tensor) -> Tensor:
        crop = projector.footprint(ProjectionCommand(pose), view, params.footprint_margin_m)
        return model.eye.features(model.eye.look(model.symbol(projector.light(pose), crop), crop))

    target = projector.target
    gains = [(seen(target + h) - seen(target - h))[k] / (2 * h.sum()) for h, k in zip(probes(target), error_indices(), strict=True)]
    return replace(model, target=seen(target), gains=torch.stack(gains))
