"""Feed-forward (T 9.4): open loop, and inverse ray tracing onto a known road or one measured by structured light (T 3.5.2)."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from luxloop.controllers.symbol.heights.forward_model import ForwardModel
from luxloop.controllers.symbol.heights.height_controller import region_of
from luxloop.controllers.symbol.heights.height_map import Belief, HeightMap
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.controllers.symbol.sensing.road_shape import HERE, tangent_plane
from luxloop.controllers.symbol.sensing.symbol_sensor import Observation, SymbolSensor
from luxloop.perception.birdseye import Region, cells
from luxloop.perception.camera import camera_view
from luxloop.perception.egomotion import Ego
from luxloop.world.errors import locate
from luxloop.world.frames import inverse, transform
from luxloop.world.params import Params
from luxloop.world.roads.base import Floats
from luxloop.world.roads.shapes import Flat, RoadParams


class OpenLoopParams(Params):
    """No control: always shows the pose for a flat road, whatever the start pose."""

    name: Literal["open"] = "open"


class OpenLoop:
    """Always shows the target pose `[4]`; the state is the projection."""

    def __init__(self, target: Tensor) -> None:
        self.target = target

    def start(self, pose: Tensor) -> ProjectionCommand:
        """The undistorted symbol at the target, in the shape of the pose `[..., 4]`."""
        return ProjectionCommand(self.target.expand_as(pose))

    def projection(self, state: ProjectionCommand, ego: Ego | None) -> ProjectionCommand:
        """The constant projection."""
        return state

    def step(self, state: ProjectionCommand, observation: Observation) -> ProjectionCommand:
        """The state, unchanged."""
        return state


CELL_M = 0.1
BEYOND_M = (1.2, 1.5, 0.6)  # margin of the evaluated road around the symbol: near, far, sides
NEAREST_M, FARTHEST_M = 4.0, 60.0  # from the eye: range in which lines of sight meet a given road
SAMPLES = 21  # along and across a symbol, of the road that a plane is fitted to
PATTERN_CELL_M = (0.15, 0.1)
HIGHEST_M = 0.2  # greatest height or depth; beyond it a code is wrong
SMOOTHING = ((1.0, 1.5), (1e-3, 8.0))  # weight and standard deviation in cells: of the data, and of the filling of gaps
LAYERS, HALVINGS = 200, 12  # samples along a line of sight, 1.5 % apart, and bisections at the road


class FeedforwardParams(Params):
    """Draws for a known road, or for a road measured by a survey in the first steps. Later frames are not used."""

    name: Literal["feedforward"] = "feedforward"
    road: RoadParams = Field(Flat(), description="the road's shape, with the keys of [road]")
    survey: bool = Field(False, description="measure the road with structured light in the first steps, in place of controller.road")
    offset_m: float = Field(0.0, ge=-0.2, le=0.2, description="error added to the road's heights, to study a wrong road")


class Feedforward(OpenLoop):
    """Always draws for the known road."""

    def __init__(self, params: FeedforwardParams, sensor: SymbolSensor) -> None:
        symbol = sensor.projector.params
        with locate("controller"):
            plane = HERE if symbol.target == "appearance" else plane_of(params.road.z, symbol)
            eye = transform(inverse(plane), camera_view(sensor.camera).origin[:, None])[:, 0]
            relief = height_map_of(params.road.z, region_around(sensor), eye, params.offset_m, plane)
        self.believed = Belief(relief, plane, HERE)
        self.drawn = self.believed.draw(sensor.projector)

    def start(self, pose: Tensor) -> ProjectionCommand:
        """The symbol for the known road, whatever the pose `[4]`."""
        return self.drawn

    def belief(self, state: ProjectionCommand, ego: Ego | None) -> Belief:
        """The known road under a level body."""
        return self.believed


@dataclass(frozen=True)
class MeasuringState:
    """State of the survey.

    next: index of the shown pattern. seen: contrast `[h, w]` in cd/m^2 of each pattern, None while missing. projection: command for the
    measured road, None during the survey.
    """

    next: int
    seen: tuple[Tensor | None, ...]
    projection: ProjectionCommand | None = None


class MeasuringFeedforward:
    """Shows Gray code patterns and their inverses with the first drawing module, triangulates the road, and draws for it."""

    def __init__(self, params: FeedforwardParams, sensor: SymbolSensor) -> None:
        self.params, self.sensor = params, sensor
        modules = sensor.projector.modules
        self.headlight = modules[0].pixel_controller.headlight
        self.forward_model = ForwardModel.prepare(sensor, region_around(sensor), PATTERN_CELL_M, 2, 1)
        rows = self.headlight.pixel_rows
        codes = cv2.structured_light.GrayCodePattern.create(1, rows).generate()[1]
        others = tuple(each.pixel_controller.default for each in modules[1:])
        stripes = [self._stripes(code) for code in codes]
        self.patterns = tuple(ProjectionCommand(sensor.projector.target, raw=(u, *others)) for u in stripes)
        whole = stripes[0] + stripes[1] - 2 * modules[0].pixel_controller.default
        self.lit = (
            self.headlight.light_texture(whole),
            *(each.pixel_controller.headlight.light_texture(0 * each.pixel_controller.default) for each in modules[1:]),
        )

    def start(self, pose: Tensor) -> MeasuringState:
        """The first pattern, whatever the pose `[4]`."""
        return MeasuringState(0, (None,) * len(self.patterns))

    def projection(self, state: MeasuringState, ego: Ego | None) -> ProjectionCommand:
        """A pattern, or the symbol for the measured road."""
        return state.projection or self.patterns[state.next]

    def step(self, state: MeasuringState, observation: Observation) -> MeasuringState:
        """Store the contrast of the shown pattern; repeat patterns whose frames are late or lost; then triangulate the road."""
        if state.projection is not None:
            return state
        seen = list(state.seen)
        for k, pattern in enumerate(self.patterns):
            if observation.frames is not None and observation.shown.projection.shows(pattern):
                seen[k] = self.forward_model.observe(observation.frames)[0]
        after = [(state.next + 1 + k) % len(seen) for k in range(len(seen))]
        missing = next((k for k in after if seen[k] is None), None)
        if missing is not None:
            return MeasuringState(missing, tuple(seen))
        relief = self.relief(tuple(seen))
        relief = replace(relief, heights=relief.heights + self.params.offset_m)
        return MeasuringState(state.next, tuple(seen), Belief(relief, HERE, HERE).draw(self.sensor.projector))

    def relief(self, seen: tuple[Tensor | None, ...]) -> HeightMap:
        """The road measured by the contrasts of all patterns."""
        contrasts = torch.stack([each for each in seen if each is not None])
        bits = (contrasts[0::2] > contrasts[1::2]).long()
        binary = bits.cumsum(0) % 2  # from Gray code
        row = (binary * (2 ** torch.arange(len(bits) - 1, -1, -1, device=bits.device))[:, None, None]).sum(0)
        lamp, forward_model = self.forward_model.lamps[0], self.forward_model
        v = self._down(row)
        height = (v * lamp.on_plane[0] - lamp.on_plane[2]) / (lamp.per_m[2] - v * lamp.per_m[0])
        lit = contrasts[0] + contrasts[1]
        usable = (height.abs() < HIGHEST_M) & (lit > 0.2 * lit.median()) & (forward_model.inside > 0)
        heights = self._smooth(torch.where(usable, height, 0.0), usable.to(height))
        expected = forward_model.luminance(self.lit, forward_model.on_pixels(heights.flatten())[None])[0] * usable
        return HeightMap(forward_model.region, forward_model.eye, heights, self._smooth(lit * usable, expected))

    def _smooth(self, values: Tensor, weights: Tensor) -> Tensor:
        """Sum of values over sum of weights, both `[h, w]`, around each node: `[rows, cols]`."""
        from kornia.filters import gaussian_blur2d

        found = self.forward_model.on_nodes(torch.stack([values, weights])).view(1, 2, self.forward_model.rows, self.forward_model.cols)
        parts = [
            share * gaussian_blur2d(found, (2 * int(3 * sigma) + 1,) * 2, (sigma, sigma), border_type="replicate")[0]
            for share, sigma in SMOOTHING
        ]
        above, below = torch.stack(parts).sum(0)
        return above / below.clamp(min=1e-12)

    def _stripes(self, code: np.ndarray) -> Tensor:
        like = self.headlight.matrix.values
        lit = torch.from_numpy(code[:, 0] > 0).to(like)
        return lit[:, None].expand(-1, self.headlight.pixel_cols).flatten()

    def _down(self, row: Tensor) -> Tensor:
        """Texture coordinate v, -1..1 downwards, of pixel rows `[h, w]`, by the centre of their light in the texture."""
        light = self.headlight
        number = torch.arange(light.pixel_rows).to(light.matrix.values)[:, None].expand(-1, light.pixel_cols).flatten()
        weighted, whole = (light.light_texture(u).sum(-1).cpu() for u in (number, torch.ones_like(number)))
        mean = (weighted / whole.clamp(min=1e-9))[whole > 0]
        v = (2 * torch.arange(light.rows) + 1)[whole > 0] / light.rows - 1
        order = mean.argsort()
        return torch.from_numpy(np.interp(row.cpu().numpy(), mean[order].numpy(), v[order].numpy())).to(self.forward_model.inside)


def region_around(sensor: SymbolSensor) -> Region:
    """Region of the plane that the symbol's light crosses on roads of any height."""
    return region_of(sensor.projector.params, *BEYOND_M)


