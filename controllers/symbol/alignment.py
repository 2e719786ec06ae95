"""Registration of the symbol's bird's-eye view to its bird's-eye view on a flat road."""

from dataclasses import dataclass
from typing import Literal, Self

import cv2
import numpy as np
import torch
from cv2.typing import MatLike
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement, SymbolSensor
from luxloop.perception.birdseye import BirdsEye, Region, birds_eye, rectify
from luxloop.world.texels import Window, resample

CELL_M = 0.04
BEYOND = (0.5, 0.4)  # margin of the view on every side, in lengths and widths of the symbol
BLURS = (31, 11, 5)  # cells of blur before registration, coarse to fine
NODES = (17, 9)  # of the height mesh, along and across
SIGMA = 0.2  # standard deviation of the symbol image in registration
SLOPE_M = 0.02  # usual difference of neighbouring heights
ITERATIONS = 4
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-4)

Kind = Literal["homography", "mesh", "homography+mesh"]


@dataclass(frozen=True)
class Placement:
    """Map of symbol coordinates (u right, v down, -1 to 1 over the symbol) to coordinates of their image on the road.

    homography: `[3, 3]`. heights: `[rows, cols]` m of a mesh over the whole view. per_m: `[2, h, w]`, displacement of points by 1 m of
    height. extent: u and v at the view's border.
    """

    homography: Tensor
    heights: Tensor
    per_m: Tensor
    extent: tuple[float, float]

    def of(self, points: Tensor) -> Tensor:
        """Images `[2, h, w]` of points `[2, h, w]`."""
        from kornia.geometry.linalg import transform_points

        moved = transform_points(self.homography[None], points.flatten(1).T[None])[0].T.view_as(points)
        per_m, heights = (self.at(values, points, "border") for values in (self.per_m, self.heights[None]))
        return moved + per_m * heights

    def at(self, values: Tensor, points: Tensor, beyond: Literal["zeros", "border"] = "zeros") -> Tensor:
        """Images `[n, rows, cols]` over the whole view at points `[2, h, w]`: `[n, h, w]`."""
        u, v = (axis[None] / end for axis, end in zip(points, self.extent, strict=True))
        return resample(values[None], u, v, beyond, corners=True)[0]


