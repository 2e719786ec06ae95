"""BRDF of a diffuse base, retroreflective glass beads and a glossy interface on top; it conserves energy."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.frames import unit

NODES = 128  # of the tables over the angle, even in the root of its cosine, since grazing angles change fastest
MARGIN = 1e-3  # by which the tables overstate reflection: more than the error of quadrature and interpolation

# of a material's numbers; the others are shares
RANGES = {"roughness": (0.02, 1), "retro_width_deg": (0.01, 90), "trapped": (0, 0.99), "luminance_cd_m2": (0, 1e7)}


@dataclass(frozen=True)
class Material:
    """Material of a surface, besides its albedo. The default is Lambertian.

    interface: share of it 0..1 that is covered by a glossy interface. f0: the interface's reflectance at normal incidence. roughness: alpha
    of its GGX microfacets, 0.02..1. retro: share 0..1 of the transmitted light that is reflected back to its source. retro_width_deg: angle
    at which that lobe has fallen to a quarter, 0.01..90. trapped: share 0..0.99 of the light scattered below the interface that it reflects
    down again; the albedo is then that without interface (a film of water). luminance_cd_m2: its own luminance, the same in all directions,
    up to 1e7. Raises LuxloopError beyond these ranges.
    """

    interface: float = 0.0
    f0: float = 0.04
    roughness: float = 0.5
    retro: float = 0.0
    retro_width_deg: float = 1.0
    trapped: float = 0.0
    luminance_cd_m2: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            low, high = RANGES.get(name, (0, 1))
            if not low <= value <= high:  # NaN neither
                raise LuxloopError(f"material: {name} = {value:g} is out of its range, {low:g} to {high:g}")

    @property
    def lambertian(self) -> bool:
        return self.interface == 0 and self.retro == 0

    @property
    def retro_t(self) -> float:
        """`1 - cos` of the lobe's width."""
        return 2 * math.sin(math.radians(self.retro_width_deg) / 2) ** 2

    def darken(self, albedo: Tensor) -> Tensor:
        """Albedo with internal reflection: the interface reflects a share of the scattered light down again (Lekner & Dorf 1988)."""
        below = albedo * (1 - self.trapped) / (1 - self.trapped * albedo)
        return torch.lerp(albedo, below, self.interface)


LAMBERTIAN = Material()


def luminance_factor(material: Material, albedo: Tensor, normal: Tensor, to_lamp: Tensor, to_eye: Tensor, lobes: bool = True) -> Tensor:
    """Luminance `[M]` as a multiple of that of a perfect white diffuser in the same light (`pi f`), for M points.

    albedo: `[M]`. normal, to_lamp, to_eye: unit vectors `[3, M]`. lobes: whether to add interface and beads to the ground.

    The interface is GGX with height-correlated Smith shadowing and Schlick's Fresnel term (Walter et al. 2007, Heitz 2014). The lobe sent
    back is `retro / (2 pi t0) / (1 + t / t0)^2 / max(cos_l, cos_v)` with `t = 1 - l.v`: it holds at most `retro` of the light, from any
    direction. Each part gets what those above it let through, on the way in and out; the ground is divided by the mean of that, so that all
    parts and a ground of albedo 1 add up to all light (Kelemen & Szirmay-Kalos 2001). Nothing changes if lamp and eye change places.
    """
    cos_l, cos_v = _cos(normal, to_lamp), _cos(normal, to_eye)
    through, left, mean_left = _tables(material)
    through, left = through.to(albedo), left.to(albedo)
    ground = albedo * _look_up(left, cos_l) * _look_up(left, cos_v) / mean_left
    if not lobes:
        return ground
    if material.retro > 0:
        t = (to_lamp - to_eye).square().sum(0) / 2
        lobe = material.retro / (2 * material.retro_t) / (1 + t / material.retro_t).square() / torch.maximum(cos_l, cos_v)
        ground = ground + lobe * _look_up(through, cos_l) * _look_up(through, cos_v)
    return ground + math.pi * _glossy(material, normal, to_lamp, to_eye, cos_l, cos_v) if material.interface > 0 else ground


def _cos(normal: Tensor, direction: Tensor) -> Tensor:
    """Cosine of normal and direction, at least grazing, as interpolated normals may turn away from an eye that sees the face."""
    return (normal * direction).sum(0).clamp(1e-4, 1)


