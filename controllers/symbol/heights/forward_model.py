"""Forward model: camera image of known light on a road of given heights, for registering heights."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample

from luxloop.controllers.symbol.sensing.road_shape import HERE
from luxloop.controllers.symbol.sensing.symbol_sensor import SymbolSensor
from luxloop.perception.birdseye import Region
from luxloop.perception.camera import CameraParams, average_rows, camera_view, luminance_of
from luxloop.perception.extraction import Extraction, difference, symbol_image, threshold
from luxloop.world.frames import View, inverse
from luxloop.world.headlight import Headlight
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.spmv import Csr, multiply
from luxloop.world.texels import Window, neighbours, resample

SIGMAS = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
BESIDE_PX = 2  # margin in pixels for interpolation
DARKNESS_TEXELS = 3.0  # width of a shadow's edge


@dataclass(frozen=True)
class LampSight:
    """A module's light along lines of sight: the point of a line at height z has homogeneous texture coordinates
    w, u, v of `on_plane + z * per_m`, both `[3, H, w]` (`TexelGrid.projection`).

    factor: `[H, w]`, luminance of the plane in cd/m^2 per cd.
    """

    headlight: Headlight
    on_plane: Tensor
    per_m: Tensor
    factor: Tensor

    def luminance(self, texture: Tensor, heights: Tensor) -> Tensor:
        """Luminance `[B, H, w]` in cd/m^2 of a light texture `[rows, cols]` on heights `[B, H, w]` m, shadowed by nearer heights."""
        ray = torch.addcmul(self.on_plane[:, None], self.per_m[:, None], heights)  # [3, B, H, w]
        place = ray[1:] / ray[0]  # u and v, [2, B, H, w]
        image = texture.expand(len(heights), 1, -1, -1)  # [B, 1, rows, cols]
        seen = grid_sample(image, place.movedim(0, -1), align_corners=False)[:, 0]  # I(ray) in cd, [B, H, w]
        horizon = place[1].flip(-2).cummin(-2).values.flip(-2)  # highest ray (least v) to all nearer points, [B, H, w]
        # L = I(ray) factor (T eq. 2.1.5; factor: albedo cos / (pi d^2) on the plane), minus shadows of nearer heights.
        return seen * self.factor * ((horizon - place[1]) * (self.headlight.rows / 2 / DARKNESS_TEXELS) + 1.5).clamp(0, 1)


@dataclass(frozen=True)
class ForwardModel:
    """Lines of sight through a region of the plane, and the nodes `[rows, cols]` of its heights.

    step: camera columns averaged together. samples: lines of sight a camera row. node: `[4, h * w]` int64 and weight: `[4, h * w]`,
    bilinear, of each pixel of the crop. inside: `[h, w]`, 1 where a pixel sees the region. off_place: `[2, H, W]`, places in the off frame
    of the crop's road points, -1 to 1 over the image; None if the camera has not moved.
    """

    region: Region
    crop: Window
    eye: Tensor
    step: int
    samples: int
    lamps: tuple[LampSight, ...]
    rows: int
    cols: int
    node: Tensor
    weight: Tensor
    inside: Tensor
    camera: CameraParams
    params: Extraction
    off_place: Tensor | None

    @classmethod
    def prepare(
        cls,
        sensor: SymbolSensor,
        region: Region,
        cell_m: tuple[float, float],
        step: int,
        samples: int,
        T_on: Tensor = HERE,
        T_off: Tensor = HERE,
    ) -> "ForwardModel":
        """Compute the lines of sight. cell_m: node distances along and across. T_on, T_off: `T_ground_body` `[4, 4]` at both frames."""
        projector, camera = sensor.projector, sensor.camera
        device = projector.symbol.device
        whole = _from(T_on, camera_view(camera))
        x, y = torch.tensor([[region.x_near_m, region.x_far_m], [region.y_left_m, region.y_right_m]], dtype=torch.float64)
        corners = torch.stack([x.repeat_interleave(2), y.repeat(2), torch.zeros(4, dtype=torch.float64)])  # [3, 4] m
        uv, _ = whole.project(corners)
        (u0, v0), (u1, v1) = (end.tolist() for end in uv.aminmax(dim=1))
        u0, v0 = max(math.floor(u0), 0), max(math.floor(v0), 0)
        width = (min(math.ceil(u1), whole.width) - u0) // step * step
        crop = Window(v0, max(min(math.ceil(v1), camera.height_px), v0), u0, u0 + max(width, 0))
        rays = whole.within(*crop.slices).with_rows(samples).with_columns(step).rays()  # [3, H, w], H = samples * h
        eye = whole.origin
        ground = eye[:, None, None] - rays * (eye[2] / rays[2])  # g, where rays meet z = 0, [3, H, w] m
        lamps = []
        for module in projector.modules:
            T_ground_headlight = T_on @ module.T_body_headlight.cpu().double()
            origin, light = T_ground_headlight[:3, 3], module.pixel_controller.headlight  # [3] m
            P = light.projection @ inverse(T_ground_headlight)[:3]  # of points of the ground to w, u, v, [3, 4]
            on_plane = torch.einsum("ij,jhw->ihw", P[:, :3], ground) + P[:, 3, None, None]
            # Derivative by z of the line of sight g + (e - g) z / e_z, [3, H, w].
            per_m = ((P[:, :3] @ eye + P[:, 3])[:, None, None] - on_plane) / eye[2]
            per_cd = lux_per_cd(origin[:, None] - ground.flatten(1), torch.eye(3).double()[:, 2:])  # [H * w]
            factor = sensor.model.albedo / math.pi * per_cd.view(ground.shape[1:])
            parts = (part.float().to(device) for part in (on_plane, per_m, factor))
            lamps.append(LampSight(light, *parts))
        middle = average_rows(ground, samples)  # [3, h, w] m
        rows = max(2, round((region.x_far_m - region.x_near_m) / cell_m[0]))
        cols = max(2, round((region.y_left_m - region.y_right_m) / cell_m[1]))
        # Shares of the region's length and width, 0..1 inside, [2, h, w].
        down = (middle[0] - region.x_far_m) / (region.x_near_m - region.x_far_m)
        right = (middle[1] - region.y_left_m) / (region.y_right_m - region.y_left_m)
        inside = (down >= 0) & (down <= 1) & (right >= 0) & (right <= 1)
        node, weight = (each.flatten(1).to(device) for each in neighbours(rows * down, cols * right, rows, cols))
        weight, seen = weight.float(), inside.float().to(device)
        off = None if T_off.equal(T_on) else _place_in_image(whole, _from(T_off, camera_view(camera)), crop).to(device)  # [2, h, step * w]
        origin, params = eye.float().to(device), sensor.params
        return cls(region, crop, origin, step, samples, tuple(lamps), rows, cols, node, weight, seen, camera, params, off)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        height, width = self.inside.shape
        return height, width

    def observe(self, frames: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Contrast and threshold `[h, w]` in cd/m^2 of on and off frame `[height, width]` (digital numbers)."""
        contrast, limit, _ = self._contrast(frames)
        return contrast, limit

    def observe_symbol(self, frames: tuple[Tensor, Tensor], expected: Tensor) -> tuple[Tensor, Tensor]:
        """Contrast and threshold `[h, w]` in cd/m^2, corrected by the pixels that the symbol leaves dark on the assumed road.

        expected: `[h, w]` cd/m^2, luminance of the symbol there.

        Contrast: less the median change of the other light between the frames. Threshold: raised if the noise exceeds the camera's. No
        correction without dark pixels.
        """
        contrast, limit, without = self._contrast(frames)
        dark = (self.inside > 0) & (expected < limit)  # [h, w] bool
        rise = (contrast / without)[dark].median()  # change of the other light as a share of it, []
        changed = (contrast / limit)[dark].median().abs() > 1
        contrast = torch.where(changed, contrast - rise * without, contrast)
        # Standard deviation of the noise, 1.4826 MAD, as a multiple of the camera's, [].
        noise = (contrast / limit)[dark].abs().median() * (SIGMAS * self.params.threshold_sigma)
        return contrast, limit * noise.nan_to_num(1.0).clamp(min=1)

    def _contrast(self, frames: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Contrast, threshold, and luminance of the off frame, `[h, w]` cd/m^2 each."""
        on, off = frames[0][self.crop.slices], self._compensate(frames[1])
        images = torch.stack([difference(on, off, self.camera), threshold(off, self.camera, self.params), luminance_of(off, self.camera)])
        contrast, limit, without = avg_pool2d(images[:, None], (1, self.step))[:, 0]  # means of step columns, [h, w] each
        return contrast, limit, without

    def _compensate(self, off: Tensor) -> Tensor:
        """The off frame `[height, width]` in the crop, warped to the camera pose of the on frame."""
        if self.off_place is None:
            return off[self.crop.slices]
        u, v = self.off_place[:, None]  # [1, h, step * w] each
        seen = torch.zeros(off.shape, dtype=off.dtype, device=off.device)
        read = tuple(
            slice(max(math.floor(low), 0), max(math.ceil(high), 0))
            for place, size in zip((v, u), off.shape, strict=True)
            for low, high in [((place.aminmax().min + 1) * size / 2 - BESIDE_PX, (place.max() + 1) * size / 2 + BESIDE_PX)]
        )
        seen[read] = off[read]
        return resample(seen[None, None], u, v, "border")[0, 0]

    def on_pixels(self, nodes: Tensor) -> Tensor:
        """Node values `[..., n]` interpolated at the pixels, `[..., h, w]`."""
        return multiply(self.bilinear, nodes).unflatten(-1, self.shape)

    @cached_property
    def bilinear(self) -> Csr:
        """`[h * w, n]`, interpolation of the nodes at the pixels."""
        ends = torch.arange(0, self.node.numel() + 1, len(self.node), dtype=torch.int32, device=self.node.device)
        return Csr(ends, self.node.T.flatten().int(), self.weight.T.flatten(), self.rows * self.cols)

    def on_nodes(self, image: Tensor) -> Tensor:
        """Adjoint of `on_pixels`: an image's `[..., h, w]` values gathered by the nodes, `[..., n]`."""
        shares = (image.flatten(-2)[..., None, :] * self.weight).flatten(-2)  # [..., 4 * h * w]
        return image.new_zeros(*image.shape[:-2], self.rows * self.cols).index_add(-1, self.node.flatten(), shares)

    def luminance(self, textures: Sequence[Tensor], heights: Tensor) -> Tensor:
        """Luminance `[B, h, w]` in cd/m^2 of light textures, one a module, on heights `[B, h, w]` m at the pixels."""
        fine = heights.repeat_interleave(self.samples, -2)  # [B, H, w]
        total = torch.stack([lamp.luminance(texture, fine) for lamp, texture in zip(self.lamps, textures, strict=True)]).sum(0)  # [B, H, w]
        return average_rows(total, self.samples)

    def symbol(self, contrast: Tensor, limit: Tensor) -> Tensor:
        """Symbol image `[..., h, w]` in 0..1 as extraction would find it."""
        return symbol_image(contrast, limit, self.params)


def _from(T_ground_body: Tensor, view: View) -> View:
    """The view of a standing vehicle, moved to a pose `[4, 4]` of the body."""
    return replace(view, T_world_view=T_ground_body @ view.T_world_view)


def _place_in_image(view: View, other: View, crop: Window) -> Tensor:
    """Places `[2, h, w]` in another view's image, -1 to 1 over it, of the plane points in a crop of a view."""
    rays = view.within(*crop.slices).rays().flatten(1)
    uv, _ = other.project(view.origin[:, None] - rays * (view.origin[2] / rays[2]))  # of where rays meet z = 0, [2, h * w] px
    size = uv.new_tensor([[other.width], [other.height]])
    return (2 * uv / size - 1).float().unflatten(1, (crop.v_stop - crop.v_start, -1))
