"""Target intensities: patterns of beams (low, high and others), and rectangles of even light for evaluating controllers (T 8.4)."""

import itertools
import math
from dataclasses import dataclass

import torch
from pydantic import Field, NonNegativeFloat, PositiveFloat
from torch import Tensor

from luxloop.world.errors import LuxloopError, did_you_mean
from luxloop.world.params import Params
from luxloop.world.texels import TexelGrid

SHOULDER_SLOPE = math.tan(math.radians(15.0))


class Pattern(Params):
    """A broad light, a hot spot in it, and a cut-off above both. Angles in deg, h to the right and v up."""

    cutoff_v_deg: float | None = Field(None, description="height of the cut-off's horizontal part; none for a driving beam")
    shoulder_deg: NonNegativeFloat = Field(
        0.0, description="angle right of the centre up to which the cut-off rises at 15 deg; 0 keeps it horizontal"
    )
    decades_per_deg: PositiveFloat = Field(2.8, description="gradient of the cut-off: decades of intensity per degree")
    above_cd: PositiveFloat = Field(220.0, description="intensity above the cut-off, for signs")
    hot_cd: NonNegativeFloat = Field(description="intensity that the hot spot adds to the broad light")
    hot_h_deg: float = Field(0.0, description="centre of the hot spot, right positive")
    hot_v_deg: float = Field(0.0, description="height of the hot spot, relative to the cut-off if there is one")
    hot_left_deg: PositiveFloat = Field(description="standard deviation of the hot spot to the left; the next keys are the other sides")
    hot_right_deg: PositiveFloat
    hot_up_deg: PositiveFloat
    hot_down_deg: PositiveFloat
    broad_cd: NonNegativeFloat = Field(description="intensity of the broad light in the centre")
    broad_width_deg: PositiveFloat = Field(description="half width at which the broad light has fallen to 1/e")
    near_v_deg: float = Field(description="height below which the broad light falls off, so that the near road is not too bright")
    near_deg: PositiveFloat = Field(description="angle over which it falls to 1/e below")
    far_v_deg: float = Field(2.0, description="height above which the broad light falls off")
    far_deg: PositiveFloat = 2.0
    rules: tuple[str, ...] = Field((), description="ids of the sets of test points that the beam should meet")

    def edge(self, h: Tensor) -> Tensor:
        """Height of the cut-off at h."""
        assert self.cutoff_v_deg is not None
        return self.cutoff_v_deg + SHOULDER_SLOPE * h.clamp(0, self.shoulder_deg)

    def intensity(self, h: Tensor, v: Tensor) -> Tensor:
        """Intensity in cd, in the shape of h and v in deg."""
        base = torch.zeros_like(h) if self.cutoff_v_deg is None else self.edge(h)
        side = torch.where(h < self.hot_h_deg, self.hot_left_deg, self.hot_right_deg)
        height = v - base - self.hot_v_deg
        vertical = torch.where(height < 0, self.hot_down_deg, self.hot_up_deg)
        hot = self.hot_cd * torch.exp(-0.5 * (((h - self.hot_h_deg) / side).square() + (height / vertical).square()))
        beyond = ((self.near_v_deg - v).clamp(min=0) / self.near_deg).square() + ((v - self.far_v_deg).clamp(min=0) / self.far_deg).square()
        broad = self.broad_cd * torch.exp(-(h / self.broad_width_deg).square() - beyond)
        beam = hot + broad
        if self.cutoff_v_deg is None:
            return beam
        above = self.above_cd * torch.exp(-((v - 1.5).clamp(min=0) / 3.5).square() - (h / 25).square())
        decades = (1 + beam / above).log10()
        # Steepest on the edge: from beam to above along a half wave of the logarithm.
        phase = ((v - base) * 2 * self.decades_per_deg / decades).clamp(-math.pi / 2, math.pi / 2)
        return above * 10 ** (decades * (0.5 - 0.5 * phase.sin()))


