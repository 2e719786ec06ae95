"""Primitives: rectangles in the world that carry a symbol image and a setpoint (T 7.1, 7.2.1)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.frames import rotation

Quantity = Literal["I_v", "E_v", "u_abs", "u_rel"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)  # a quantity's code is its index here
I_V, E_V, U_ABS, U_REL = range(4)
Vector = Tensor | Sequence[float]
HEAVIEST = 1e12  # limit of finite weights, so that their sums stay finite

_VECTORS = ("origin", "d1", "d2", "normal")
_SEEN = ("eye", "origin", "d1", "d2")
_ON_HOST = ("quantity", "forced", "priority", "nearest", "shared")


@dataclass(frozen=True)
class Observer:
    """Observers to whom symbols appear undistorted (T 7.2.2): eyes and the rectangles of upright symbols in m, `[..., P, 3]` each.

    active: `[P]` bool, which primitives have an observer; by default the only one.
    """

    eye: Tensor
    origin: Tensor
    d1: Tensor
    d2: Tensor
    active: Tensor = field(default_factory=lambda: torch.tensor([True]))


@dataclass(frozen=True)
class Primitives:
    """P rectangles per scene, batch dimensions first. Fields without batch dimensions stay on the host, since program flow depends on them.

    origin: `[..., P, 3]` m in the world, the corner where symbol coordinates are (0, 0). d1: `[..., P, 3]` m, the edge along symbol u. d2:
    `[..., P, 3]` m, the edge along symbol v. normal: `[..., P, 3]`, unit, of the side that takes light. value: `[..., P]`, setpoint at
    symbol value 1 in cd, lx or as a share. weight: `[..., P]`, 0 to infinity: 0 occludes without counting, infinity overrides all finite
    ones, and finite ones are limited to HEAVIEST. quantity: `[P]` int64, indices in QUANTITIES. forced: `[P]` bool, drawn even behind other
    primitives. priority: `[P]` int64, decides between forced hits and between coplanar ones. symbols: images `[h, w]` in 0..1, row 0 at v =
    0, or `[2, h, w]` with opacity; rays pass where it is below 1/2, except in masks. symbol_of: `[P]` int64, indices of images. nearest:
    `[P]` bool, sample images at the nearest texel instead of bilinearly. modules: names of the modules or lamps that may draw each; empty:
    all. shared: `[P]` bool, the drawing modules share a setpoint in cd or lx instead of each giving the whole. observer: observers of the
    primitives, None without any.
    """

    origin: Tensor
    d1: Tensor
    d2: Tensor
    normal: Tensor
    value: Tensor
    weight: Tensor
    quantity: Tensor
    forced: Tensor
    priority: Tensor
    symbols: tuple[Tensor, ...]
    symbol_of: Tensor
    nearest: Tensor
    modules: tuple[tuple[str, ...], ...]
    shared: Tensor
    observer: Observer | None = None

    def __len__(self) -> int:
        return self.origin.shape[-2]

    def image_of(self, p: int) -> Tensor:
        """The image of the p-th primitive, `[h, w]` or `[2, h, w]`."""
        return self.symbols[int(self.symbol_of[p])]

    def has_observer(self, p: int) -> bool:
        """Whether the p-th primitive has an observer."""
        return self.observer is not None and bool(self.observer.active[p])

    def corners(self) -> Tensor:
        """The four corners, `[..., P, 4, 3]` m."""
        return self._corners

    @cached_property
    def _corners(self) -> Tensor:
        return torch.stack([self.origin, self.origin + self.d1, self.origin + self.d2, self.origin + self.d1 + self.d2], -2)

    def select(self, mask: Tensor) -> "Primitives":
        """The primitives where mask `[P]` bool is true, with all images."""
        at = mask.cpu().nonzero()[:, 0]
        there = at.to(self.origin.device)
        picked = _change(self, lambda each: each[..., there, :], *_VECTORS)
        picked = _change(picked, lambda each: each[..., there], "value", "weight")
        picked = _change(picked, lambda each: each[at], *_ON_HOST, "symbol_of")
        observer = self.observer and replace(
            _change(self.observer, lambda each: each[..., there, :], *_SEEN), active=self.observer.active[at]
        )
        return replace(picked, modules=tuple(self.modules[k] for k in at.tolist()), observer=observer)

    def for_module(self, name: str) -> "Primitives":
        """The primitives that a module may draw; "left lores" matches its name, "left" and "lores"."""
        may = [names_module(names, name) for names in self.modules]
        return self if all(may) else self.select(torch.tensor(may))

    def transform(self, T: Tensor) -> "Primitives":
        """The primitives transformed by T `[4, 4]`, which takes points of their frame to the new one; they must have no observers."""
        R, origin = T[:3, :3].to(self.origin), T[:3, 3].to(self.origin)
        turned = _change(self, lambda each: each @ R.T, *_VECTORS)
        return replace(turned, origin=turned.origin + origin)

    def to(self, target: torch.device | torch.dtype) -> "Primitives":
        """The primitives with coordinates, setpoints and images on a device or in a floating dtype."""
        moved = _change(self, lambda each: each.to(target), *_VECTORS, "value", "weight")
        observer = self.observer and _change(self.observer, lambda each: each.to(target), *_SEEN)
        return replace(moved, symbols=tuple(symbol.to(target) for symbol in self.symbols), observer=observer)


def _change(of: Any, change: Callable[[Tensor], Tensor], *names: str) -> Any:
    """A copy with a function applied to the tensors of some names."""
    return replace(of, **{name: change(getattr(of, name)) for name in names})


def rectangle(  # noqa: PLR0913 (each value stands by itself)
    origin: Vector,
    d1: Vector,
    d2: Vector,
    value: float | Tensor,
    quantity: Quantity = "u_abs",
    *,
    normal: Vector | None = None,
    symbol: Tensor | None = None,
    weight: float | Tensor = 1.0,
    forced: bool = False,
    priority: int = 0,
    nearest: bool = False,
    modules: Sequence[str] = (),
    shared: bool = True,
) -> Primitives:
    """One rectangle with a setpoint (T 4.2.2, 7.2.1), or several that share all but position, setpoint and weight.

    origin, d1, d2: `[3]` or `[..., P, 3]` m, a corner and the edges along the symbol's columns and rows; tensors, or sequences of numbers.
    value: number or `[..., P]`, setpoint where the symbol is 1, of the quantity "u_abs" (utilisation 0..1), "u_rel" (multiple of the base
    pattern), "I_v" (cd) or "E_v" (lx). normal: of any length, by default d1 x d2. symbol: `[h, w]` in 0..1 or `[2, h, w]` with opacity, by
    default homogeneous. weight: number or `[..., P]`. forced, priority, nearest, modules, shared: see `Primitives`. Raises LuxloopError for
    an unknown quantity, a symbol that is no image, and, for weights on the host, a weight below zero or NaN.
    """
    if quantity not in QUANTITIES:
        raise LuxloopError(f"a primitive has no quantity {quantity!r}; the quantities are {', '.join(QUANTITIES)}")
    symbol = torch.ones(1, 1) if symbol is None else symbol
    if symbol.shape[:-2] not in ((), (2,)) or symbol.ndim < 2 or not symbol.numel():
        raise LuxloopError(f"a primitive's symbol is an image [rows, columns], or two with its opacity, not of shape {list(symbol.shape)}")
    if not (weight >= 0 if not isinstance(weight, Tensor) else weight.device.type != "cpu" or bool((weight >= 0).all())):
        raise LuxloopError("a primitive's weight is below zero or not a number; give 0 to infinity")
    like = next((each for each in (origin, d1, d2) if isinstance(each, Tensor)), torch.empty(0))
    vectors = (
        each if isinstance(each, Tensor) else torch.as_tensor(each, dtype=like.dtype, device=like.device) for each in (origin, d1, d2)
    )
    at, along, down = torch.broadcast_tensors(*torch.atleast_2d(*vectors))
    normal = torch.linalg.cross(along, down) if normal is None else torch.as_tensor(normal).to(at).expand_as(at)
    P = at.shape[-2]

    def each(number: float | Tensor) -> Tensor:
        return torch.as_tensor(number, dtype=at.dtype, device=at.device).expand(at.shape[:-1])

    return Primitives(
        at,
        along,
        down,
        torch.nn.functional.normalize(normal, dim=-1),
        each(value),
        each(weight),
        torch.full((P,), QUANTITIES.index(quantity)),
        torch.full((P,), forced),
        torch.full((P,), priority),
        (symbol.to(at),),
        torch.zeros(P, dtype=torch.int64),
        torch.full((P,), nearest),
        (tuple(modules),) * P,
        torch.full((P,), shared),
    )


def concatenate(*parts: Primitives) -> Primitives:
    """The primitives of all parts in order, batch dimensions broadcast; an image in several parts is kept once.

    Raises LuxloopError for no parts.
    """
    if not parts:
        raise LuxloopError("there are no primitives to concatenate: give at least one")
    if len(parts) == 1:
        return parts[0]
    batch = np.broadcast_shapes(*(part.origin.shape[:-2] for part in parts))

    def joined(name: str, width: int) -> Tensor:
        tensors = [getattr(part, name) for part in parts]
        return torch.cat([t.expand(*batch, *t.shape[t.ndim - width :]) for t in tensors], -width)

    symbols: list[Tensor] = []
    symbol_of = []
    for part in parts:
        place = []
        for symbol in part.symbols:
            known = [k for k, other in enumerate(symbols) if other is symbol]
            symbols += [] if known else [symbol]
            place.append(known[0] if known else len(symbols) - 1)
        symbol_of.append(torch.tensor(place)[part.symbol_of])
    return Primitives(
        **{name: joined(name, 2) for name in _VECTORS},
        **{name: joined(name, 1) for name in ("value", "weight")},
        **{name: torch.cat([getattr(part, name) for part in parts]) for name in _ON_HOST},
        symbols=tuple(symbols),
        symbol_of=torch.cat(symbol_of),
        modules=tuple(names for part in parts for names in part.modules),
        observer=_observers(parts, batch),
    )


def _observers(parts: Sequence[Primitives], batch: tuple[int, ...]) -> Observer | None:
    if all(part.observer is None for part in parts):
        return None

    def of(name: str) -> Tensor:
        each = (torch.zeros_like(part.origin) if part.observer is None else getattr(part.observer, name) for part in parts)
        return torch.cat([vector.expand(*batch, len(part), 3) for vector, part in zip(each, parts, strict=True)], -2)

    active = [torch.zeros(len(part), dtype=torch.bool) if part.observer is None else part.observer.active for part in parts]
    return Observer(**{name: of(name) for name in _SEEN}, active=torch.cat(active))


def road_symbol(pose: Tensor, z_m: float, width_m: float, length_m: float, symbol: Tensor, value: float, quantity: Quantity) -> Primitives:
    """A symbol near the road in the thesis' four degrees of freedom (T 9.4.2), for the driver to read: image row 0 at its far end.

    pose: `[..., 4]` = x, y in m of the centre, roll, pitch in rad, `R = Ry(pitch) Rx(roll)`; z and size stay fixed, yaw is zero. symbol:
    `[h, w]` in 0..1. value, quantity: as for `rectangle`. Returns Primitives with P = 1; raises LuxloopError as `rectangle` does.
    """
    pose = pose[..., None, :]
    R = rotation(*pose[..., 2:].unbind(-1))
    centre = torch.cat([pose[..., :2], torch.full_like(pose[..., :1], z_m)], -1)
    forward, left, up = R.unbind(-1)
    d1, d2 = -width_m * left, -length_m * forward
    return rectangle(centre - (d1 + d2) / 2, d1, d2, value, quantity, normal=up, symbol=symbol)


def names_module(names: Sequence[str], module: str) -> bool:
    """Whether a module is among names; "left lores" matches its name, "left", "lores" and an empty list of names."""
    return not names or any(f" {each} " in f" {module} " for each in names)
