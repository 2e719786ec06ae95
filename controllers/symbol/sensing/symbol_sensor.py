"""The symbol sensor: from frames to errors of the symbol's four degrees of freedom (T 9.4.1), or the reason of its loss; and the
protocol of the controllers that get them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.sensing.flat_model import FlatModel
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import Projector
from luxloop.controllers.symbol.sensing.relocalisation import Relocalisation, Relocaliser
from luxloop.perception.appearance import Appearance, error_indices, errors
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.egomotion import Ego
from luxloop.perception.extraction import Extraction, ExtractionStatus, difference, gate, symbol_image, threshold
from luxloop.world.texels import NOWHERE, Window

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
