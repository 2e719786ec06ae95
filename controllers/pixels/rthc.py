"""Ray tracing headlight control (RTHC, T 7.3): from primitives to a setpoint for every ray of a light texture.

Primitives are painted in order, each over the rays for which it hides the earlier primitives. On the CPU, comparisons and selections cost
ten times as much as sums, so hits are images of zeros and ones, and painting is blending.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop.controllers.pixels.homographies import Homographies, homographies
from luxloop.controllers.pixels.primitives import E_V, HEAVIEST, U_ABS, U_REL, Primitives
from luxloop.controllers.pixels.secondary import SecondaryRays
from luxloop.controllers.pixels.windows import SLACK, union, whole
from luxloop.world.caches import keeping
from luxloop.world.errors import LuxloopError
from luxloop.world.texels import NOWHERE, TexelGrid, Window

PARALLEL = 1e-6  # tolerance of the cosine between a given normal and that of the edges
GRAZING = 1e-12  # least d.n for sampling a symbol, m^2: every hit has more, and samples of other rays stay finite
OPAQUE = 0.5  # least opacity that stops a ray


@dataclass(frozen=True)
class Setpoints:
    """Ray setpoints on a window of the light texture; all images are `[..., rows, cols]`, binary ones in the dtype of value.

    value: in cd (I_v, E_v) or as a share (u_abs, u_rel), 0 without a hit. cover: 1 where a primitive is hit; elsewhere the default counts
    with weight 1. quantities: codes that may occur. finite: finite weights, 0 where infinite; None if all are 1. forced: 1 where the weight
    is infinite, None if nowhere. masking: whether all setpoints of infinite weight are known to be zero. in_cd, relative: 1 where the value
    is an intensity or a share of the default; None if all rays have the same quantity.
    """

    value: Tensor
    cover: Tensor
    window: Window
    quantities: tuple[int, ...]
    finite: Tensor | None = None
    forced: Tensor | None = None
    masking: bool = False
    in_cd: Tensor | None = None
    relative: Tensor | None = None

    def portion(self, image: Tensor | None, *codes: int) -> Tensor | float:
        """1 where the setpoint has one of the quantities, by image `in_cd` or `relative`; a number if all rays have one quantity."""
        return float(self.quantities[0] in codes) if image is None else image

    @property
    def shares(self) -> Tensor:
        """Setpoints of u_rel; 0 for rays of other quantities."""
        return self.value * self.portion(self.relative, U_REL)

    @property
    def hit(self) -> Tensor:
        """Rays that hit a primitive, `[..., rows, cols]` bool."""
        return self.cover > 0

    @property
    def weight(self) -> Tensor | None:
        """Weights from 0 to infinity, 1 without a hit; None where all are 1."""
        return self.finite if self.forced is None or self.finite is None else self.finite.masked_fill(self.forced > 0, torch.inf)

    @property
    def quantity(self) -> Tensor | None:
        """Codes `[..., rows, cols]`, I_v for all setpoints in cd; None if all rays have the same quantity."""
        if self.in_cd is None and self.relative is None:
            return None
        absolute = torch.full_like(self.value, U_ABS)
        absolute = absolute if self.in_cd is None else absolute - U_ABS * self.in_cd
        return absolute if self.relative is None else absolute + (U_REL - U_ABS) * self.relative


def paint_classes(primitives: Primitives) -> list[list[int]]:
    """Indices of primitives in painting order, in classes; each class overrides the earlier classes at any distance.

    Forced primitives come last, by priority. Within a class the nearest primitive is visible; coplanar ones are ordered by priority, then
    by index.
    """
    keys = [(forced, priority) for forced, priority in zip(primitives.forced.tolist(), primitives.priority.tolist(), strict=True)]
    order = sorted(range(len(keys)), key=keys.__getitem__)
    return [list(of_class) for _, of_class in groupby(order, key=lambda p: keys[p] if keys[p][0] else None)]


def masks(primitives: Primitives) -> list[bool]:
    """Which primitives of a single scene are masks: setpoint zero with infinite weight."""
    return [value == 0 and weight == math.inf for value, weight in zip(primitives.value.tolist(), primitives.weight.tolist(), strict=True)]


def trace(
    primitives: Primitives,
    grid: TexelGrid,
    T_world_headlight: Tensor,
    windows: Sequence[Window] | None = None,
    secondary: SecondaryRays | None = None,
) -> Setpoints:
    """Cast a ray through every texel's centre and take the setpoint of the primitive that it hits (T 7.3.3, eq. 3.1.1).

    primitives: batch `[..., P]`. T_world_headlight: `[4, 4]`. windows: for a single scene on the host, the texels that each primitive can
    touch, by default all; the setpoints lie on their union. Back faces are not hit. E_v becomes `E d^2 / cos` (T eq. 7.2.1). A mask, which
    has a zero setpoint of infinite weight, is hit by all rays within one texel of its outline, since light is interpolated between texels.
    A symbol with an observer is sampled where the observer sees the hit (T 7.2.2). secondary: secondary rays, by default none.
    Differentiable in the primitives (not across their edges). Raises LuxloopError for values on the host that are not finite.
    """
    return RayBatch.prepare(primitives, grid, T_world_headlight, windows, secondary).setpoints()


@dataclass(frozen=True)
class Stroke:
    """One primitive over its window. hit: `[..., rows, cols]`, 1 for rays that end on the primitive, else 0. value: setpoint of these rays,
    finite elsewhere, broadcastable. finite: its weight `[..., 1, 1]`, 0 if infinite. forced: `[..., 1, 1]`, 1 if the weight is infinite,
    else 0.
    """

    window: Window
    hit: Tensor
    value: Tensor
    finite: Tensor
    forced: Tensor
    quantity: int
    primitive: int


@dataclass(frozen=True)
class _Product:
    """Dot products of rays [1, y, z] with vectors of primitives, as a term of the row plus a term of the column."""

    rows: tuple[Tensor, ...]
    cols: tuple[Tensor, ...]

    def on(self, p: int, w: Window) -> Tensor:
        """Products with the p-th primitive's vectors on a window: `[..., rows, cols]`, for pairs of vectors `[..., 2, rows, cols]`."""
        rows = self.rows[p].narrow(-1, w.v_start, w.v_stop - w.v_start)
        return rows.unsqueeze(-1) + self.cols[p].narrow(-1, w.u_start, w.u_stop - w.u_start).unsqueeze(-2)


