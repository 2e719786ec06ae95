"""Reflection: energy, reciprocity, and the figures by which retroreflectors are sold."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn.functional import normalize

from luxloop.world.materials.brdf import Material, luminance_factor
from luxloop.world.materials.library import MATERIALS, WET
from tests.refusal import refusal

share = st.sampled_from([0.0, 1.0]) | st.floats(0, 1)
materials = st.builds(Material, share, share, st.floats(0.02, 1), share, st.floats(0.2, 10))
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def beta(material: Material, albedo: float, to_lamp: Tensor, to_eye: Tensor) -> Tensor:
    """Luminance factor `[M]` of a surface that faces up."""
    normal = UP.to(to_lamp)[:, None].expand_as(to_lamp)
    return luminance_factor(material, torch.full_like(to_lamp[0], albedo), normal, to_lamp, to_eye)


def on_sphere(z: Tensor, angle: Tensor) -> Tensor:
    s = (1 - z**2).clamp(min=0).sqrt()
    return torch.stack([s * angle.cos(), s * angle.sin(), z])


def reflectance(material: Material, albedo: float, cos_v: float, n: int = 128) -> float:
    """Share of light from all over the hemisphere that goes to the eye, equal to that from the eye's direction that goes anywhere.

    By three families of rays, over the cosine, the facets and the lobe back, combined by the balance heuristic; it shares no code with the
    tables of world/materials/brdf.py and integrates facets in another way.
    """
    nodes, weights = np.polynomial.legendre.leggauss(n)
    u, weight = ((torch.from_numpy(x)[:, None] / 2).expand(n, n).flatten() for x in (nodes + 1, weights / n))
    angle = (math.pi * (torch.arange(n, dtype=torch.float64) + 0.5) / n).expand(n, n).flatten()
    a2, t0 = material.roughness**2, material.retro_t
    v = torch.tensor([math.sqrt(1 - cos_v**2), 0.0, cos_v], dtype=torch.float64)
    around_v = torch.tensor([[cos_v, 0.0, v[0]], [0.0, 1.0, 0.0], [-v[0], 0.0, cos_v]], dtype=torch.float64)
    families = [(on_sphere(u.sqrt(), angle), lambda rays: rays[2] / math.pi)]
    if material.interface:
        h = on_sphere(((1 - u) / (1 + (a2 - 1) * u)).sqrt(), angle)

        def facets(rays: Tensor) -> Tensor:
            half = normalize(rays + v[:, None], dim=0)
            return a2 / (math.pi * (1 + (a2 - 1) * half[2] ** 2) ** 2) * half[2] / (4 * (v @ half))

        families.append((2 * (v @ h) * h - v[:, None], facets))
    if material.retro:
        part = 2 * u / (2 + t0)
        lobe = around_v @ on_sphere(1 - t0 * part / (1 - part), angle)
        families.append((lobe, lambda rays: (2 + t0) / (4 * math.pi * t0) / (1 + (1 - v @ rays) / t0) ** 2))
    total = 0.0
    for rays, _ in families:
        up = rays[2] > 1e-9
        rays = rays[:, up]
        density = sum(density(rays) for _, density in families)
        total += (beta(material, albedo, rays, v[:, None].expand_as(rays)) / math.pi * rays[2] / density * weight[up]).sum().item()
    return total


@settings(max_examples=8)
@given(materials, share, st.lists(st.floats(0.002, 1), min_size=3, max_size=3))
def test_white_furnace_no_surface_reflects_more_than_it_gets(material, albedo, cos_v):
    # The quadrature is good to 1e-4 or so, where the tables keep 1e-3 below.
    assert max(reflectance(material, albedo, cos) for cos in (*cos_v, 1.0)) <= 1 + 2e-4


@pytest.mark.parametrize("material", [*MATERIALS.values(), Material(1, 0.5, 0.3, 0.5, 2.0)], ids=[*MATERIALS, "all at once"])
@pytest.mark.parametrize("cos_v", [0.02, 0.1, 0.5, 1.0])
def test_white_furnace_a_white_ground_returns_all_that_it_gets(material, cos_v):
    assert reflectance(material, 1.0, cos_v) == pytest.approx(1.0, abs=3e-3)
    assert reflectance(material, 0.0, cos_v) < 0.95


directions = st.tuples(st.floats(0.01, 1), st.floats(0, 2 * math.pi))


@settings(max_examples=10)
@given(materials, share, directions, directions)
def test_lamp_and_eye_may_change_places(material, albedo, lamp, eye):
    to_lamp, to_eye = (on_sphere(*(torch.tensor([x], dtype=torch.float64) for x in place)) for place in (lamp, eye))
    there, back = beta(material, albedo, to_lamp, to_eye), beta(material, albedo, to_eye, to_lamp)
    torch.testing.assert_close(there, back, rtol=1e-9, atol=1e-12)


def to_the_side(angle_deg: float) -> Tensor:
    angle = math.radians(angle_deg)
    return torch.tensor([[math.sin(angle)], [0.0], [math.cos(angle)]], dtype=torch.float64)


@pytest.mark.parametrize("observation_deg, least, most", [(0.2, 70, 75), (0.33, 50, 66), (2.0, 5, 6)])
def test_a_sign_sheet_has_the_coefficient_of_its_class(observation_deg, least, most):
    """R_A = L cos_v / (E / cos_l), with the light 5 deg off the sheet's normal; least are the figures of class RA1 for white."""
    to_lamp, to_eye = to_the_side(5.0), to_the_side(5.0 + observation_deg)
    coefficient = beta(MATERIALS["retroreflective_sign"], 0.0, to_lamp, to_eye) / math.pi * to_lamp[2] * to_eye[2]
    assert least <= coefficient.item() <= most


def test_lane_paint_has_the_luminance_of_its_class():
    """R_L = L / (E / cos_l) seen and lit as from 30 m (EN 1436): class R4 has at least 200 mcd/(m^2 lx)."""
    to_lamp, to_eye = to_the_side(90 - 1.24), to_the_side(90 - 2.29)
    coefficient = beta(MATERIALS["lane_paint"], 0.6, to_lamp, to_eye) / math.pi * to_lamp[2]
    assert 0.200 <= coefficient.item() <= 0.210


def test_a_wet_road_is_dark_to_its_own_lamps_and_mirrors_those_ahead():
    to_lamp, to_driver = to_the_side(-(90 - 2.5)), to_the_side(-(90 - 4.5))
    mirrored = to_the_side(90 - 2.5)
    albedo = WET.darken(torch.tensor(0.2)).item()
    assert albedo == pytest.approx(0.2 * 0.53 / (1 - 0.47 * 0.2), rel=1e-6)
    assert beta(WET, albedo, to_lamp, to_driver).item() < 0.6 * 0.2
    assert beta(WET, albedo, to_lamp, mirrored).item() > 20
    assert WET.darken(torch.tensor([0.0, 1.0])).tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("roughness", 0.0),
        ("roughness", 1.1),
        ("interface", 1.5),
        ("f0", -0.1),
        ("retro", math.nan),
        ("retro_width_deg", 0.0),
        ("trapped", 1.0),
    ],
)
def test_numbers_out_of_range_are_refused(name, value):
    with refusal(f"{name} = .*range"):
        Material(**{name: value})