@dataclass(frozen=True)
class Alignment:
    """Registration to the target image `[rows, cols]` of a bird's-eye view.

    points: `[2, rows, cols]`, symbol coordinates of the view's cells. still: the identity placement. basis: `[n, rows * cols]`, bilinear
    basis functions of the mesh's nodes at the cells.
    """

    plane: BirdsEye
    target: Tensor
    points: Tensor
    still: Placement
    basis: Tensor

    @classmethod
    def prepare(cls, sensor: SymbolSensor) -> Self:
        """Make the bird's-eye view of the target on the flat road."""
        projector, eye = sensor.projector, sensor.model.eye
        p, device = projector.params, projector.symbol.device
        half = [size * (0.5 + beyond) for size, beyond in zip((p.length_m, p.width_m), BEYOND, strict=True)]
        region = Region(max(p.x_m - half[0], 1.0), p.x_m + half[0], p.y_m + half[1], p.y_m - half[1], CELL_M)
        plane = birds_eye(region, eye.view).to(device)
        crop = Window(0, eye.view.height, 0, eye.view.width)
        target = rectify(plane, sensor.model.symbol(projector.light(projector.target), crop))
        y, x = (-plane.axes.u.to(target)).expand_as(target), (-plane.axes.v.to(target))[:, None].expand_as(target)
        points = torch.stack([(p.y_m - y) * (2 / p.width_m), (p.x_m - x) * (2 / p.length_m)])
        lamp = torch.stack([module.T_body_headlight[:3, 3] for module in projector.modules]).mean(0).to(target)
        camera = eye.view.origin.to(target)
        along, across = ((lamp[k] - at) / lamp[2] + (at - camera[k]) / camera[2] for k, at in enumerate((x, y)))
        per_m = torch.stack([across * (-2 / p.width_m), along * (-2 / p.length_m)])
        extent = (float(points[0].max()), float(points[1].max()))
        nodes = torch.eye(NODES[0] * NODES[1]).to(target).view(-1, 1, *NODES)
        basis = interpolate(nodes, target.shape, mode="bilinear", align_corners=True).flatten(1)
        return cls(plane, target, points, Placement(torch.eye(3).to(target), target.new_zeros(NODES), per_m, extent), basis)

    def image(self, seen: Measurement) -> Tensor:
        """The symbol image `[rows, cols]` from above."""
        return rectify(self.plane, seen.symbol, seen.crop.u_start, seen.crop.v_start)

    def residual(self, image: Tensor) -> Tensor:
        """1 minus intersection over union with the target, of an image `[..., rows, cols]` in 0..1."""
        return 1 - torch.minimum(image, self.target).sum((-2, -1)) / torch.maximum(image, self.target).sum((-2, -1))

    def undo(self, image: Tensor, placement: Placement) -> Tensor:
        """The image `[rows, cols]` with a placement undone, for comparison with the target."""
        return self.still.at(image[None], placement.of(self.points))[0]

    def register(self, image: Tensor, kind: Kind) -> Placement:
        """The placement with the least residual: identity, homography, or a height mesh on either of these."""
        found = [self.still]
        if "homography" in kind:
            found.append(self._homography(image))
        if "mesh" in kind:
            found += [self._mesh(image, each) for each in found]
        return min(found, key=lambda each: float(self.residual(self.undo(image, each))))

    def _homography(self, image: Tensor) -> Placement:
        """Homography by the enhanced correlation coefficient (Evangelidis and Psarakis 2008); the identity without convergence."""
        template, seen = (each.cpu().numpy() for each in (self.target, image))
        H: MatLike = np.eye(3, dtype=np.float32)
        everywhere = np.ones(seen.shape, np.uint8)
        try:
            for blur in BLURS:
                _, H = cv2.findTransformECC(template, seen, H, cv2.MOTION_HOMOGRAPHY, CRITERIA, everywhere, blur)
        except cv2.error:
            return self.still
        rows, cols = template.shape
        u, v = self.points[0, 0].cpu().double(), self.points[1, :, 0].cpu().double()
        T = torch.diag(torch.stack([(u[-1] - u[0]) / (cols - 1), (v[-1] - v[0]) / (rows - 1), u.new_tensor(1.0)]))
        T[0, 2], T[1, 2] = u[0], v[0]
        return self._place(T @ torch.from_numpy(H).double() @ T.inverse(), self.still.heights)

    def _mesh(self, image: Tensor, start: Placement) -> Placement:
        """Gauss-Newton on the heights of a smooth mesh, from a start placement."""
        from kornia.filters import gaussian_blur2d, spatial_gradient

        n = self.still.heights.numel()
        k = torch.arange(n, device=image.device).view(NODES)
        pairs = torch.cat([torch.stack([k[1:], k[:-1]]).flatten(1), torch.stack([k[:, 1:], k[:, :-1]]).flatten(1)], 1)
        steps = torch.eye(n).to(image)[pairs]
        smooth = (steps[0] - steps[1]).T @ (steps[0] - steps[1]) / SLOPE_M**2
        heights = start.heights.flatten()
        for blur in BLURS[1:]:
            sigma = 0.15 * blur + 0.35
            seen, target = (gaussian_blur2d(each[None, None], (blur, blur), (sigma, sigma)) for each in (image, self.target))
            slopes = spatial_gradient(seen)[0, 0] / (self.points[:, 1, 1] - self.points[:, 0, 0])[:, None, None]
            for _ in range(ITERATIONS):
                where = self._place(start.homography, heights.view(NODES)).of(self.points)
                slope = (self.still.at(slopes, where) * self.still.per_m).sum(0)
                lack = (target[0, 0] - self.still.at(seen[0], where)[0]).flatten()
                J = self.basis * slope.flatten()
                weight = 1 / (SIGMA * blur) ** 2
                force = J @ lack * weight - smooth @ heights
                matrix = J @ J.T * weight + smooth + torch.eye(n).to(image)
                heights = heights + torch.linalg.solve(matrix, force)
        return self._place(start.homography, heights.view(NODES))

    def _place(self, homography: Tensor, heights: Tensor) -> Placement:
        return Placement(homography.to(self.target), heights, self.still.per_m, self.still.extent)
