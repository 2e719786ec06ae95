"""Material-based lighting: what is seen to be of a material gets that material's own light (T 9.2, fig. 9.4).

The camera's picture of materials becomes a picture of wanted illuminance. Rectangles at the tracked objects and on the road carry it, and
every ray of a lamp that hits one of them asks for what the camera sees there.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self, get_args

import torch
from pydantic import Field, model_validator
from torch import Tensor

from controllers.geometry import Place, facing, on_road
from controllers.pixels.primitives import Observer, Primitives, rectangle
from controllers.situation import LAYERS, Category, SelectionParams, Situation
from world.errors import LuxloopError
from world.materials.library import MaterialName
from world.params import Metres, Params
from world.view import View

GROUND = frozenset({"asphalt", "wet_asphalt", "lane_paint"})  # what lies on the road's plane; all else stands on it
Quantity = Literal["lx", "luminance"]
Share = Annotated[float, Field(ge=0, le=1)]


class MaterialLightParams(Params):
    """The light of some surfaces, chosen by the names of their materials or by their albedo."""

    materials: tuple[MaterialName, ...] = Field((), description="names of materials; left out: whatever has such an albedo")
    albedo: tuple[Share, Share] = Field((0.0, 1.0), description="from and to which albedo")
    lx: float | None = Field(None, ge=0, le=1e6, description="illuminance wanted; give this or luminance_cd_m2")
    luminance_cd_m2: float | None = Field(
        None, ge=0, le=1e9, description="luminance wanted, of a diffuse surface of the albedo that is seen"
    )

    @model_validator(mode="after")
    def _one_quantity(self) -> Self:
        if (self.lx is None) == (self.luminance_cd_m2 is None):
            raise ValueError("give either lx or luminance_cd_m2, one of the two")
        if self.albedo[0] >= self.albedo[1]:
            raise ValueError(f"albedo: nothing is between {self.albedo[0]:g} and {self.albedo[1]:g}; give the smaller one first")
        return self

    @property
    def quantity(self) -> Quantity:
        """What is wanted."""
        return "luminance" if self.lx is None else "lx"

    @property
    def value(self) -> float:
        """How much of it, in cd/m^2 or lx."""
        value = self.luminance_cd_m2 if self.lx is None else self.lx
        assert value is not None
        return value

    def wanted(self, albedo: Tensor) -> Tensor:
        """Illuminance in lx, in the shape of the albedo."""
        if self.quantity == "lx":
            return torch.full_like(albedo, self.value)
        return math.pi * self.value / albedo.clamp(min=0.01)


@dataclass(frozen=True, eq=False)
class MaterialState:
    """What was seen last, `[height, width]`. lx: wanted illuminance, NaN where none is. light: which of the lights says so, -1 for none.
    ground: bool, what lies on the road.
    """

    view: View
    lx: Tensor
    light: Tensor
    ground: Tensor


class MaterialParams(SelectionParams):
    """Every material gets its own light; what is of none that is named keeps the base beam."""

    kind: Literal["material"] = "material"
    categories: tuple[Category, ...] = Field(get_args(Category), min_length=1, description="classes of objects meant")
    lights: tuple[MaterialLightParams, ...] = Field(
        min_length=1, description="lights of materials; where several are meant the first counts"
    )
    road_m: tuple[Metres, Metres] | None = Field((5.0, 60.0), description="where the road is lit so, from and to; none: nowhere")
    road_width_m: float = Field(16.0, gt=0, le=10_000, description="how wide, about the middle of the car")
    margin_m: float = Field(
        0.2, ge=0, le=10_000, description="how much larger than an object's box its rectangle is, to each side but its foot"
    )
    priority: int = Field(0, ge=0, le=100, description="of two functions in one place, the higher is drawn")
    modules: tuple[str, ...] = Field((), description="lamps or modules that draw it; left out: all")

    @model_validator(mode="after")
    def _some_road(self) -> Self:
        if self.road_m is not None and not 0 < self.road_m[0] < self.road_m[1]:
            raise ValueError(f"road_m: give two distances ahead of the car, the nearer one first, not {list(self.road_m)}")
        return self

    def start(self) -> None:
        """Nothing seen yet."""

    def step(self, state: MaterialState | None, now: Situation) -> MaterialState | None:
        """The picture of wanted light. Raises LuxloopError where nothing tells materials."""
        seen = now.seen
        if seen is None:
            return state
        if seen.albedo is None or seen.material is None:
            raise LuxloopError("kind: light by material needs a source of materials beside the camera, which is not there")
        albedo = seen.albedo.float()
        lx, which = torch.full_like(albedo, torch.nan), torch.full_like(seen.material, -1)
        for number, light in reversed(list(enumerate(self.lights))):
            low, high = light.albedo
            meant = (albedo >= low) & (albedo <= high) & (seen.material >= 0)
            if light.materials:
                meant &= torch.isin(seen.material, _numbers(seen.materials, light.materials).to(seen.material))
            lx, which = torch.where(meant, light.wanted(albedo), lx), which.masked_fill(meant, number)
        return MaterialState(seen.view, lx, which, torch.isin(seen.material, _numbers(seen.materials, GROUND).to(seen.material)))

    def adapted(self, state: MaterialState | None, now: Situation) -> tuple[Primitives, ...]:
        """A rectangle for each object, upright in its middle and turned to the lamps, and one for the road."""
        if state is None:
            return ()
        standing = [
            self._at(each.T_world_object, each.size_m, now) for each in self.selected(now) if each.since_s <= now.time_s < each.until_s
        ]
        lying = [] if self.road_m is None else [self._road(now, *self.road_m)]
        drawn = ((standing, state.lx.masked_fill(state.ground, torch.nan)), (lying, state.lx.masked_fill(~state.ground, torch.nan)))
        return tuple(self._draw(place, lx, state.view) for places, lx in drawn if not bool(lx.isnan().all()) for place in places)

    def base_share(self, state: MaterialState | None) -> None:
        """It asks nothing of the base beam."""

    def _at(self, T_world_object: Tensor, size_m: tuple[float, float, float], now: Situation) -> Place:
        length, width, height = size_m
        m = self.margin_m
        low, high = torch.tensor([[-length / 2 - m, -width / 2 - m, 0.0], [length / 2 + m, width / 2 + m, height + m]], dtype=torch.float64)
        return facing(T_world_object.double(), low, high, now.lamps.double().mean(0))

    def _road(self, now: Situation, near_m: float, far_m: float) -> Place:
        corner, across, back = torch.tensor(
            [[far_m, self.road_width_m / 2], [0.0, -self.road_width_m], [near_m - far_m, 0.0]], dtype=torch.float64
        )
        return on_road(now.T_world_vehicle.double(), corner, across, back)

    def _draw(self, place: Place, lx: Tensor, view: View) -> Primitives:
        """The camera's picture as one that its rays show on the place; transparent where nothing is wanted, and beyond its border."""
        wanted = ~lx.isnan()
        wanted[[0, -1]], wanted[:, [0, -1]] = False, False
        most = float(lx[wanted].max()) if bool(wanted.any()) else 0.0
        image = torch.stack([lx.nan_to_num() / max(most, 1e-9), wanted.to(lx)])
        light = rectangle(
            place.origin,
            place.d1,
            place.d2,
            most,
            "E_v",
            normal=place.normal,
            symbol=image.clamp(max=1),
            priority=self.priority * LAYERS,
            nearest=True,
            modules=self.modules,
        )
        eye, corner, right, down = (each[None] for each in image_plane(view))
        return replace(light, observer=Observer(eye, corner, right, down, active=torch.tensor([True])))


def image_plane(view: View) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A camera's eye, and the rectangle 1 m before it that its image fills: origin, d1 to the right, d2 down, all `[3]` m."""
    right, down, ahead = view.T_world_view[:3, :3].double().T
    corner = view.origin + ahead - view.cx / view.fx * right - view.cy / view.fy * down
    return view.origin, corner, view.width / view.fx * right, view.height / view.fy * down


def _numbers(names: tuple[str, ...], meant: tuple[MaterialName, ...] | frozenset[str]) -> Tensor:
    return torch.tensor([k for k, name in enumerate(names) if name in meant], dtype=torch.int64)