@dataclass(frozen=True)
class RayBatch:
    """Rays to cast. windows: of each primitive, empty for invisible ones. window: union of the windows.

    is_mask, front: for each primitive, whether it is a mask and whether the lamp sees its front, None if unknown on the host. unit, finite:
    whether all finite weights are 1, and whether no weight is infinite; false if unknown on the host.
    """

    primitives: Primitives
    grid: TexelGrid
    T_world_headlight: Tensor
    secondary: SecondaryRays | None
    seen: Homographies
    windows: tuple[Window, ...]
    window: Window
    is_mask: tuple[bool | None, ...]
    front: tuple[bool | None, ...]
    unit: bool
    finite: bool

    @classmethod
    def prepare(
        cls,
        primitives: Primitives,
        grid: TexelGrid,
        T_world_headlight: Tensor,
        windows: Sequence[Window] | None = None,
        secondary: SecondaryRays | None = None,
    ) -> "RayBatch":
        """Compute homographies and windows; arguments and errors as for `trace`."""
        known = primitives.value.device.type == "cpu"
        if known and not math.isfinite(primitives.value.sum().item()):
            raise LuxloopError("a primitive's value is infinite or not a number; give a finite one in cd or lx, or as a share")
        seen = homographies(primitives, grid, T_world_headlight)
        nobody: list[bool | None] = [None] * len(primitives)
        front, is_mask = (nobody, nobody) if windows is None else (_front_faces(seen), [*masks(primitives)])
        windows = [whole(grid)] * len(primitives) if windows is None else windows
        windows = [NOWHERE if seen_from is False else window for window, seen_from in zip(windows, front, strict=True)]
        weights = set(primitives.weight.flatten().tolist()) if known else {math.nan}
        unit, finite = weights <= {1.0, math.inf}, known and math.inf not in weights
        of_each = (tuple(windows), union(windows), tuple(is_mask), tuple(front))
        return cls(primitives, grid, T_world_headlight, secondary, seen, *of_each, unit, finite)

    @property
    def quantities(self) -> tuple[int, ...]:
        """Codes of the quantities of all primitives, at least one."""
        return tuple(sorted(set(self.primitives.quantity.tolist()))) or (U_ABS,)

    @property
    def shares(self) -> Tensor:
        """Setpoints of u_rel `[..., n]` at symbol value 1."""
        return self.primitives.value[..., self.primitives.quantity == U_REL]

    @property
    def masking(self) -> bool:
        """Whether all setpoints of infinite weight are known to be zero."""
        infinite = (self.primitives.weight == torch.inf).tolist() if None not in self.is_mask else []
        return all(mask for mask, weighty in zip(self.is_mask, infinite, strict=False) if weighty) and None not in self.is_mask

    def blank(self, filled: float = 0.0) -> Tensor:
        """A constant image on the window, `[..., rows, cols]`."""
        w, origin = self.window, self.primitives.origin
        return origin.new_full((*origin.shape[:-2], max(w.v_stop - w.v_start, 0), max(w.u_stop - w.u_start, 0)), filled)

    def strokes(self) -> Iterator[Stroke]:
        """The strokes of all visible primitives, in painting order."""
        weight, windows = self.primitives.weight[..., None, None], self.windows  # [..., P, 1, 1]
        finite, forced = weight, torch.zeros_like(weight)
        if not (self.unit and self.finite):
            infinite = weight.isinf()
            finite, forced = torch.where(infinite, 0.0, weight.clamp(max=HEAVIEST)), infinite.to(weight)
        nearest: Tensor | None = None  # 1/x of a class's nearest hits, rounded down, [..., rows, cols]
        for painted in paint_classes(self.primitives):
            rivals = {p: any(windows[p].meets(windows[k]) for k in painted if k != p) for p in painted}
            if any(rivals.values()):
                if nearest is None:
                    nearest = self.blank()
                else:
                    for p in painted:
                        nearest[(..., *windows[p].within(self.window))].zero_()
            for p in painted:
                window = windows[p]
                if window.empty:
                    continue
                hit, read = self._hit(p, window), self._read(p, window)
                if not self.is_mask[p] and len(read) == 2:
                    hit = hit * torch.maximum(_step(read[1].detach() - OPAQUE), self.seen.mask[..., p, None, None].to(hit))
                if rivals[p] and nearest is not None:
                    hit = self._visible_part(p, window, hit, nearest[(..., *window.within(self.window))])
                value = self._setpoint(p, window, hit, read[0])
                if self.secondary is not None and not self.is_mask[p] and self.secondary.ask(self.primitives, p):
                    value = self.secondary.adjust(expand(value, hit), self._points(p, window), hit > 0, self.primitives, p)
                yield Stroke(window, hit, value, finite[..., p, :, :], forced[..., p, :, :], int(self.primitives.quantity[p]), p)

    def setpoints(self) -> Setpoints:
        """The setpoints after all strokes."""
        codes = self.quantities

        def image(needed: bool, filled: float = 0.0) -> Tensor | None:
            return self.blank(filled) if needed else None

        value, cover = self.blank(), self.blank()
        finite, forced = image(not (self.unit and self.finite), 1.0), image(not self.finite)
        in_cd, relative = image(min(codes) < U_ABS <= max(codes)), image(U_REL in codes and len(codes) > 1)
        for stroke in self.strokes():
            cut = (..., *stroke.window.within(self.window))
            for canvas, new in (
                (value, stroke.value),
                (cover, 1.0),
                (finite, stroke.finite),
                (forced, stroke.forced),
                (in_cd, float(stroke.quantity < U_ABS)),
                (relative, float(stroke.quantity == U_REL)),
            ):
                if canvas is not None:
                    canvas[cut].lerp_(expand(new, stroke.hit), stroke.hit)  # the new value where the stroke wins, [..., rows, cols]
        return Setpoints(value, cover, self.window, codes, finite, forced, self.masking, in_cd, relative)

    @cached_property
    def _tangents(self) -> tuple[Tensor, Tensor]:
        """y `[cols]` and z `[rows]` of all rays [1, y, z]."""
        return self.grid.tangents(self.primitives.weight.dtype, self.primitives.weight.device)

    @cached_property
    def _n(self) -> _Product:
        return self._times(self.seen.n)

    @cached_property
    def _uv(self) -> _Product:
        """uv; for masks, whose images are not sampled, shifted by `aside`."""
        return self._times(self.seen.uv, self.seen.margin[0] if any(mask is not False for mask in self.is_mask) else None)

    @cached_property
    def _at(self) -> Callable[[int, Window], tuple[Tensor, Tensor]]:
        """n `[..., rows, cols]` and uv `[..., 2, rows, cols]` of a primitive on a window; cached for the last primitive."""
        return keeping(1, self._on)

    def _on(self, p: int, window: Window) -> tuple[Tensor, Tensor]:
        return self._n.on(p, window), self._uv.on(p, window)

    @cached_property
    def _sight(self) -> tuple[_Product, _Product] | None:
        """n and uv of the flying symbols of observers."""
        return None if self.seen.sight is None else (self._times(self.seen.sight[0]), self._times(self.seen.sight[1]))

    @cached_property
    def _facing(self) -> _Product:
        return self._times(-self.seen.normal)

    @cached_property
    def _closeness(self) -> _Product:
        """1/x of the hit: d.n / q.n (T eq. 7.3.3)."""
        return self._times(self.seen.n / self.seen.qn[..., None])

    def _times(self, a: Tensor, aside: Tensor | None = None) -> _Product:
        y, z = self._tangents
        constant = a[..., 0] if aside is None else a[..., 0] - aside
        rows, cols = constant[..., None] + a[..., 2:] * z, a[..., 1:2] * y  # a_0 + a_2 z [..., rows], a_1 y [..., cols]
        of_primitives = self.seen.n.ndim - 2
        return _Product(rows.unbind(of_primitives), cols.unbind(of_primitives))

    def _hit(self, p: int, window: Window) -> Tensor:
        """1 where a ray hits the p-th primitive, `[..., rows, cols]` (T eq. 7.3.3)."""
        seen, mask = self.seen, self.is_mask[p]
        n, uv = self._at(p, window)
        if mask is False:
            hit = _inside(n, uv)
            return hit if self.front[p] else hit * _step(self._facing.on(p, window).detach())
        hit = _inside(n, uv, seen.margin[1][..., p, :])
        if mask:
            return hit  # the window limits how far it reaches beyond its outline
        wide = seen.mask[..., p, None, None]
        hit *= _step(torch.where(wide, seen.toward[..., p, None, None], self._facing.on(p, window).detach()))
        low, high = seen.outline
        return hit * torch.where(wide, _near_outline(window, low[..., p, :], high[..., p, :]), 1.0)

    def _visible_part(self, p: int, window: Window, hit: Tensor, nearest: Tensor) -> Tensor:
        """The part of a hit that no nearer primitive of the class hides. nearest: lower bound of the class's 1/x, updated in place."""
        closeness = self._closeness.on(p, window).detach()  # 1/x, [..., rows, cols]
        if self.is_mask[p] is not False:  # a mask's hit beyond its outline is limited to the distances of its corners
            closeness = self._between_corners(p, closeness)
        rounding = self.seen.rounding[..., p, None, None]
        hit = hit * _step(closeness * (1 + rounding) - nearest)  # 1/x >= the nearest so far, within rounding
        torch.maximum(nearest, closeness.mul_(hit * (1 - rounding)), out=nearest)
        return hit

    def _between_corners(self, p: int, closeness: Tensor) -> Tensor:
        far, near = self.seen.range
        return closeness.maximum(far[..., p, None, None]).minimum(near[..., p, None, None])

    def _points(self, p: int, window: Window) -> Tensor:
        """Points `[..., 3, rows, cols]` m in the world where rays hit the p-th primitive (T eq. 3.1.1); misses end at its corners'
        distances.
        """
        x, (y, z) = 1 / self._between_corners(p, self._closeness.on(p, window)), self._tangents
        rows, cols = window.slices
        forward, left, up, position = self.T_world_headlight[:3, :, None, None].to(x).unbind(1)
        ray = (forward + up * z[rows, None]) + left * y[cols]  # R [1, y, z], [3, rows, cols]
        return position + x[..., None, :, :] * ray  # p = o + x d (T eq. 3.1.1), [..., 3, rows, cols]

    def _setpoint(self, p: int, window: Window, hit: Tensor, read: Tensor) -> Tensor:
        """Setpoint of the p-th primitive for rays that hit the primitive, elsewhere arbitrary but finite; broadcastable to `[..., rows,
        cols]`.

        read: samples of the symbol, from `_read`. An illuminance becomes the intensity `E d^2 / cos` (T eq. 7.2.1); the hit lies x = qn /
        d.n ahead, at the distance x |ray|.
        """
        value = self.primitives.value[..., p, None, None]
        if self.primitives.has_observer(p) and self._sight is not None:
            value = value * _inside(*(product.on(p, window) for product in self._sight))
        value = value * read
        if int(self.primitives.quantity[p]) != E_V:
            return value
        # d.n and -d.normal, 1 beside hits, [..., rows, cols] each.
        across, facing = (hit.new_ones(()).lerp(product.on(p, window), hit) for product in (self._n, self._facing))
        (rows, cols), (y, z) = window.slices, self._tangents
        d2 = (1 + z[rows, None] ** 2) + y[cols] ** 2  # |ray|^2 [rows, cols]
        return (
            value * self.seen.qn[..., p, None, None] ** 2 * (d2 * d2.sqrt()) / (across * across * facing)
        )  # E (qn / d.n)^2 |ray|^3 / facing

    def _read(self, p: int, window: Window) -> tuple[Tensor, ...]:
        """Samples `[..., rows, cols]` of the p-th primitive's symbol, and of the opacity if the symbol has one, on the primitive or on the
        observer's flying symbol.

        For a homogeneous symbol without opacity: the one pixel `[1, 1]`.
        """
        image, watching = self.primitives.image_of(p), self._sight if self.primitives.has_observer(p) else None
        if image.numel() == 1 and not self.primitives.has_observer(p):
            return (image,)
        n, uv = self._at(p, window) if watching is None else (product.on(p, window) for product in watching)
        at = uv / n.clamp(min=GRAZING).unsqueeze(-3)  # 2 u, 2 v of T eq. 7.3.3, [..., 2, rows, cols]
        return _sample(image.reshape(-1, *image.shape[-2:]), at, bool(self.primitives.nearest[p])).unbind(-3)


