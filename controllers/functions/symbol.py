"""Symbols on the road: still, animated, conditional, undistorted for an observer, or held by a controller (T 3.5.2, 7.2.2)."""

from dataclasses import replace
from typing import Final, Literal, Self

import torch
from pydantic import Field, ValidationError, model_validator
from torch import Tensor

from luxloop.controllers.functions.animations import WHITE, AnimationParams, animate
from luxloop.controllers.functions.carrier_sense import CarrierSenseParams, CarrierState, stretch_contrast
from luxloop.controllers.geometry import Place, on_road
from luxloop.controllers.pixels.homographies import drawing_rectangle
from luxloop.controllers.pixels.primitives import Observer, Primitives
from luxloop.controllers.situation import Category, DrawingParams, SelectionParams, Situation
from luxloop.controllers.symbol import ControllerParams, refuse_start, refuse_target
from luxloop.controllers.symbol.sensing.projector import StartParams, SymbolParams
from luxloop.controllers.symbol.sensing.road_shape import cells_of_rectangle
from luxloop.controllers.symbol.sensing.symbol_sensor import FeatureParams
from luxloop.perception.extraction import Extraction, ExtractionParams
from luxloop.world.errors import LuxloopError
from luxloop.world.frames import pose_from_degrees, transform
from luxloop.world.params import Degrees, Length, Metres, Params, Slope
from luxloop.world.texels import resample
from luxloop.world.validation import sentences

CONTROLLED: Final = ("start", "target", "features", "extraction")  # keys of symbols that a controller holds
UNCONTROLLED: Final = ("yaw_deg", "animation", "share")  # keys of the others
DRIVER_M = (-1.6, 0.35, 1.3)  # the driver's eye, in the vehicle frame
CELLS: Final = (512, 512)  # of the image of an observer's picture on the flat road, along and across


class ConditionParams(SelectionParams):
    """True while a selected object is within the distances (T fig. 7.10)."""

    categories: tuple[Category, ...] = Field(
        ("car", "truck", "motorcycle", "cyclist", "pedestrian", "animal", "other"),
        min_length=1,
        description="classes of objects that fulfil the condition",
    )

    def holds(self, now: Situation) -> bool:
        return bool(self.select_present(now))