_LOW = Pattern(
    cutoff_v_deg=-0.57,
    shoulder_deg=4.0,
    hot_cd=21_000,
    hot_h_deg=1.0,
    hot_v_deg=-0.4,
    hot_left_deg=3.3,
    hot_right_deg=5.0,
    hot_up_deg=1.0,
    hot_down_deg=0.42,
    broad_cd=12_500,
    broad_width_deg=22.0,
    near_v_deg=-1.2,
    near_deg=4.0,
    rules=("r149-passing-c", "r112-passing-b", "r112-passing-a"),
)
PATTERNS = {
    "low": _LOW,
    "high": Pattern(
        hot_cd=55_000,
        hot_left_deg=3.0,
        hot_right_deg=3.0,
        hot_up_deg=0.9,
        hot_down_deg=1.1,
        broad_cd=14_000,
        broad_width_deg=22.0,
        near_v_deg=-1.2,
        near_deg=4.0,
        far_v_deg=0.5,
        far_deg=2.0,
        rules=("r149-driving-a", "r149-driving-b", "r112-driving-a", "r112-driving-b"),
    ),
    "town": _LOW.model_copy(
        update={
            "shoulder_deg": 0.0,
            "hot_cd": 5_000,
            "hot_h_deg": 0.0,
            "hot_v_deg": -0.5,
            "hot_left_deg": 6.0,
            "hot_right_deg": 6.0,
            "broad_cd": 13_000,
            "broad_width_deg": 33.0,
            "rules": ("r149-passing-v",),
        }
    ),
    "motorway": _LOW.model_copy(
        update={
            "cutoff_v_deg": -0.34,
            "hot_cd": 45_000,
            "hot_h_deg": 0.6,
            "hot_left_deg": 2.0,
            "hot_right_deg": 2.2,
            "near_deg": 3.0,
            "rules": ("r149-passing-c",),
        }
    ),
    "adverse": _LOW.model_copy(
        update={
            "hot_cd": 30_000,
            "hot_down_deg": 0.45,
            "broad_cd": 12_000,
            "broad_width_deg": 26.0,
            "near_v_deg": -1.1,
            "near_deg": 1.9,
            "rules": ("r149-passing-c",),
        }
    ),
    # Found by benchmarks/beams.py for a detector in fog; as much light as the low beam, also on what is above its cut-off.
    "camera": Pattern(
        hot_cd=18_400,
        hot_v_deg=-0.45,
        hot_left_deg=9.4,
        hot_right_deg=9.4,
        hot_up_deg=1.45,
        hot_down_deg=1.45,
        broad_cd=0,
        broad_width_deg=22.0,
        near_v_deg=-1.2,
        near_deg=4.0,
    ),
}


def pattern(name: str) -> Pattern:
    """A beam's pattern by name. Raises LuxloopError that names the nearest one."""
    if name in PATTERNS:
        return PATTERNS[name]
    raise LuxloopError(f"there is no beam {name!r}; {did_you_mean(name, PATTERNS)}")


SETPOINT_CD = 10_000.0

# The thesis gives the ranges of width, height and horizontal position; vertical positions and turns are our choice, within the field.
H_DEG = tuple(2.5 * step for step in range(-4, 5))
V_DEG = (-2.0, -1.0, 0.0, 1.0, 2.0)
WIDTHS_DEG = (1.5, 3.75, 6.0)
HEIGHTS_DEG = (1.0, 2.0, 3.0)
TURNS_DEG = (0.0, 15.0, 30.0)


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in deg about (h, v), left and up positive, turned counter-clockwise as seen from the lamp."""

    h: float
    v: float
    width: float
    height: float
    turn: float = 0.0

    def distance(self, h: Tensor, v: Tensor) -> Tensor:
        """Distance of directions from the rectangle in deg, as the larger of the distances along its sides; negative inside."""
        angle = torch.deg2rad(torch.tensor(self.turn, dtype=h.dtype, device=h.device))
        x, y = h - self.h, v - self.v
        along, across = x * angle.cos() + y * angle.sin(), y * angle.cos() - x * angle.sin()
        return torch.maximum(along.abs() - self.width / 2, across.abs() - self.height / 2)

    def texture(self, grid: TexelGrid, intensity_cd: float = SETPOINT_CD) -> Tensor:
        """The wanted light texture `[rows, cols]` in cd, float32: this intensity inside and none outside.

        Raises: LuxloopError where no texel lies inside.
        """
        y, z = grid.tangents()
        inside = self.distance(torch.rad2deg(y.atan()), torch.rad2deg(z.atan())[:, None]) <= 0
        if not inside.any():
            raise LuxloopError(f"{self} covers no texel of the light texture: place it inside of the lamp's field")
        return intensity_cd * inside.float()


RECTANGLES = [Rectangle(*values) for values in itertools.product(H_DEG, V_DEG, WIDTHS_DEG, HEIGHTS_DEG, TURNS_DEG)]

# One for each position: a balanced design with each width, height and turn 15 times, each pair 5 times, and all in every column and row.
QUICK = [
    Rectangle(h, v, WIDTHS_DEG[(i + j) % 3], HEIGHTS_DEG[(i // 3 + j) % 3], TURNS_DEG[(i + i // 3 + j) % 3])
    for i, h in enumerate(H_DEG)
    for j, v in enumerate(V_DEG)
]
