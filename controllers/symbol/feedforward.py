"""Feed-forward: inverse ray tracing onto a road that is given, right or wrong, or that is surveyed with structured light first."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from controllers.symbol.drawing import Drawing, warp_onto
from controllers.symbol.luxloop import region_of
from controllers.symbol.observer import Observer
from controllers.symbol.projector import Projector
from controllers.symbol.protocol import Look
from controllers.symbol.relief import Relief
from controllers.symbol.survey import Survey, SurveyState
from perception.birdseye import Region
from perception.camera import camera_view
from world.errors import located
from world.params import Params
from world.roadbase import Floats
from world.roads import Flat, RoadParams

CELL_M = 0.1
BEYOND_M = (1.2, 1.5, 0.6)  # how far a road is looked at beyond the symbol: near, far, sides
HIGHEST_M, LAYERS = 0.3, 121  # heights between which a given road may be, and how many are looked at


class FeedforwardParams(Params):
    """Draws for the road that is given, or that a survey at the beginning measures. What the camera sees later is not used."""

    name: Literal["feedforward"] = "feedforward"
    road: RoadParams = Field(Flat(), description="the road's shape, with the keys of [road]")
    survey: bool = Field(False, description="measure the road with structured light in the first steps, in place of [controller.road]")
    offset_m: float = Field(0.0, ge=-0.2, le=0.2, description="added to its heights, to see what a wrong road does")


class Feedforward:
    """Draws for the given road for ever; the state is the drawing."""

    def __init__(self, params: FeedforwardParams, observer: Observer) -> None:
        with located("controller"):
            relief = relief_of(params.road.z, region_around(observer), camera_view(observer.camera).origin, params.offset_m)
        self.drawn = drawn_on(relief, observer.projector)

    def start(self, pose: Tensor) -> Drawing:
        """The symbol for the given road, whatever the pose `[4]`."""
        return self.drawn

    def drawing(self, state: Drawing) -> Drawing:
        """The same for ever."""
        return state

    def step(self, state: Drawing, look: Look) -> Drawing:
        """Nothing changes."""
        return state


@dataclass(frozen=True)
class SurveyedState:
    """survey: what was seen of the patterns. drawing: for the road that they told, None before."""

    survey: SurveyState
    drawing: Drawing | None = None


class Surveyed:
    """Surveys the road, then draws for it for ever."""

    def __init__(self, params: FeedforwardParams, observer: Observer) -> None:
        self.params, self.projector = params, observer.projector
        self.survey = Survey(observer, region_around(observer))

    def start(self, pose: Tensor) -> SurveyedState:
        """The first pattern, whatever the pose `[4]`."""
        return SurveyedState(self.survey.start())

    def drawing(self, state: SurveyedState) -> Drawing:
        """A pattern, or the symbol for the road that was found."""
        return state.drawing or self.survey.drawing(state.survey)

    def step(self, state: SurveyedState, look: Look) -> SurveyedState:
        """Go on with the survey; draw as soon as it is complete."""
        if state.drawing is not None:
            return state
        survey = self.survey.step(state.survey, look)
        if not survey.complete:
            return SurveyedState(survey)
        relief = self.survey.relief(survey)
        relief = replace(relief, heights=relief.heights + self.params.offset_m)
        return SurveyedState(survey, drawn_on(relief, self.projector))


def region_around(observer: Observer) -> Region:
    """The plane that light for the symbol crosses, high or low."""
    return region_of(observer.projector.params, *BEYOND_M)


def drawn_on(relief: Relief, projector: Projector) -> Drawing:
    """The symbol for a road."""
    symbol = projector.params
    lamps = torch.stack([module.T_world_headlight[:3, 3] for module in projector.modules]).to(relief.heights)
    warp = warp_onto(relief, lamps, (symbol.x_m, symbol.y_m), symbol.length_m, symbol.width_m)
    return Drawing(projector.target, warp=warp.to(projector.symbol.device))


def relief_of(z: Callable[[Floats, Floats], Floats], region: Region, eye: Tensor, offset_m: float = 0.0) -> Relief:
    """A road as an eye at `[3]` m sees it: lines of sight are followed down to the first height below the road's.

    z: its heights in m at x and y in m (`Road.z`). offset_m: added to them.
    """
    rows, cols = (round((far - near) / CELL_M) for far, near in ((region.x_far_m, region.x_near_m), (region.y_left_m, region.y_right_m)))
    x = region.x_far_m - (torch.arange(rows, dtype=torch.float64)[:, None] + 0.5) * CELL_M
    y = region.y_left_m - (torch.arange(cols, dtype=torch.float64) + 0.5) * CELL_M
    h = torch.linspace(HIGHEST_M, -HIGHEST_M, LAYERS, dtype=torch.float64)[:, None, None]
    places = [(point + (eye[axis] - point) * (h / eye[2])).expand(LAYERS, rows, cols) for axis, point in enumerate((x, y))]
    road = torch.from_numpy(z(*(place.numpy() for place in places))) + offset_m
    above = road - h
    first = (above >= 0).to(torch.uint8).argmax(0, keepdim=True).clamp(min=1)
    under, over = above.gather(0, first), above.gather(0, first - 1)
    share = (under / (under - over).clamp(min=1e-9)).clamp(0, 1)
    step = 2 * HIGHEST_M / (LAYERS - 1)
    heights = (h.expand_as(above).gather(0, first) + share * step)[0]
    return Relief(region, eye.float(), heights.float(), torch.ones(rows, cols))
