"""What a symbol controller sees: frames in, errors of the symbol's four degrees of freedom or the reason for its loss out."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from controllers.ssc import Utilisation
from controllers.symbol.drawing import Drawing
from controllers.symbol.flat_model import PAIRED, FlatModel
from controllers.symbol.projector import Projector
from perception.appearance import Appearance, errors
from perception.camera import CameraParams
from perception.extraction import Crop, Extraction, Loss, difference, gate, symbol_image, threshold


@dataclass(frozen=True)
class Seen:
    """One look at the symbol.

    code: `[...]` int64, a `Loss`. errors: `[..., 4]`, e_x, e_y, e_roll, e_pitch in the units of the features. pose_error: `[..., 4]`, the
    same in m and rad of x, y, roll, pitch, each divided by its plant gain. area_ratio: `[...]`, seen to expected. appearance: five
    centroids and second moments. symbol: `[..., h, w]`, cut from the camera's image at crop.
    """

    code: Tensor
    errors: Tensor
    pose_error: Tensor
    area_ratio: Tensor
    appearance: Appearance
    symbol: Tensor
    crop: Crop


@dataclass(frozen=True)
class Observer:
    """Extraction in the predicted footprint, gated by the flat model's expectation; errors against the flat model's target."""

    projector: Projector
    model: FlatModel
    camera: CameraParams
    params: Extraction

    def look(self, frames: tuple[Tensor, Tensor] | None, drawing: Drawing, lights: Sequence[Utilisation]) -> Seen:
        """Look at the on and off frames `[..., height, width]` (digital numbers) that show the light of a drawing.

        frames: None where the camera lost them. lights: the utilisations that were shown, one a module.
        """
        crop = self.projector.footprint(drawing, self.model.eye.view, self.params.footprint_margin_m)
        if frames is None:
            return self.lost(drawing.pose, Loss.NO_FRAME)
        if crop.v_stop - crop.v_start < 2 or crop.u_stop - crop.u_start < 2:
            return self.lost(drawing.pose, Loss.NOTHING)
        on, off = (frame[..., *crop.slices] for frame in frames)
        return self.compare(on, off, self.model.symbol(lights, crop), crop)

    def compare(self, on: Tensor, off: Tensor, expected_symbol: Tensor, crop: Crop) -> Seen:
        """Look at frames `[..., h, w]` (digital numbers) cut at crop, beside the symbol image that the flat road would show there."""
        contrast, limit = difference(on, off, self.camera), threshold(off, self.camera, self.params)
        symbol = symbol_image(contrast, limit, self.params)
        seen = self.model.eye.look(symbol, crop)
        expected = self.model.eye.area(expected_symbol, crop)
        error = errors(self.model.eye.features(seen), self.model.target)
        pose_error = error[..., PAIRED] / self.model.gains
        return Seen(gate(seen.area, expected, self.params), error, pose_error, seen.area / expected, seen, symbol, crop)

    def rendered(self, drawing: Drawing, lights: Sequence[Utilisation]) -> Tensor:
        """Features `[..., 4]` that a flat road would show of the light of a drawing, without noise."""
        crop = self.projector.footprint(drawing, self.model.eye.view, self.params.footprint_margin_m)
        return self.model.eye.features(self.model.eye.look(self.model.symbol(lights, crop), crop))

    def lost(self, pose: Tensor, reason: Loss) -> Seen:
        """What is seen of poses `[..., 4]` where there is nothing to look at."""
        nan = torch.full_like(pose, torch.nan)
        batch = pose.shape[:-1]
        nothing = Appearance(nan[..., 0], pose.new_full((*batch, 5, 2), torch.nan), nan[..., 0], nan[..., 0])
        code = torch.full(batch, reason, dtype=torch.int64, device=pose.device)
        return Seen(code, nan, nan, torch.zeros_like(nan[..., 0]), nothing, pose.new_zeros(*batch, 0, 0), Crop(0, 0, 0, 0))