def expand(new: Tensor | float, hit: Tensor) -> Tensor:
    """An image or a number, expanded to the shape of a hit."""
    return (new if isinstance(new, Tensor) else hit.new_full((), new)).expand_as(hit)


def _front_faces(seen: Homographies) -> list[bool | None]:
    """Whether the lamp sees the front of each primitive of a single scene; None if the side differs by ray, as it may for normals that are
    not perpendicular to the edges. For masks the centre decides.
    """
    cosine = (seen.normal * seen.n).sum(-1).abs() / seen.n.norm(dim=-1)  # [..., P]
    decided = seen.mask | (cosine > 1 - PARALLEL)
    return [front if known else None for front, known in zip((seen.toward > 0).tolist(), decided.tolist(), strict=True)]


def _step(a: Tensor) -> Tensor:
    """1 where a >= 0, else 0; in place."""
    return a.ge_(0)


def _inside(n: Tensor, uv: Tensor, wider: Tensor | None = None) -> Tensor:
    """1 where a ray passes a rectangle, by n `[..., rows, cols]` and uv `[..., 2, rows, cols]`; wider: `[..., 2]`."""
    uv = uv.detach().abs()
    uv = uv if wider is None else uv.sub_(wider[..., None, None])
    return _step(n.detach() - torch.maximum(*uv.unbind(-3)))  # |2 u d.n| <= d.n and |2 v d.n| <= d.n (T eq. 7.3.3)