def _glossy(material: Material, normal: Tensor, to_lamp: Tensor, to_eye: Tensor, cos_l: Tensor, cos_v: Tensor) -> Tensor:
    half = unit(to_lamp + to_eye)
    a2 = material.roughness**2
    # 1 - cos^2 would cancel in float32 where the peak is
    sin2 = torch.linalg.cross(normal, half, dim=0).square().sum(0)
    facets = a2 / (math.pi * (sin2 + a2 * (1 - sin2)).square())
    shadowed = 0.5 / (cos_l * (a2 + (1 - a2) * cos_v**2).sqrt() + cos_v * (a2 + (1 - a2) * cos_l**2).sqrt())
    return material.interface * facets * shadowed * _fresnel(material, (to_lamp * half).sum(0))


def _fresnel(material: Material, cos: Tensor) -> Tensor:
    return material.f0 + (1 - material.f0) * (1 - cos.clamp(0, 1)) ** 5


def _look_up(table: Tensor, cos: Tensor) -> Tensor:
    place = cos.sqrt() * (NODES - 1)
    below = place.floor().clamp(max=NODES - 2)
    i = below.long()
    return torch.lerp(table[i], table[i + 1], place - below)


@lru_cache(maxsize=64)
def _tables(material: Material) -> tuple[Tensor, Tensor, float]:
    """Transmittance of the interface and of interface with beads, `[NODES]` float64 over the angle, and the mean of the latter."""
    cos = torch.linspace(0, 1, NODES, dtype=torch.float64).square()
    glossy = _reflected_by_interface(material, cos)
    through = 1 - glossy
    left = (through - _sent_back(material, cos, through) - MARGIN).clamp(min=0)
    # the mean over the hemisphere, 2 int left cos d(cos), of the table as it is looked up
    fine = (torch.arange(4096, dtype=torch.float64) + 0.5) / 4096
    mean = (_look_up(left, fine) * 2 * fine).mean()
    return through, left, max(float(mean), 1e-12)


def _eyes(cos: Tensor) -> tuple[Tensor, Tensor]:
    """Sines and cosines `[NODES, 1, 1]` of the angles that the tables are over."""
    return (1 - cos**2).clamp(min=0).sqrt()[:, None, None], cos.clamp(min=1e-6)[:, None, None]


def _nodes() -> tuple[Tensor, Tensor, Tensor]:
    """Nodes `[64, 1]` of 0..1 with their weights (Gauss), and angles `[64]` of half a turn, in each of which lies the same weight."""
    u, weight = np.polynomial.legendre.leggauss(64)
    angle = (torch.arange(64, dtype=torch.float64) + 0.5) / 64 * math.pi
    return torch.from_numpy(u + 1)[:, None] / 2, torch.from_numpy(weight)[:, None] / 2 / 64, angle


def _reflected_by_interface(material: Material, cos: Tensor) -> Tensor:
    """Share `[NODES]` that the interface reflects: an integral over the microfacets that an eye sees, spread evenly on a spherical cap.

    After Dupuy & Benyoub 2023. The eye lies in the plane y = 0.
    """
    if material.interface == 0:
        return torch.zeros_like(cos)
    a, (sin_v, cos_v), (u, weight, angle) = material.roughness, _eyes(cos), _nodes()
    length = ((a * sin_v) ** 2 + cos_v**2).sqrt()
    cap_z = (1 - u) * (1 + cos_v / length) - cos_v / length
    cap = (1 - cap_z**2).clamp(min=0).sqrt()
    x, y, z = a * (cap * angle.cos() + a * sin_v / length), a * cap * angle.sin(), cap_z + cos_v / length
    norm = (x**2 + y**2 + z**2).sqrt()
    cos_h = (sin_v * x + cos_v * z) / norm
    cos_l = 2 * cos_h * z / norm - cos_v
    shadow_v, shadow_l = ((1 + a**2 * (1 / c.clamp(min=1e-9) ** 2 - 1)).clamp(min=0).sqrt() for c in (cos_v, cos_l))
    seen = (cos_l > 0) * (1 + shadow_v) / (shadow_v + shadow_l)
    return material.interface * (_fresnel(material, cos_h) * seen * weight).sum((1, 2))


def _sent_back(material: Material, cos: Tensor, through: Tensor) -> Tensor:
    """Share `[NODES]` that the beads send back through the interface, an integral over the lobe around the eye."""
    if material.retro == 0:
        return torch.zeros_like(cos)
    (sin_v, cos_v), (u, weight, angle), t0 = _eyes(cos), _nodes(), material.retro_t
    part = u * 2 / (2 + t0)
    t = t0 * part / (1 - part)
    cos_l = (1 - t) * cos_v + (t * (2 - t)).clamp(min=0).sqrt() * sin_v * angle.cos()
    arrived = cos_l.clamp(min=0) / torch.maximum(cos_l, cos_v) * _look_up(through, cos_l.clamp(0, 1))
    return through * material.retro * 2 / (2 + t0) * (arrived * weight).sum((1, 2))
