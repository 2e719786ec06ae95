"""Light on tracked objects by rectangles that face the lamps; heads and windscreens stay nearly dark (T 9.3)."""

import math
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.geometry import Place
from luxloop.controllers.pixels.primitives import Primitives, rectangle
from luxloop.controllers.situation import LAYERS, MASK, TrackedObject
from luxloop.world.frames import transform
from luxloop.world.params import Params
from luxloop.world.traffic.tracked import ROAD_USERS, Category

NEAREST_M = 1.0  # objects nearer to a lamp are not lit; no lamp's light falls on heads there
TEXEL_RAD = 1e-3  # of a light texture, which interpolates light between texels
SURE = 0.7  # confidence below which any object may be a person
CELLS = 16  # texels per stripe
CORE_M = 0.3  # width of an object's core, in its middle, that hides all light behind it
Pattern = Literal["homogeneous", "stripes", "checks"]


class ObjectLightParams(Params):
    """Area and pattern of the light on an object."""

    pattern: Pattern = Field(
        "homogeneous", description="`homogeneous` or structured light: `stripes` (vertical) or `checks` show edges with less flux"
    )
    period_m: float = Field(0.5, ge=0.05, le=5, description="period of the structure on the object")
    margin_m: float = Field(
        0.1,
        ge=0,
        le=10_000,
        description="margin of the light beyond the box on all sides; below the foot it shows the contact with the road",
    )
    dark: dict[Category, Annotated[float, Field(ge=0, le=1)]] = Field(
        {"pedestrian": 0.25, "cyclist": 0.25, "motorcycle": 0.3, "car": 0.45, "truck": 0.6},
        description="share of the box's height, from the top, that stays dark with all behind it: heads and windscreens",
    )
    dark_lx: float = Field(
        0.6,
        ge=0,
        le=1e6,
        description="illuminance of the dark part, whatever the rest gets, with `ssc.a_d` = 1; detectors need heads",
    )

    def on(
        self, each: TrackedObject, lamps: Tensor, lx: float, priority: int, nearer: int, modules: tuple[str, ...]
    ) -> tuple[Primitives, ...]:
        """Primitives that light the object with lx and leave part of it dark; none for objects beside or behind the lamps.

        lamps: positions `[L, 3]` m. nearer: number of nearer objects. The dark part overrides all light except on the cores of nearer
        objects, which hide it. Only road users have a core, since much of an animal's box is air. The dark part reaches as far above the
        box as into it, since a detector's box may end below a dark head.
        """
        length, width, height = each.size_m
        low, high = torch.tensor([[-length / 2, -width / 2, 0.0], [length / 2, width / 2, height]], dtype=torch.float64)
        body = frontal(each.T_world_object, low, high, lamps, self.margin_m, self.margin_m)
        if body is None:
            return ()
        layer, facing = (MASK - 2 * nearer) * LAYERS, body.normal
        image = self._image(body)
        parts = [
            rectangle(body.origin, body.d1, body.d2, lx, "E_v", normal=facing, symbol=image, priority=priority * LAYERS, modules=modules)
        ]
        if image is None and each.category in ROAD_USERS and not math.isnan(each.score):
            across, down = min(1.0, CORE_M / float(body.d1.norm())), 1 - self.margin_m / float(body.d2.norm())
            core = body.origin + (1 - across) / 2 * body.d1
            parts.append(
                rectangle(
                    core, across * body.d1, down * body.d2, lx, "E_v", normal=facing, forced=True, priority=layer - LAYERS, modules=modules
                )
            )
        share = self.dark.get(each.category, 0.0)
        if each.confidence < SURE:
            share = max(share, self.dark.get("pedestrian", 0.0))
        low[2], high[2] = (1 - share) * height, (1 + share) * height
        below = TEXEL_RAD * float((body.origin - lamps.mean(0)).norm())
        eyes = frontal(each.T_world_object, low, high, lamps, self.margin_m, below) if share else None
        if eyes is not None:
            dim = rectangle(
                eyes.origin, eyes.d1, eyes.d2, self.dark_lx, "E_v", normal=eyes.normal, weight=math.inf, forced=True, priority=layer
            )
            parts.append(dim)
        return tuple(parts)

    def _image(self, place: Place) -> Tensor | None:
        """Image `[h, w]` of the structure, whole cells from the top left; None for homogeneous light."""
        if self.pattern == "homogeneous":
            return None
        across, down = (torch.arange(max(1, round(2 * float(d.norm()) / self.period_m))) % 2 == 0 for d in (place.d1, place.d2))
        cells = across[None] if self.pattern == "stripes" else across == down[:, None]
        return cells.double().repeat_interleave(CELLS, 0).repeat_interleave(CELLS, 1)


def frontal(T_world_box: Tensor, low: Tensor, high: Tensor, lamps: Tensor, margin_m: float, foot_m: float) -> Place | None:
    """The upright rectangle facing the lamps, in the plane of the box's nearest corner, that covers the box as seen from each lamp.

    low, high: `[3]` m, opposite corners in the box's frame. lamps: `[L, 3]` m. margin_m: margin on all sides but the foot. foot_m: margin
    at the foot. None if a corner is nearer than NEAREST_M.
    """
    T, lamps = T_world_box.double(), lamps.double()
    up, viewer = T[:3, 2], lamps.mean(0)
    corners = transform(T, torch.cartesian_prod(*torch.stack([low, high]).double().T).T).T
    away = corners.mean(0) - viewer
    ahead = torch.nn.functional.normalize(away - (away @ up) * up, dim=0)
    nearest = ((corners - viewer) @ ahead).amin()
    rays = corners - lamps[:, None]
    depth = rays @ ahead
    if nearest < NEAREST_M or depth.amin() < NEAREST_M:
        return None
    plane = nearest - (lamps - viewer) @ ahead
    seen = lamps[:, None] + rays * (plane[:, None] / depth)[..., None] - viewer
    right = torch.linalg.cross(ahead, up)
    across, height = (seen @ right).flatten(), (seen @ up).flatten()
    left_at, right_at = across.amin() - margin_m, across.amax() + margin_m
    top_at, foot_at = height.amax() + margin_m, height.amin() - foot_m
    origin = viewer + nearest * ahead + left_at * right + top_at * up
    return Place(origin, (right_at - left_at) * right, (foot_at - top_at) * up, -ahead)
