"""The symbol's appearance: raw moments, five centroids and the four errors (T 9.4.2)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import torch
from torch import Tensor


@dataclass(frozen=True)
class Axes:
    """Coordinates of an image's columns `[..., w]` and rows `[..., h]`, evenly spaced: px in a camera image, m in a bird's-eye view."""

    u: Tensor
    v: Tensor

    @cached_property
    def steps(self) -> tuple[Tensor, Tensor]:
        """Distance of the columns and of the rows, `[..., 1]` each; zero for a single one."""
        return _step(self.u), _step(self.v)


def image_axes(height: int, width: int, u_start: int = 0, v_start: int = 0, like: Tensor | None = None) -> Axes:
    """Pixel centres at integer + 0.5 of an image, or of a crop of it that starts at (u_start, v_start)."""
    like = torch.zeros(()) if like is None else like

    def centres(start: int, n: int) -> Tensor:
        return torch.arange(n, dtype=like.dtype, device=like.device) + (start + 0.5)

    return Axes(centres(u_start, width), centres(v_start, height))


@dataclass(frozen=True)
class Appearance:
    """Moments of a symbol image.

    area: `[...]`, zeroth moment in units of the axes squared. centroids: `[..., 5, 2]`, (u, v) of centre, top left, top right, bottom left,
    bottom right. shear: `[...]`, mu11 / mu20. length: `[...]`, sqrt(mu02 - mu11^2 / mu20), both from second moments.
    """

    area: Tensor
    centroids: Tensor
    shear: Tensor
    length: Tensor


def _step(axis: Tensor) -> Tensor:
    """Distance of the pixels of an axis `[..., n]`, `[..., 1]`; zero for a single pixel."""
    return axis[..., 1:2] - axis[..., :1] if axis.shape[-1] > 1 else axis.new_zeros(*axis.shape[:-1], 1)


def _halves(axis: Tensor, step: Tensor, split: Tensor) -> tuple[Tensor, Tensor]:
    """Share of each pixel before and after the split, by area, and first moment of each share: both `[..., 2, n]`."""
    before = ((split[..., None] - axis) / step + 0.5).clamp(0, 1)
    after = 1 - before
    centres = torch.stack([axis - step * after / 2, axis + step * before / 2], -2)
    shares = torch.stack([before, after], -2)
    return shares, shares * centres


def area(image: Tensor, axes: Axes) -> Tensor:
    """Zeroth moment of a symbol image `[..., h, w]`, in units of the axes squared: `[...]` (T eq. 9.4.1)."""
    step_u, step_v = axes.steps
    return image.sum((-2, -1)) * (step_u * step_v)[..., 0].abs().to(image)


def appearance(image: Tensor, axes: Axes) -> Appearance:
    """Raw moments (T eq. 9.4.1), centre (T eq. 9.4.2), quadrant centroids and second-moment shape of a symbol image `[..., h, w]`.

    The image is split at its centre. Pixels on the split are divided by area, each part with its own centre, so centroids are continuous.
    An empty image gives NaN.
    """
    u, v = axes.u.to(image), axes.v.to(image)
    columns, rows = image.sum(-2), image.sum(-1)
    m00 = columns.sum(-1)
    cu, cv = (columns * u).sum(-1) / m00, (rows * v).sum(-1) / m00
    du, dv = u - cu[..., None], v - cv[..., None]
    mu20 = (columns * du * du).sum(-1) / m00
    mu02 = (rows * dv * dv).sum(-1) / m00
    mu11 = ((image @ du[..., None])[..., 0] * dv).sum(-1) / m00

    step_u, step_v = (step.to(image) for step in axes.steps)
    (across, across_u), (along, along_v) = _halves(u, step_u, cu), _halves(v, step_v, cv)
    across_image = image @ across.transpose(-1, -2)
    q00 = along @ across_image
    q10 = along @ (image @ across_u.transpose(-1, -2))
    q01 = along_v @ across_image
    quadrants = torch.stack([q10 / q00, q01 / q00], -1).flatten(-3, -2)
    centre = torch.stack([cu, cv], -1)[..., None, :]
    size, length = m00 * (step_u * step_v)[..., 0].abs(), (mu02 - mu11**2 / mu20).clamp(min=0).sqrt()
    return Appearance(size, torch.cat([centre, quadrants], -2), mu11 / mu20, length)


def _quadrants(seen: Appearance, *signs: int) -> Tensor:
    """Half the signed sum of the quadrants' centroids, `[..., 2]` (T eq. 9.4.3, 9.4.4 of one symbol)."""
    tl, tr, bl, br = seen.centroids[..., 1:, :].unbind(-2)
    a, b, c, d = signs
    return ((tr * a + tl * b) + (br * c + bl * d)) / 2


