"""Fit of all modules of a lamp together to a pattern, within the limits of the pattern's rules."""

from collections.abc import Iterator, Mapping

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp, Module, direction
from luxloop.world.lamps.patterns import PATTERNS, Pattern
from luxloop.world.regulation import Requirement, check_beam, passes, rule_set
from luxloop.world.regulation.checking import samples_of
from luxloop.world.regulation.tables import Intensity, Traffic
from luxloop.world.spmv import Csr, multiply, solve
from luxloop.world.texels import bilinear

EVEN_CD = 500.0  # errors count relative to the light, but not below this
RIM = 0.1  # share of the greatest intensity; errors count less where the lamp gives less, at the rim of its field
RULE_STEP_DEG = 0.1
RESERVE = 0.04  # relative margin to limits that the fit aims at; it must keep half of it
WEIGHT_OF_LIMITS = 5.0  # weight of limits relative to the pattern, multiplied by itself in each round that misses a limit
ROUNDS = 4
BORDER = 0.1  # share of a module's rows and columns on either side over which it fades into other modules, or into the dark
GUESSES = 4
LEAST_PIXELS = 8


def fit(lamp: Lamp, pattern: Pattern, traffic: Traffic = "right") -> tuple[Tensor, ...]:
    """Utilisations `[n_p]`, one per module, with which the lamp comes closest to a pattern; modules that only draw are dark.

    The limits of the pattern's rules take precedence over its form if the lamp can meet those within its field
    (`luxloop.check_beam`). A module of one pixel that alone meets a rule of the low beam is fully on in every beam: others add what
    the pattern lacks, and are dark where they would break a rule that this module meets. traffic: on the left, the pattern and its rules
    are mirrored.
    """
    own = next((each for each in lamp.modules if each.headlight.n_pixels == 1 and _met(_full(each), PATTERNS["low"], traffic)), None)
    others = tuple(each for each in lamp.modules if each is not own and not each.draws_only)
    fitted = iter(LampFit(others, own).fit(pattern, traffic) if others else ())
    alone = tuple(torch.full((each.headlight.n_pixels,), float(each is own)) for each in lamp.modules)
    beam = tuple(u if each is own or each.draws_only else next(fitted) for each, u in zip(lamp.modules, alone, strict=True))
    return alone if own and not _met(_full(own), pattern, traffic) <= _met(lamp.lit(beam), pattern, traffic) else beam


def _full(module: Module) -> Intensity:
    return Lamp(module.name, (module,)).lit((torch.ones(module.headlight.n_pixels),))


def _met(intensity: Intensity, pattern: Pattern, traffic: Traffic) -> set[str]:
    """Those of a pattern's rules that a light meets."""
    return {rule for rule in pattern.rules if passes(check_beam(intensity, rule, traffic=traffic))}