def _near_outline(window: Window, low: Tensor, high: Tensor) -> Tensor:
    """1 for texels at most one beyond the rectangle around an outline; at acute corners, widening alone would reach farther."""
    within = []
    for axis, (start, stop) in enumerate(((window.v_start, window.v_stop), (window.u_start, window.u_stop))):
        centre = torch.arange(start, stop, dtype=low.dtype, device=low.device) + 0.5
        within.append((centre >= low[..., axis, None] - 1 - SLACK) & (centre <= high[..., axis, None] + 1 + SLACK))
    return (within[0][..., :, None] & within[1][..., None, :]).to(low)


def _sample(images: Tensor, uv: Tensor, nearest: bool) -> Tensor:
    """Images `[c, h, w]` at coordinates -1..1 `[..., 2, rows, cols]`, bilinear or nearest, texel centres at (2 k + 1) / n - 1:
    `[..., c, rows, cols]`.
    """
    if not uv.numel():
        return uv[..., : len(images), :, :]  # an empty window
    at = uv.reshape(-1, *uv.shape[-3:]).movedim(1, -1)  # [B, rows, cols, 2]
    each = images.expand(len(at), *images.shape)
    sampled = grid_sample(each, at, "nearest" if nearest else "bilinear", padding_mode="border", align_corners=False)
    return sampled.reshape(*uv.shape[:-3], *sampled.shape[1:])