@dataclass(frozen=True)
class DegreeOfFreedom:
    """A coordinate of the symbol's pose, and the error with the same name.

    name, unit: such as "x" in "m" or "roll" in "rad". probe: half the step about the target that measures the plant gain, in the unit;
    large against pixel edges. moves: name of the error that the coordinate changes most; x (ahead) changes e_y. feature: `[...]`, the
    feature whose difference is the error; second argument: the key `features.shape`. of_pose: the coordinate of poses `[..., 4, 4]`. shown,
    error: texts of the columns in recordings: description of the coordinate; unit and description of the error.
    """

    name: str
    unit: Literal["m", "rad"]
    probe: float
    moves: str
    feature: Callable[[Appearance, str], Tensor]
    of_pose: Callable[[Tensor], Tensor]
    shown: str
    error: tuple[str, str]

    @property
    def suffix(self) -> str:
        """The unit in files, "m" or "deg"."""
        return "m" if self.unit == "m" else "deg"

    @property
    def key(self) -> str:
        """The name in scenarios and in columns of recordings, such as "roll_deg"."""
        return f"{self.name}_{self.suffix}"

    def of_file(self, value: float) -> float:
        """A scenario's value in m or rad."""
        return value if self.unit == "m" else math.radians(value)

    def limits(self, params: object, name: str | None = None) -> tuple[float, float]:
        """Limits `<name>_range_<suffix>` of params in m or rad; infinite by default."""
        low, high = getattr(params, f"{name or self.name}_range_{self.suffix}", (-math.inf, math.inf))
        return self.of_file(low), self.of_file(high)


# All degrees of freedom, positions first and then angles in the order of `luxloop.world.frames.rotation`. A new one also needs its keys
# in the controllers that limit it and in `start`; poses, features, gains, errors and columns follow.
DEGREES: tuple[DegreeOfFreedom, ...] = (
    DegreeOfFreedom(
        "x",
        "m",
        0.3,
        "y",
        lambda seen, _: seen.centroids[..., 0, 0],
        lambda T: T[..., 0, 3],
        "shown pose of the primitive: centre ahead of the lamps",
        ("axes", "error of the centre along u, seen minus target"),
    ),
    DegreeOfFreedom(
        "y",
        "m",
        0.1,
        "x",
        lambda seen, _: seen.centroids[..., 0, 1],
        lambda T: T[..., 1, 3],
        "shown pose: centre to the left",
        ("axes", "error of the centre along v"),
    ),
    DegreeOfFreedom(
        "roll",
        "rad",
        math.radians(1.0),
        "roll",
        lambda seen, shape: _quadrants(seen, 1, -1, 1, -1)[..., 1] if shape == "quadrants" else seen.shear,
        lambda T: torch.atan2(T[..., 2, 1], T[..., 2, 2]),
        "shown pose: rotation about the forward axis",
        ("feature", "error of the roll feature"),
    ),
    DegreeOfFreedom(
        "pitch",
        "rad",
        math.radians(0.5),
        "pitch",
        lambda seen, shape: _quadrants(seen, 1, 1, -1, -1)[..., 1] if shape == "quadrants" else seen.length,
        lambda T: torch.asin(-T[..., 2, 0]),
        "shown pose: rotation about the left axis, nose down positive",
        ("feature", "error of the pitch feature"),
    ),
)


def probes(like: Tensor) -> Tensor:
    """Steps of a pose by the probe of each degree of freedom, `[n, n]`."""
    return torch.diag(like.new_tensor([degree.probe for degree in DEGREES]))


def error_indices() -> list[int]:
    """For each degree of freedom the index of the error that it changes most: x acts on the image's v, y on u."""
    names = [degree.name for degree in DEGREES]
    return [names.index(degree.moves) for degree in DEGREES]


def features(seen: Appearance, shape: str) -> Tensor:
    """The features `[..., n]` of all degrees of freedom, whose differences are the errors: centre u, centre v, roll, pitch.

    shape "quadrants": T eq. 9.4.3 and 9.4.4 of one symbol, in units of the axes; "moments": shear and length.
    """
    return torch.stack([degree.feature(seen, shape) for degree in DEGREES], -1)


def errors(current: Tensor, target: Tensor) -> Tensor:
    """e_x, e_y, e_roll, e_pitch `[..., n]`: current features minus target features (T eq. 9.4.3, 9.4.4)."""
    return current - target