class LampFit:
    """Light of a lamp's pixels, sampled in one direction or more per pixel over each module's field.

    own: a further module, which is fully on.
    """

    def __init__(self, modules: tuple[Module, ...], own: Module | None = None) -> None:
        self.modules = modules
        self.own = None if own is None else _full(own)
        self.directions = torch.cat([_directions(module) for module in modules], 1)
        self.matrix = self._light_at(self.directions)
        self.full = multiply(self.matrix, torch.ones(self.matrix.n_cols))

    def _lacking(self, wanted: Tensor, directions: Tensor) -> Tensor:
        """What is missing to an intensity `[N]` in cd beside the light of the module that is fully on."""
        return wanted if self.own is None else (wanted - self.own(directions).to(wanted)).clamp(min=0)

    def _light_at(self, directions: Tensor) -> Csr:
        """The matrix `[N, all pixels]` of the light in cd into directions `[3, N]` of the lamp frame."""
        return Csr.from_scipy(sp.hstack([_sampling(module, directions) for module in self.modules], format="csr"))

    def fit(self, pattern: Pattern, traffic: Traffic = "right") -> tuple[Tensor, ...]:
        mirror = -1.0 if traffic == "left" else 1.0
        target = self._lacking(pattern.intensity(*_angles(self.directions, mirror)).float(), self.directions)
        weight = self.full / (self.full + RIM * self.full.max()) / (target + EVEN_CD)
        upper, fading = self._borders(target)
        start = self._first_guess(target, upper)
        share = multiply(self.matrix, start * fading) / multiply(self.matrix, start).clamp(min=1e-6)
        target = target.minimum(EVEN_CD + (target - EVEN_CD) * share)
        u = solve(self.matrix, target, weight=weight, upper=upper, start=start * fading, iterations=60, tolerance=1e-4)
        u = self._within_limits(u, target, weight, pattern, mirror, upper)
        return u.split([module.headlight.n_pixels for module in self.modules])

    def _first_guess(self, target: Tensor, upper: Tensor) -> Tensor:
        """Start of the fit by Richardson and Lucy's iteration; smooth, as the solver keeps values that do not matter."""
        u, sums = upper, multiply(self.matrix.transpose, torch.ones(len(target)))
        for _ in range(GUESSES):
            missing = target / multiply(self.matrix, u).clamp(min=1e-6)
            u = torch.where(sums > 0, u * multiply(self.matrix.transpose, missing) / sums, 0.0).minimum(upper)
        return u

    def _borders(self, target: Tensor) -> tuple[Tensor, Tensor]:
        """Upper bounds of utilisations, and factors by which the pattern fades, both per pixel and 1 inside a module.

        A pixel fades towards its module's border as far as other modules can replace its light: otherwise a seam would show between the
        module's edge and the coarser light of others. Where they cannot, the pattern fades into the dark.
        """
        mean = self.matrix.transpose
        lit = multiply(mean, torch.ones(len(target))).clamp(min=1e-6)
        wanted = multiply(mean, target) / lit
        start, uppers, factors = 0, [], []
        for module in self.modules:
            light = module.headlight
            pixels = slice(start, start + light.n_pixels)
            own = torch.zeros(self.matrix.n_cols)
            own[pixels] = 1.0
            others = multiply(mean, self.full - multiply(self.matrix, own))[pixels] / lit[pixels]
            able, ramp = (others / wanted[pixels].clamp(min=1.0) - 1).clamp(0, 1), _ramp(light)
            uppers.append(1 - able * (1 - ramp))
            factors.append(1 - (1 - able) * (1 - ramp))
            start += light.n_pixels
        return torch.cat(uppers), torch.cat(factors)

    def _within_limits(
        self, pattern_alone: Tensor, target: Tensor, weight: Tensor, pattern: Pattern, mirror: float, upper: Tensor
    ) -> Tensor:
        """A fit within all limits that the lamp can reach, at last for these alone; else the plain fit: a lamp too coarse for all limits
        would distort its beam to meet a few.
        """
        points, low, high = _limits(pattern)
        points[0] *= mirror
        directions = direction(*points)
        low, high = self._lacking(low, directions), self._lacking(high, directions)
        limits = self._light_at(directions)
        within_reach = multiply(limits, torch.ones(limits.n_cols)) >= low

        def missed(u: Tensor) -> Tensor:
            light = multiply(limits, u)
            return within_reach & ((light < (1 - RESERVE / 2) * low) | (light > (1 + RESERVE / 2) * high))

        u, held = pattern_alone, torch.zeros_like(within_reach)
        scale = 1 / (torch.where(low > 0, low, high) + EVEN_CD)
        for round_ in range(ROUNDS):
            if not (lacking := missed(u)).any():
                return u
            held |= lacking
            rows = Csr.from_scipy(sp.vstack([self.matrix.to_scipy(), limits.to_scipy()[held.numpy()]], format="csr"))
            weights = torch.cat([weight, WEIGHT_OF_LIMITS ** (round_ + 1) * scale[held]])
            lows, highs = torch.cat([target, low[held]]), torch.cat([target, high[held]])
            u = solve(rows, (lows, highs), weight=weights, upper=upper, start=u, iterations=60, tolerance=1e-3)
        if missed(u).any():
            rows, lows, highs = Csr.from_scipy(limits.to_scipy()[within_reach.numpy()]), low[within_reach], high[within_reach]
            u = solve(rows, (lows, highs), weight=scale[within_reach], upper=upper, start=u, iterations=400, tolerance=1e-6)
        return pattern_alone if missed(u).any() else u


def _ramp(light: Headlight) -> Tensor:
    """From 0 at the border of a module to 1 inside, `[n_p]`; modules of a few pixels have no inside."""
    if min(light.pixel_rows, light.pixel_cols) < LEAST_PIXELS:
        return torch.ones(light.n_pixels)
    rows, cols = ((torch.arange(n) + 0.5).minimum(n - 0.5 - torch.arange(n)) / (BORDER * n) for n in (light.pixel_rows, light.pixel_cols))
    ramp = rows.clamp(max=1)[:, None] * cols.clamp(max=1)
    return (ramp * ramp * (3 - 2 * ramp)).flatten()


