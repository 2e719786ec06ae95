"""Material-based lighting: each material that the camera identifies gets its own light (T 9.2, fig. 9.4).

Each material in the camera's image has a target illuminance. Rectangles at tracked objects and on the road carry these targets: a lamp ray
that hits a rectangle takes the setpoint of the camera pixel that sees the hit point.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, Self, get_args

import torch
from pydantic import Field, model_validator
from torch import Tensor

from luxloop.controllers.geometry import Place, facing, on_road
from luxloop.controllers.pixels.primitives import Observer, Primitives
from luxloop.controllers.situation import LAYERS, Category, DrawingModules, Priority, SelectionParams, Situation
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import View
from luxloop.world.materials.library import MaterialName
from luxloop.world.params import Distance, Length, Metres, NotNegative, Params, Share

GROUND = frozenset({"asphalt", "wet_asphalt", "lane_paint"})  # materials in the road's plane; all others stand on it
Quantity = Literal["lx", "luminance"]


class MaterialLightParams(Params):
    """Light for surfaces chosen by material or albedo."""

    materials: tuple[MaterialName, ...] = Field((), description="names of materials; left out: any material")
    albedo: tuple[Share, Share] = Field((0.0, 1.0), description="range of albedo, least and greatest")
    lx: NotNegative | None = Field(None, description="target illuminance; give this or luminance_cd_m2")
    luminance_cd_m2: float | None = Field(None, ge=0, le=1e9, description="target luminance of a diffuse surface with the measured albedo")

    @model_validator(mode="after")
    def _one_quantity(self) -> Self:
        if (self.lx is None) == (self.luminance_cd_m2 is None):
            raise ValueError("give either lx or luminance_cd_m2")
        if self.albedo[0] >= self.albedo[1]:
            raise ValueError(f"albedo: the range {self.albedo[0]:g} to {self.albedo[1]:g} is empty; give the smaller one first")
        return self

    @property
    def quantity(self) -> Quantity:
        """Quantity of the setpoint."""
        return "luminance" if self.lx is None else "lx"

    @property
    def value(self) -> float:
        """Value of the setpoint in cd/m^2 or lx."""
        value = self.luminance_cd_m2 if self.lx is None else self.lx
        assert value is not None
        return value

    def illuminance(self, albedo: Tensor) -> Tensor:
        """Target illuminance in lx, in the shape of the albedo."""
        return torch.full_like(albedo, self.value) if self.quantity == "lx" else math.pi * self.value / albedo.clamp(min=0.01)


@dataclass(frozen=True, eq=False)
class MaterialState:
    """State from the last material image, `[height, width]` each. lx: target illuminance, NaN without a light. light: index of the light,
    -1 for none. ground: bool, materials in the road's plane.
    """

    view: View
    lx: Tensor
    light: Tensor
    ground: Tensor


class MaterialParams(SelectionParams):
    """Gives each material its own light; other surfaces keep the base beam."""

    kind: Literal["material"] = "material"
    categories: tuple[Category, ...] = Field(get_args(Category), min_length=1, description="classes of objects to light")
    lights: tuple[MaterialLightParams, ...] = Field(
        min_length=1, examples=[[{"materials": ["asphalt"], "lx": 10.0}]], description="lights of materials; the first that matches applies"
    )
    road_m: tuple[Metres, Metres] | None = Field(
        (5.0, 60.0), description="range ahead in which the road is lit by material; none: the road is not lit"
    )
    road_width_m: Length = Field(16.0, description="width of that part of the road, about the car's centre line")
    margin_m: Distance = Field(0.2, description="margin of an object's rectangle beyond its box on all sides but the foot")
    priority: Priority = 0
    modules: DrawingModules = ()

    @model_validator(mode="after")
    def _some_road(self) -> Self:
        if self.road_m is not None and not 0 < self.road_m[0] < self.road_m[1]:
            raise ValueError(f"road_m: {list(self.road_m)} is not a range; give two distances ahead of the car, the nearer one first")
        return self

    def start(self) -> None:
        """No state before the first frame."""

    def step(self, state: MaterialState | None, now: Situation) -> MaterialState | None:
        """The state after a frame. Raises LuxloopError without a source of materials."""
        seen = now.seen
        if seen is None:
            return state
        if seen.albedo is None or seen.material is None:
            raise LuxloopError("kind: material-based light needs a source of materials in addition to the camera, and there is none")
        albedo = seen.albedo.float()
        lx, which = torch.full_like(albedo, torch.nan), torch.full_like(seen.material, -1)
        for number, light in reversed(list(enumerate(self.lights))):
            low, high = light.albedo
            meant = (albedo >= low) & (albedo <= high) & (seen.material >= 0)
            if light.materials:
                meant &= torch.isin(seen.material, _numbers(seen.materials, light.materials).to(seen.material))
            lx, which = torch.where(meant, light.illuminance(albedo), lx), which.masked_fill(meant, number)
        return MaterialState(seen.view, lx, which, torch.isin(seen.material, _numbers(seen.materials, GROUND).to(seen.material)))

    def adapted(self, state: MaterialState | None, now: Situation) -> tuple[Primitives, ...]:
        """One upright rectangle for each object, through its centre and facing the lamps, and one for the road."""
        if state is None:
            return ()
        margin = self.margin_m * torch.tensor([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]).double()
        standing = [
            facing(each.T_world_object.double(), each.bounds + margin, now.lamps.double().mean(0)) for each in self.select_present(now)
        ]
        lying = [] if self.road_m is None else [self._road(now, *self.road_m)]
        drawn = ((standing, state.lx.masked_fill(state.ground, torch.nan)), (lying, state.lx.masked_fill(~state.ground, torch.nan)))
        return tuple(self._draw(place, lx, state.view) for places, lx in drawn if not bool(lx.isnan().all()) for place in places)

    def base_share(self, state: MaterialState | None) -> None:
        """No demand on the base beam."""

    def _road(self, now: Situation, near_m: float, far_m: float) -> Place:
        corner, across, back = torch.tensor(
            [[far_m, self.road_width_m / 2], [0.0, -self.road_width_m], [near_m - far_m, 0.0]], dtype=torch.float64
        )
        return on_road(now.T_world_vehicle.double(), corner, across, back)

    def _draw(self, place: Place, lx: Tensor, view: View) -> Primitives:
        """A primitive on a rectangle with the image of target illuminance along the camera's rays; transparent where there is no target."""
        wanted = ~lx.isnan()
        wanted[[0, -1]], wanted[:, [0, -1]] = False, False
        most = float(lx[wanted].max()) if bool(wanted.any()) else 0.0
        image = torch.stack([lx.nan_to_num() / max(most, 1e-9), wanted.to(lx)])
        light = place.light(most, "E_v", symbol=image.clamp(max=1), priority=self.priority * LAYERS, nearest=True, modules=self.modules)
        return replace(light, observer=Observer(*(each[None] for each in image_plane(view))))


def image_plane(view: View) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Eye of a camera, and origin, d1 (right) and d2 (down) of the rectangle 1 m ahead of it that its image fills; `[3]` m each."""
    right, down, ahead = view.T_world_view[:3, :3].double().T
    corner = view.origin + ahead - view.cx / view.fx * right - view.cy / view.fy * down
    return view.origin, corner, view.width / view.fx * right, view.height / view.fy * down


def _numbers(names: tuple[str, ...], meant: tuple[MaterialName, ...] | frozenset[str]) -> Tensor:
    return torch.tensor([k for k, name in enumerate(names) if name in meant], dtype=torch.int64)