def plane_of(z: Callable[[Floats, Floats], Floats], symbol: SymbolParams) -> Tensor:
    """Pose `[4, 4]` of the plane that fits a road best under a symbol's target."""
    along, across = (length * torch.linspace(-0.5, 0.5, SAMPLES, dtype=torch.float64) for length in (symbol.length_m, symbol.width_m))
    x, y = (each.flatten() for each in torch.meshgrid(along, across, indexing="ij"))
    heights = torch.from_numpy(z((symbol.x_m + x).numpy(), (symbol.y_m + y).numpy()))
    slope_x, slope_y, level = torch.linalg.lstsq(torch.stack([x, y, torch.ones_like(x)], 1), heights[:, None]).solution[:, 0]
    at = torch.stack([level.new_tensor(symbol.x_m), level.new_tensor(symbol.y_m), level])
    return tangent_plane(at, slope_x, slope_y, symbol.x_m, symbol.y_m)


def height_map_of(
    z: Callable[[Floats, Floats], Floats], region: Region, eye: Tensor, offset_m: float = 0.0, T_ground_plane: Tensor = HERE
) -> HeightMap:
    """The height map of a road for an eye at `[3]` m: lines of sight are followed to their first point below the road.

    z: road height in m at x and y in m (`Road.z`). offset_m: added to the height. T_ground_plane: `[4, 4]`, frame of region, eye and
    returned heights. Lines of sight that meet no road end FARTHEST_M ahead.
    """
    places = cells(replace(region, cell_m=CELL_M))
    eye, ways = eye.double(), places - eye.double()[:, None, None]

    def at(share: Tensor) -> Tensor:  # of the way from the eye to the plane
        return eye[:, None, None, None] + ways[:, None] * share

    def under(share: Tensor) -> Tensor:
        point = transform(T_ground_plane, at(share).flatten(1)).view(3, *share.shape)
        return torch.from_numpy(z(point[0].numpy(), point[1].numpy())) + offset_m >= point[2]

    distances = torch.logspace(math.log10(NEAREST_M), math.log10(FARTHEST_M), LAYERS, dtype=torch.float64)
    shares = distances[:, None, None] / ways[0]
    first = under(shares).to(torch.uint8).argmax(0, keepdim=True)
    met = first > 0
    low, high = (torch.where(met, shares.gather(0, each), shares[-1:]) for each in ((first - 1).clamp(min=0), first))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        is_under = under(middle)
        low, high = torch.where(is_under, low, middle), torch.where(is_under, middle, high)
    heights = at(high)[2, 0]
    return HeightMap(region, eye.float(), heights.float(), torch.ones(heights.shape))