class ObserverParams(Params):
    """The observer to whom the symbol appears as an upright, undistorted picture (T 7.2.2)."""

    eye_m: tuple[Metres, Metres, Metres] = Field(
        DRIVER_M, description="eye position in the vehicle frame (x forward, y left, z up); by default the driver's"
    )
    name: str | None = Field(None, description="name of a tracked object as observer, instead of eye_m")
    eye_height_m: Length = Field(1.5, description="height of the tracked observer's eye above its foot")
    centre_m: tuple[Metres, Metres, Metres] = Field((12.0, 0.0, 0.5), description="centre of the picture in the vehicle frame")
    width_m: Length = Field(2.0, description="width of the picture")
    height_m: Length = Field(0.6, description="height of the picture")

    @model_validator(mode="after")
    def _one_observer(self) -> Self:
        if self.name is not None and self.eye_m != DRIVER_M:
            raise ValueError(f"eye_m: the observer is the object {self.name!r} with its eye_height_m; give eye_m or name, not both")
        return self

    def eye(self, now: Situation) -> Tensor | None:
        """Position of the eye `[3]` m in the world; None if the observing object is not tracked."""
        if self.name is None:
            return _world(now, self.eye_m)
        for each in now.objects:
            if each.name == self.name and each.present(now.time_s):
                return each.T_world_object[:3, 3] + self.eye_height_m * each.T_world_object[:3, 2]
        return None

    def picture(self, now: Situation, eye: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The flying symbol as origin, d1 and d2, `[3]` m each: perpendicular to the road's plane, facing the eye."""
        centre, up = _world(now, self.centre_m), now.T_world_vehicle[:3, 2].to(eye)
        towards = eye - centre
        normal = torch.nn.functional.normalize(towards - (towards @ up) * up, dim=0)
        d1, d2 = self.width_m * torch.linalg.cross(up, normal), -self.height_m * up
        return centre - (d1 + d2) / 2, d1, d2


class SymbolFunctionParams(DrawingParams):
    """Draws a symbol on the road."""

    kind: Literal["symbol"] = "symbol"
    image: str = Field(
        examples=["snowflake"], description="name of a shipped symbol, or path of a picture, SVG, video or folder of pictures"
    )
    x_m: Length = Field(17.0, description="position of the centre ahead of the car")
    y_m: Metres = Field(0.0, description="lateral position of the centre, left positive")
    yaw_deg: Degrees = Field(0.0, description="rotation to the left")
    width_m: Length = Field(2.0, description="extent across")
    length_m: Length = Field(4.0, description="extent along")
    animation: AnimationParams | None = Field(None, description="animation; left out: none but that of a video itself")
    when: ConditionParams | None = Field(None, description="draw only while a selected object is present")
    unless: ConditionParams | None = Field(None, description="do not draw while a selected object is present")
    observer: ObserverParams | None = Field(
        None, description="observer who sees the symbol undistorted; its keys place the symbol, in place of x_m, y_m, width_m and length_m"
    )
    controller: ControllerParams | None = Field(
        None, description="controller that holds the symbol undistorted by camera feedback; left out: none"
    )
    start: StartParams | None = Field(None, description="pose at which control starts; left out: at x_m, y_m")
    target: Literal["appearance", "place"] = Field(
        "appearance",
        description="quantity held at x_m, y_m: the symbol's appearance on a flat road, or its place on the real road",
    )
    features: FeatureParams = Field(FeatureParams(), description="image features of the symbol that its controller uses")
    extraction: Extraction = Field(ExtractionParams(), description="extraction of the symbol from the image")

    @model_validator(mode="after")
    def _held_or_not(self) -> Self:
        fields = type(self).model_fields
        if self.controller is None:
            for key in CONTROLLED:
                if getattr(self, key) != fields[key].default:
                    raise ValueError(
                        f'{key}: applies to symbols with a controller only; give controller = "luxloop", for example, or leave it out'
                    )
            return self
        for key in UNCONTROLLED:
            if getattr(self, key) != fields[key].default:
                raise ValueError(f"{key}: does not apply to a symbol with a controller; leave it out, or leave out the controller")
        if self.observer is not None and self.target != fields["target"].default:
            raise ValueError("target: the observer's picture is the target; leave target out")
        refuse_target(self.controller, self.target, self.observer is not None)
        refuse_start(self.controller, self.start_pose)
        try:
            _ = self.held
        except ValidationError as error:
            raise ValueError("; ".join(sentences(error, SymbolParams, ""))) from error
        return self

    def placed(self, now: Situation) -> Self:
        """The symbol with its eye_m, x_m, y_m, width_m and length_m of the picture on the flat road; unchanged without an observer.

        Raises LuxloopError if the observer does not exist now, or sees the picture where no controller can hold it.
        """
        if self.observer is None:
            return self
        eye = self.observer.eye(now)
        if eye is None:
            raise LuxloopError(f"observer.name: {self.observer.name!r} does not exist when the symbol begins; move start_s, or give eye_m")
        origin, d1, d2 = self.observer.picture(now, eye)
        corners = torch.stack([origin, origin + d1, origin + d2, origin + d1 + d2], -1)
        ways = corners - eye[:, None]
        x, y = (eye[:, None] + ways * (eye[2] / -ways[2]).where(ways[2] < 0, torch.nan))[:2]
        (near, right), (far, left) = (torch.stack([each(x), each(y)]).tolist() for each in (torch.min, torch.max))
        size = {"x_m": (near + far) / 2, "y_m": (left + right) / 2, "length_m": far - near, "width_m": left - right}
        observer = self.observer.model_copy(update={"eye_m": tuple(eye.tolist()), "name": None})
        placed = self.model_copy(update={**size, "observer": observer})
        try:
            _ = placed.held
        except ValidationError as error:
            raise LuxloopError(
                f"observer: the picture falls on the road from {near:.3g} to {far:.3g} m ahead, {size['width_m']:.3g} m wide, where no "
                "controller can hold it; lower the picture, or bring it nearer to the observer's feet"
            ) from error
        return placed

    def on_flat_road(self, picture: Tensor, now: Situation) -> Tensor:
        """The image `CELLS` of a placed symbol on its rectangle of the flat road, for a picture `[h, w]` that its observer sees."""
        if self.observer is None:
            return picture
        cells = cells_of_rectangle((self.length_m, self.width_m), CELLS, torch.zeros(0, dtype=torch.float64))
        points = cells + cells.new_tensor([self.x_m, self.y_m, 0.0])[:, None, None]
        eye = _world(now, self.observer.eye_m)
        origin, d1, d2 = self.observer.picture(now, eye)
        normal = torch.linalg.cross(d1, d2)
        ways = points - eye[:, None, None]
        hits = ways * ((origin - eye) @ normal / torch.tensordot(normal, ways, 1)) + (eye - origin)[:, None, None]  # from the origin
        u, v = (2 * torch.tensordot(edge, hits, 1) / (edge @ edge) - 1 for edge in (d1, d2))
        return resample(picture[None, None], u[None].to(picture), v[None].to(picture))[0, 0]

    @property
    def start_pose(self) -> StartParams:
        """The pose at which control starts."""
        return StartParams(x_m=self.x_m, y_m=self.y_m) if self.start is None else self.start

    @property
    def held(self) -> SymbolParams:
        """The symbol's parameters for its controller."""
        given = {key: getattr(self, key) for key in SymbolParams.model_fields}
        return SymbolParams.model_validate(given if self.observer is None else given | {"target": "place"})

    def shows(self, now: Situation) -> bool:
        """Whether the symbol is drawn now."""
        return self.active(now) and not (self.when and not self.when.holds(now)) and not (self.unless and self.unless.holds(now))

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """One primitive; none if the symbol is not shown or a controller commands it."""
        if self.controller is not None or not self.shows(now):
            return ()
        image = animate(now.symbols[self.image], self.animation, now.time_s - (self.start_s or 0.0))
        if image is None:
            return ()
        if self.observer is None:
            return (self.draw(self._place(now), image),)
        eye = self.observer.eye(now)
        return () if eye is None else (self._draw_for(eye, self.observer.picture(now, eye), image, now),)

    def _place(self, now: Situation) -> Place:
        yaw = torch.deg2rad(torch.tensor(self.yaw_deg, dtype=torch.float64))
        ahead, left = torch.stack([yaw.cos(), yaw.sin()]), torch.stack([-yaw.sin(), yaw.cos()])
        d1, d2 = -self.width_m * left, -self.length_m * ahead
        return on_road(now.T_world_vehicle, torch.tensor([self.x_m, self.y_m]).to(d1) - (d1 + d2) / 2, d1, d2)

    def _draw_for(self, eye: Tensor, picture: tuple[Tensor, Tensor, Tensor], image: Tensor, now: Situation) -> Primitives:
        T = now.T_world_vehicle.to(eye)
        place = drawing_rectangle(*picture, eye, T[:3, 3], T[:3, 2])
        if not all(bool(v.isfinite().all()) for v in place):
            raise LuxloopError(
                "observer.centre_m and height_m put the picture above the observer's eye, with no road behind it; lower the picture"
            )
        observer = Observer(*(each[None] for each in (eye, *picture)))
        return replace(self.draw(Place(*place, T[:3, 2]), image), observer=observer)


def _world(now: Situation, point_m: tuple[float, float, float]) -> Tensor:
    return transform(now.T_world_vehicle.double(), torch.tensor(point_m, dtype=torch.float64)[:, None])[:, 0]


class PrimitiveParams(DrawingParams):
    """Draws a rectangle at any place and in any attitude.

    Its frame: x along its length towards the image's first row, y to the left across its width, z out of the lit side.
    """

    kind: Literal["primitive"] = "primitive"
    image: str | None = Field(
        None, description="name of a shipped symbol, or path of a picture, SVG, video or folder of pictures; left out: even light"
    )
    x_m: Metres = Field(17.0, description="position of the centre ahead of the car")
    y_m: Metres = Field(0.0, description="lateral position of the centre, left positive")
    z_m: Metres = Field(0.0, description="height of the centre above the road's plane")
    roll_deg: Degrees = Field(0.0, description="rotation about its length, right side down")
    pitch_deg: Slope = Field(0.0, description="rotation about its width: 0 on the road, -90 upright and facing the car")
    yaw_deg: Degrees = Field(0.0, description="rotation to the left")
    width_m: Length = Field(2.0, description="extent across")
    length_m: Length = Field(4.0, description="extent along")
    animation: AnimationParams | None = Field(None, description="animation; left out: none but that of a video itself")
    carrier_sense: CarrierSenseParams | None = Field(
        None, description="draw only while the camera sees no other car draw there; left out: draw regardless"
    )

    def primitives(self, now: Situation) -> tuple[Primitives, ...]:
        """One primitive; none while it is not active or its animation is off."""
        if not self.active(now):
            return ()
        source = WHITE if self.image is None else now.symbols[self.image]
        image = animate(source, self.animation, now.time_s - (self.start_s or 0.0))
        return () if image is None else (self.draw(self._place(now), image),)

    @property
    def adaptive(self) -> bool:
        """Whether the function listens to other cars."""
        return self.carrier_sense is not None

    def start(self) -> CarrierState:
        return CarrierState()

    def step(self, state: CarrierState, now: Situation) -> CarrierState:
        """The state after a frame."""
        assert self.carrier_sense and now.seen
        contrast = stretch_contrast(now.seen, self._pose(now), self.length_m, self.width_m)
        return self.carrier_sense.step(state, now, contrast, self.active(now))

    def adapted(self, state: CarrierState, now: Situation) -> tuple[Primitives, ...]:
        """As `primitives`, in the own turn and not in its pauses."""
        assert self.carrier_sense
        return self.primitives(now) if self.carrier_sense.lights(state, now, now.time_s) else ()

    def base_share(self, state: CarrierState) -> None:
        """No demand on the base beam."""

    def _pose(self, now: Situation) -> Tensor:
        """Pose `[4, 4]` of the rectangle in the ground frame."""
        place = pose_from_degrees((self.x_m, self.y_m, self.z_m), self.roll_deg, self.pitch_deg, self.yaw_deg)
        return now.T_world_vehicle.double() @ place

    def _place(self, now: Situation) -> Place:
        ahead, left, out, centre = self._pose(now)[:3].unbind(-1)
        d1, d2 = -self.width_m * left, -self.length_m * ahead
        return Place(centre - (d1 + d2) / 2, d1, d2, out)
