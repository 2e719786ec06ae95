"""luxloop: finds the road's heights from how the symbol lies on it, and draws for that road where that explains what is seen."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from controllers.symbol.drawing import Drawing, Warp, warp_onto
from controllers.symbol.observer import Observer
from controllers.symbol.projector import SymbolParams
from controllers.symbol.protocol import Look
from controllers.symbol.registration import Heights, Registration
from controllers.symbol.relief import Relief
from controllers.symbol.sight import Sight
from controllers.symbol.sweep import sweep
from perception.birdseye import Region
from world.params import Params

LEAST_LIT_PX = 20.0  # fewer lit pixels are no symbol
HEIGHTS = 57  # that a sweep tries
SEEN_BY = 0.05  # of the usual illuminance a node, with which its brightness is no longer a guess


class LuxloopParams(Params):
    """Heights from registration; the open loop where they explain nothing."""

    name: Literal["luxloop"] = "luxloop"
    cell_m: tuple[float, float] = Field((0.2, 0.15), description="distance of heights on the assumed road, along and across")
    beyond_m: tuple[float, float, float] = Field((1.2, 1.5, 0.6), description="how far heights go beyond the symbol: near, far, sides")
    highest_m: float = Field(0.14, gt=0, le=0.3, description="largest height, up or down, that is looked for")
    memory: float = Field(0.6, ge=0, lt=1, description="share of what is known that a step keeps; the rest may have changed")
    evidence: float = Field(0.0025, ge=0, description="share of the symbol that heights have to explain beyond what the flat road does")
    sweep_above: float = Field(0.01, ge=0, description="share of the symbol that may stay unexplained before all heights are tried anew")


@dataclass(frozen=True)
class LuxloopState:
    """heights: what is known of the road. brightness: `[n]` at its nodes, multiple of the assumed road's. drawing: what is shown now."""

    heights: Heights
    brightness: Tensor
    drawing: Drawing


class Luxloop:
    """Registration of heights, supervised by the open loop."""

    def __init__(self, params: LuxloopParams, observer: Observer) -> None:
        self.params, self.projector = params, observer.projector
        self.region = region_of(self.projector.params, *params.beyond_m)

        def sight(step: int, samples: int) -> Sight:
            return Sight.prepare(
                self.projector, observer.camera, observer.params, observer.model.albedo, self.region, params.cell_m, step, samples
            )

        self.coarse, self.fine = sight(4, 1), sight(2, 3)
        self.registration = Registration.prepare(self.fine)
        self.tried = torch.linspace(-params.highest_m, params.highest_m, HEIGHTS, device=self.projector.symbol.device)

    def start(self, pose: Tensor) -> LuxloopState:
        """State that shows the pose `[4]` first."""
        return self._ignorant(Drawing(pose))

    def drawing(self, state: LuxloopState) -> Drawing:
        """The symbol for the road as it is known."""
        return state.drawing

    def step(self, state: LuxloopState, look: Look) -> LuxloopState:
        """Register the look; the open loop's drawing, unless heights explain it better than a flat road does."""
        flat = Drawing(self.projector.target)
        if look.frames is None:
            return replace(state, drawing=state.drawing if state.drawing.warp else flat)
        contrast, limit = self.fine.observe(look.frames)
        seen = self.fine.symbol(contrast, limit)
        if float(seen.sum()) * self.fine.step < LEAST_LIT_PX:
            return replace(state, drawing=flat)
        textures = tuple(
            module.pixel_controller.headlight.light_texture(light.u - module.pixel_controller.default)
            for module, light in zip(self.projector.modules, look.shown.lights, strict=True)
        )
        heights, residual, residual_flat = self._registered(state, look.frames, seen, limit, textures)
        if residual > residual_flat - self.params.evidence:
            return self._ignorant(flat)
        brightness = self._brightness(heights.mean, state.brightness, contrast, seen, textures)
        return LuxloopState(heights, brightness, Drawing(self.projector.target, warp=self._warp(heights.mean, brightness)))

    def _ignorant(self, drawing: Drawing) -> LuxloopState:
        heights = self.registration.unknown()
        return LuxloopState(heights, torch.ones_like(heights.mean), drawing)

    def _registered(
        self, state: LuxloopState, frames: tuple[Tensor, Tensor], seen: Tensor, limit: Tensor, textures: tuple[Tensor, ...]
    ) -> tuple[Heights, float, float]:
        """Heights with what is known of them, their residual on this look, and that of the flat road."""
        register, known = self.registration, state.heights
        limit = limit / self.fine.on_pixels(state.brightness)  # of the light that the assumed road would show
        found = [register.refine(known.mean, known, seen, textures, limit)]
        residual = register.residual(found[0].mean[None], seen, textures, limit)
        if float(residual[0]) > self.params.sweep_above:
            contrast, threshold = self.coarse.observe(frames)
            swept = sweep(
                self.coarse,
                self.coarse.symbol(contrast, threshold),
                textures,
                threshold / self.coarse.on_pixels(state.brightness),
                self.tried,
            )
            found.append(register.refine(swept, known, seen, textures, limit))
        nodes = torch.stack([*(each.mean for each in found), torch.zeros_like(known.mean)])
        residuals = register.residual(nodes, seen, textures, limit)
        best = int(residuals[:-1].argmin())
        information = self.params.memory * (known.information + found[best].information)
        return Heights(found[best].mean, information), float(residuals[best]), float(residuals[-1])

    def _brightness(self, nodes: Tensor, before: Tensor, contrast: Tensor, seen: Tensor, textures: tuple[Tensor, ...]) -> Tensor:
        fine = self.fine
        expected = fine.luminance(textures, fine.on_pixels(nodes)[None])[0]
        lit = (seen > 0.5) & (expected > 0)
        there, usual = fine.on_nodes(torch.stack([contrast, expected]) * lit)
        guess = SEEN_BY * usual.mean()
        return (there + guess * before) / (usual + guess)

    def _warp(self, nodes: Tensor, brightness: Tensor) -> Warp:
        fine, symbol = self.fine, self.projector.params
        grid = (fine.rows, fine.cols)
        relief = Relief(self.region, fine.eye, nodes.view(grid), brightness.view(grid))
        lamp = torch.stack([each.origin for each in fine.lamps]).mean(0)
        return warp_onto(relief, lamp, (symbol.x_m, symbol.y_m), symbol.length_m, symbol.width_m)


def region_of(symbol: SymbolParams, near_m: float, far_m: float, side_m: float) -> Region:
    """The plane around a symbol at its target."""
    half, left = symbol.length_m / 2, symbol.width_m / 2 + side_m
    return Region(max(symbol.x_m - half - near_m, 1.0), symbol.x_m + half + far_m, symbol.y_m + left, symbol.y_m - left)