def _angles(directions: Tensor, mirror: float) -> tuple[Tensor, Tensor]:
    """h (right) and v (up) in deg."""
    x, y, z = directions
    return torch.rad2deg(torch.atan2(-y * mirror, x)), torch.rad2deg(torch.atan2(z, torch.hypot(x, y)))


def _directions(module: Module) -> Tensor:
    """Texel centres of a module, about one a pixel, as directions `[3, N]` of the lamp frame."""
    light = module.headlight
    y, z = light.tangents()
    rows, cols = _every(light.rows, light.pixel_rows), _every(light.cols, light.pixel_cols)
    z, y = torch.meshgrid(z[rows // 2 :: rows], y[cols // 2 :: cols], indexing="ij")
    local = torch.stack([torch.ones_like(y), y, z]).flatten(1)
    return module.T_lamp_module[:3, :3] @ local


def _every(texels: int, pixels: int) -> int:
    return max(min(texels // pixels, texels // 64), 1)


def _sampling(module: Module, directions: Tensor) -> sp.csr_matrix:
    """The part of one module in the light matrix."""
    light: Headlight = module.headlight
    x, y, z = module.T_lamp_module[:3, :3].T @ directions
    texel, weight = bilinear(light, *light.texel_of(y / x, z / x))
    weight = (weight * (x > 0)).ravel().numpy()
    kept = np.flatnonzero(weight > 1e-9)
    sample = np.tile(np.arange(len(x)), 4)
    bilinearly = sp.csr_matrix((weight[kept], (sample[kept], texel.ravel().numpy()[kept])), shape=(len(x), light.n_texels))
    return bilinearly @ light.matrix.to_scipy()


def _limits(pattern: Pattern) -> tuple[Tensor, Tensor, Tensor]:
    """Points `[2, N]` in deg with the least and the largest light in cd that the rules allow, a reserve kept.

    A limit of a sum is shared among its points. The least maximum of a driving beam is wanted at its hot spot. Limits that are relative,
    conditional, on flux or on the largest maximum are left out.
    """
    parts = []
    for rules in map(rule_set, pattern.rules):
        for requirement in rules.requirements:
            if requirement.of or requirement.only_if or requirement.kind == "flux":
                continue
            if requirement.kind == "imax":
                if rules.beam != "high":
                    continue
                points = torch.tensor([[pattern.hot_h_deg], [pattern.hot_v_deg]], dtype=torch.float64)
            else:
                points = samples_of(requirement, RULE_STEP_DEG)
            parts.append((points, *(torch.full((points.shape[1],), bound) for bound in _bounds(requirement))))
    if not parts:
        return torch.zeros(2, 0, dtype=torch.float64), torch.zeros(0), torch.zeros(0)
    points, low, high = (torch.cat(part, -1) for part in zip(*parts, strict=True))
    return points, low, high


def _bounds(requirement: Requirement) -> tuple[float, float]:
    share = len(requirement.where) if requirement.kind == "sum" else 1
    least = 0.0 if requirement.min is None else requirement.min / share * (1 + RESERVE)
    most = float("inf") if requirement.max is None else requirement.max * (1 - RESERVE)
    return least, most


class FittedBeams(Mapping[str, tuple[Tensor, ...]]):
    """The default beams of a lamp by name, each fitted on first use, since a fit takes seconds."""

    def __init__(self, lamp: Lamp, traffic: Traffic = "right") -> None:
        self._lamp, self._traffic = lamp, traffic
        self._fitted: dict[str, tuple[Tensor, ...]] = {}

    def for_traffic(self, traffic: Traffic) -> "FittedBeams":
        """The same lamp's default beams for traffic on this side."""
        return self if traffic == self._traffic else FittedBeams(self._lamp, traffic)

    def __getitem__(self, name: str) -> tuple[Tensor, ...]:
        if name not in self._fitted:
            self._fitted[name] = fit(self._lamp, PATTERNS[name], self._traffic)
        return self._fitted[name]

    def __contains__(self, name: object) -> bool:
        return name in PATTERNS

    def __iter__(self) -> Iterator[str]:
        return iter(PATTERNS)

    def __len__(self) -> int:
        return len(PATTERNS)
