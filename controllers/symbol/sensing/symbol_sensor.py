"""The symbol sensor: from frames to errors of the symbol's four degrees of freedom (T 9.4.1), or the reason of its loss; its
internal model, which is the noise-free image of the symbol on a flat, empty road; and the protocol of the controllers that get them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import Projector
from luxloop.controllers.symbol.sensing.relocalisation import Relocalisation, Relocaliser
from luxloop.perception.appearance import Appearance, Axes, appearance, area, error_indices, errors, features, image_axes, probes
from luxloop.perception.birdseye import BirdsEye, birds_eye, rectify, region_around
from luxloop.perception.camera import CameraParams, average_rows, camera_view, expose, luminance_of
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import Extraction, ExtractionStatus, difference, gate, noise_limit, symbol_image, threshold
from luxloop.world.caches import Part, PartialImage
from luxloop.world.frames import View
from luxloop.world.light.backscatter import Backscatter
from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.light.illumination import Transport, added_light, lit_surface, transport
from luxloop.world.materials.library import RoadSurfaceParams
from luxloop.world.params import Params
from luxloop.world.rendering.gbuffer import GBuffer, flat_road
from luxloop.world.scene.air import Medium
from luxloop.world.texels import NOWHERE, Window


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


def flat_transports(
    projector: Projector, view: View, surface: RoadSurfaceParams, samples: int = 1
) -> tuple[GBuffer, tuple[Transport, ...]]:
    """Flat road in a view with `samples` rows in a pixel, and matrices from utilisations to its pixels, one a module."""
    ground = flat_road(view.with_rows(samples), surface.seen_albedo, material=surface.ground).to(projector.symbol.device)
    drawing = [(module.pixel_controller.headlight, module.T_body_headlight) for module in projector.modules]
    return ground, tuple(transport(lit_surface(ground, light, T), light, view.width, samples) for light, T in drawing)


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
    ground, transports = flat_transports(projector, view, surface, samples)
    ambient = average_rows(ambient_luminance(ground, ambient_lx), samples)
    beams = added_light(transports, projector.resting, torch.zeros_like(ambient))
    limit = noise_limit(ambient + beams, camera, params)
    symbol = projector.params
    region = region_around(symbol.x_m, symbol.y_m, symbol.length_m, symbol.width_m)
    plane = birds_eye(region, view).to(limit.device) if what.view == "birdseye" else None
    model = FlatModel(transports, beams, limit, params, Eye(view, plane, what.shape), torch.zeros(()), torch.ones(()), surface.seen_albedo)

    def seen(pose: Tensor) -> Tensor:
        crop = projector.footprint(ProjectionCommand(pose), view, params.footprint_margin_m)
        return model.eye.features(model.eye.look(model.symbol(projector.light(pose), crop), crop))

    target = projector.target
    gains = [(seen(target + h) - seen(target - h))[k] / (2 * h.sum()) for h, k in zip(probes(target), error_indices(), strict=True)]
    return replace(model, target=seen(target), gains=torch.stack(gains))


LIT = 0.5  # lit share above which a pixel belongs to the symbol
ENDS = 0.1  # share of a footprint's rows that are its near end, and its far end


@dataclass(frozen=True)
class Measurement:
    """One measurement of the symbol.

    code: `[...]` int64, an `ExtractionStatus`. errors: `[..., 4]`, e_x, e_y, e_roll, e_pitch in the units of the features: measured
    features minus the flat model's target; valid if the symbol is seen. The target is fixed to the body, so body motion causes errors even
    for a symbol at its place on the ground; `Projection.ego` has the motion. pose_error: `[..., 4]`, the errors in m and rad of x, y, roll,
    pitch, each divided by its plant gain. area_ratio: `[...]`, measured over expected area. appearance: five centroids and second moments.
    symbol: `[..., h, w]` in 0..1, lit share of each pixel of the crop. crop: window of the camera's image. shape: `[4]` of the road assumed
    for the crop (`luxloop.controllers.symbol.sensing.road_shape`), None for a flat road. acquired: result of a search of the whole image,
    None without a search.
    """

    code: Tensor
    errors: Tensor
    pose_error: Tensor
    area_ratio: Tensor
    appearance: Appearance
    symbol: Tensor
    crop: Window
    shape: Tensor | None = None
    acquired: Relocalisation | None = None


@dataclass(frozen=True)
class SymbolSensor:
    """Extraction in the predicted footprint, gated by the expected area; errors against the flat model's target.

    A symbol missing from the footprint is searched for in the whole image. projector: drawing modules and symbol. model: of the flat road.
    camera: its parameters. params: of extraction. searches: whether whole images are searched.
    """

    projector: Projector
    model: FlatModel
    camera: CameraParams
    params: Extraction
    searches: bool = True

    @cached_property
    def _backscatter(self) -> Backscatter | None:
        visibility_m = self.params.visibility_m
        return None if visibility_m is None else Backscatter(Medium.fog(visibility_m), camera_view(self.camera))

    def compensate(self, frames: tuple[Tensor, Tensor] | None, lights: Sequence[Utilisation]) -> tuple[Tensor, Tensor] | None:
        """On and off frame with the symbol's backscatter in both, so that their difference is light on the road; the same in clear air.

        The off frame then also has the on frame's noise level. lights: utilisations in the frames, one a module.
        """
        if frames is None or (air := self._backscatter) is None:
            return frames
        on, off = frames
        lit = [
            (module.pixel_controller.headlight, module.T_body_headlight.double().cpu(), light.u - beam.u)
            for module, light, beam in zip(self.projector.modules, lights, self.projector.resting, strict=True)
        ]

        def part_of(part: Part) -> Tensor:
            return expose(luminance_of(off[part], self.camera) + air.luminance(lit, part, of_texels=False), self.camera, quantise=False)

        return on, PartialImage.of(off.shape[-2], off.shape[-1], lights[0].u[:0], part_of)

    @cached_property
    def relocaliser(self) -> Relocaliser:
        """The search of whole images."""
        return Relocaliser(self.projector.modules, camera_view(self.camera), self.projector.params.x_m)

    def measure(
        self,
        frames: tuple[Tensor, Tensor] | None,
        projection: ProjectionCommand,
        lights: Sequence[Utilisation],
        shape: Tensor | None = None,
    ) -> Measurement:
        """Measure the symbol in on and off frame `[height, width]` (digital numbers) of the light of a projection.

        frames: None if lost. lights: utilisations in the frames, one a module. shape: `[4]` of the road of the previous measurement, None
        for a flat road; a flat road replaces the shape once the symbol fits only the flat road. No search of whole images for a batch
        `[..., height, width]`.
        """
        if frames is None:
            return replace(self.lost(projection.pose, ExtractionStatus.NO_FRAME), shape=shape)
        seen = self._measure_at(frames, projection, lights, shape if projection.shape is None else projection.shape)
        if seen.code.dim() or not self.searches:
            return seen
        if projection.shape is None and shape is not None and (seen.code != ExtractionStatus.SEEN or self.at_ends(seen)):
            flat = self._measure_at(frames, projection, lights, None)
            seen = flat if flat.code == ExtractionStatus.SEEN and not self.at_ends(flat) else seen
        if seen.code == ExtractionStatus.SEEN:
            return seen
        acquired = self.relocalise(frames, lights)
        if not acquired.found:
            return replace(seen, acquired=acquired)
        found = self._measure_at(frames, projection, lights, acquired.shape)
        if not found.symbol.numel():
            return replace(seen, acquired=acquired)
        return replace(found, code=torch.full_like(found.code, ExtractionStatus.SEEN), acquired=acquired)

    def relocalise(self, frames: tuple[Tensor, Tensor], lights: Sequence[Utilisation]) -> Relocalisation:
        """Search whole on and off frames for lights `[n_p]`, one a module."""
        on, off = frames
        symbol = symbol_image(difference(on, off, self.camera), threshold(off, self.camera, self.params), self.params)
        return self.relocaliser.find(symbol, self.projector.textures(lights))

    def _measure_at(
        self, frames: tuple[Tensor, Tensor], projection: ProjectionCommand, lights: Sequence[Utilisation], shape: Tensor | None
    ) -> Measurement:
        """Measure in the footprint on a road of a shape `[4]`; None: flat."""
        crop = self.projector.footprint(projection, self.model.eye.view, self.params.footprint_margin_m, shape)
        if crop.v_stop - crop.v_start < 2 or crop.u_stop - crop.u_start < 2:
            return replace(self.lost(projection.pose, ExtractionStatus.NOTHING), shape=shape)
        on, off = (frame[..., *crop.slices] for frame in frames)
        seen = self.compare(on, off, self.model.contrast(lights, crop), crop)
        if shape is None:
            return seen
        area, expected = seen.symbol.sum((-2, -1)), self.relocaliser.area(shape, self.projector.textures(lights))
        return replace(seen, code=gate(area, expected, self.params), area_ratio=area / expected, shape=shape)

    def at_ends(self, seen: Measurement) -> bool:
        """Whether the symbol reaches the footprint's ends, so that the road may lie beyond its margin."""
        rows = max(round(ENDS * len(seen.symbol)), 1)
        top, bottom = (bool((end > LIT).any()) for end in (seen.symbol[:rows], seen.symbol[-rows:]))
        return (top and seen.crop.v_start > 0) or (bottom and seen.crop.v_stop < self.model.eye.view.height)

    def compare(self, on: Tensor, off: Tensor, expected: tuple[Tensor, Tensor], crop: Window) -> Measurement:
        """Measure on and off frame `[..., h, w]` (digital numbers) of a crop, against contrast and threshold of the flat road."""
        symbol = symbol_image(difference(on, off, self.camera), threshold(off, self.camera, self.params), self.params)
        seen, area = self.model.eye.look_beside(symbol, symbol_image(*expected, self.params), crop)
        error = errors(self.model.eye.features(seen), self.model.target)
        return Measurement(gate(seen.area, area, self.params), error, self.pose_error(error), seen.area / area, seen, symbol, crop)

    def pose_error(self, error: Tensor) -> Tensor:
        """Errors of features `[..., 4]` in m and rad of x, y, roll, pitch."""
        return error[..., error_indices()] / self.model.gains

    def render(self, projection: ProjectionCommand, lights: Sequence[Utilisation]) -> Tensor:
        """Noise-free features `[..., 4]` of a projection's light on a flat road."""
        crop = self.projector.footprint(projection, self.model.eye.view, self.params.footprint_margin_m)
        return self.model.eye.features(self.model.eye.look(self.model.symbol(lights, crop), crop))

    def lost(self, pose: Tensor, reason: ExtractionStatus) -> Measurement:
        """The measurement of a lost symbol, for poses `[..., 4]`."""
        nan = torch.full_like(pose, torch.nan)
        batch = pose.shape[:-1]
        nothing = Appearance(nan[..., 0], pose.new_full((*batch, 5, 2), torch.nan), nan[..., 0], nan[..., 0])
        code = torch.full(batch, reason, dtype=torch.int64, device=pose.device)
        return Measurement(code, nan, nan, torch.zeros_like(nan[..., 0]), nothing, pose.new_zeros(*batch, 0, 0), NOWHERE)


@dataclass(frozen=True)
class Projection:
    """The light of a step.

    projection: command of the symbol. lights: utilisations, one a module. ego: vehicle motion for which the command was drawn, None for a
    standing vehicle.
    """

    projection: ProjectionCommand
    lights: tuple[Utilisation, ...]
    ego: Ego | None = None


@dataclass(frozen=True)
class Observation:
    """The controller's input in a step.

    measurement: features and errors of the symbol. frames: on and off frame `[height, width]`, digital numbers; None if lost or not yet
    arrived. shown: the light in these frames, older than this step if the camera has latency. ego: present vehicle motion, None for a
    standing vehicle. latency_steps: measured latency, the number of steps from the exposure of the frames to this step.
    """

    measurement: Measurement
    frames: tuple[Tensor, Tensor] | None
    shown: Projection
    ego: Ego | None = None
    latency_steps: int = 0


class SymbolController(Protocol):
    """Holds a symbol by projection commands; its state is a frozen dataclass of tensors."""

    def start(self, pose: Tensor) -> Any:
        """The initial state, whose command shows the pose `[..., 4]` (x, y in m, roll, pitch in rad)."""
        ...

    def projection(self, state: Any, ego: Ego | None) -> ProjectionCommand:
        """The next command. ego: present vehicle motion, newer than the last observation, or None."""
        ...

    def step(self, state: Any, observation: Observation) -> Any:
        """The state after one observation."""
        ...
