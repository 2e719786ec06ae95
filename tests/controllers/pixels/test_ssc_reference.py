"""SuperSampling Control as a whole against the plain reference, over random lamps, primitives and parameters."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.controllers.pixels.primitives import QUANTITIES, Observer, Primitives, concatenate, rectangle
from luxloop.controllers.pixels.secondary import PotentialLight, SecondaryRays
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.scene.scene import StreetLamp
from luxloop.world.spmv import Csr
from tests.reference import ssc as reference

ROWS, COLS, PIXELS = 7, 9, 8
T = pose_from_degrees((0.2, 0.5, 0.7), roll_deg=2, pitch_deg=-1, yaw_deg=3)

parameters = st.builds(
    MrpcParams,
    a_m=st.sampled_from([0.0, 0.5, 1.0, 1.0, 2.0]),
    a_r=st.sampled_from([0.0, 0.7, 1.0, 2.0]),
    a_x=st.sampled_from([0.0, 0.0, 0.3, 1.0]),
    exclusion=st.sampled_from(["capability", "printed"]),
    a_ac=st.sampled_from([0.0, 0.0, 0.4, 1.0]),
    a_d=st.sampled_from([None, None, 0.5, 1.5]),
    lower_cd=st.sampled_from([0.0, 0.0, 60.0]),
    upper_cd=st.sampled_from([None, None, 400.0]),
    mapping=st.sampled_from(["potentiated", "potentiated", "direct", "maximal"]),
    sampling=st.sampled_from(["all", "all", "brightest", "centroid", "uniform", "rotated", "n_rooks", "quincunx"]),
    granularity=st.sampled_from([0.0, 0.0, 0.5]),
)


def random_lamp(generator: np.random.Generator) -> tuple[Headlight, np.ndarray]:
    """Pixels that overlap; some texels and sometimes a pixel are dark."""
    A = generator.uniform(20, 1000, (ROWS * COLS, PIXELS)) * (generator.random((ROWS * COLS, PIXELS)) < 0.3)
    matrix = Csr.from_scipy(sp.csr_array(A), torch.float64)
    light = Headlight(
        name="random", matrix=matrix, rows=ROWS, cols=COLS, left=0.25, right=-0.2, bottom=-0.1, top=0.15, pixel_rows=2, pixel_cols=4
    )
    return light, A


def random_primitive(generator: np.random.Generator) -> Primitives:
    """A skewed rectangle that mostly faces the lamp, of any quantity, weight and rank, at times with a picture before an observer's eye."""
    x = generator.uniform(6, 20)
    centre = T[:3, 3].numpy() + T[:3, :3].numpy() @ (x * np.array([1, generator.uniform(-0.2, 0.25), generator.uniform(-0.1, 0.15)]))
    d1 = x * generator.uniform(0.05, 0.4) * np.array([generator.normal() * 0.4, -1, generator.normal() * 0.3])
    d2 = x * generator.uniform(0.03, 0.25) * np.array([generator.normal() * 0.4, generator.normal() * 0.3, -1])
    origin, d1, d2 = (torch.from_numpy(vector) for vector in (centre - (d1 + d2) / 2, d1, d2))
    quantity = QUANTITIES[generator.integers(4)]
    value = {"I_v": 1500.0, "E_v": 8.0, "u_abs": 1.2, "u_rel": 1.8}[quantity] * generator.random() * (generator.random() < 0.75)
    normal = -torch.linalg.cross(d1, d2) if generator.random() < 0.9 else torch.tensor([-1.0, 0.2, 0.3])
    drawn = rectangle(
        origin,
        d1,
        d2,
        value,
        quantity,
        normal=normal,
        symbol=torch.from_numpy(generator.random((3, 4))) if generator.random() < 0.5 else None,
        weight=float(generator.choice([0.0, 0.4, 1.0, 1.0, 3.0, 1e15, math.inf])),
        forced=bool(generator.random() < 0.3),
        priority=int(generator.integers(3)),
        nearest=bool(generator.random() < 0.3),
        modules=[(), (), ("left",), ("left", "right far")][generator.integers(4)],
        shared=bool(generator.random() < 0.8),
    )
    if generator.random() < 0.6:
        return drawn
    eye = torch.from_numpy(T[:3, 3].numpy() + generator.normal(size=3))
    middle = origin + (d1 + d2) / 2
    closer, turn = generator.uniform(0.3, 0.9), torch.from_numpy(np.eye(3) + 0.1 * generator.normal(size=(3, 3)))
    right, down = (closer * generator.uniform(0.5, 1.2) * turn @ edge for edge in (d1, d2))
    picture = eye + closer * (middle - eye) - (right + down) / 2
    return replace(drawn, observer=Observer(*(each[None] for each in (eye, picture, right, down)), active=torch.tensor([True])))


def random_secondary(generator: np.random.Generator, light: Headlight, A: np.ndarray) -> tuple[SecondaryRays, reference.Asked]:
    """Three lights, one of them far from the others, up to two street lamps, and a ball that hides what lies behind it."""
    lights = [("left near", light, A, T)]
    for name, away in (("right near", (0.1, -0.6, 0.0)), ("right far", (-1.0, 1.0, 0.4))):
        other, B = random_lamp(generator)
        lights.append((name, other, B, T @ pose_from_degrees(away, yaw_deg=float(generator.uniform(-3, 3)))))
    street = tuple(
        StreetLamp(position_m=tuple(T[:3, 3].numpy() + generator.uniform([3, -3, 2], [10, 3, 5])), intensity_cd=30.0)
        for _ in range(generator.integers(3))
    )
    ball, radius = T[:3, 3].numpy() + generator.uniform([1, -1, -0.5], [5, 1, 0.5]), generator.uniform(0.1, 0.6)

    def occluded(points: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        centre, target = torch.from_numpy(ball).to(points), target.to(points)
        ray = points - target[:, None]
        along = ((centre - target) @ ray / (ray * ray).sum(0)).clamp(0, 1)
        return (target[:, None] + along * ray - centre[:, None]).norm(dim=0) < radius

    def blocked(point: np.ndarray, target: np.ndarray) -> bool:
        ray, q = target - point, point - ball
        roots = np.roots([ray @ ray, 2 * ray @ q, q @ q - radius**2])
        return bool(np.isreal(roots).all() and roots.real.max() > 0 and roots.real.min() < 1)

    rays = SecondaryRays(tuple((name, PotentialLight.of(each, place)) for name, each, _, place in lights), 0, street, occluded)
    full = [(name, each, B.sum(1).reshape(ROWS, COLS), place.numpy()) for name, each, B, place in lights]
    return rays, reference.Asked(full, 0, [(np.array(lamp.position_m), lamp.intensity_cd) for lamp in street], blocked)


def random_case(seed: int) -> tuple[Headlight, np.ndarray, Primitives, torch.Tensor]:
    generator = np.random.default_rng(seed)
    light, A = random_lamp(generator)
    scene = concatenate(*(random_primitive(generator) for _ in range(generator.integers(1, 5))))
    default = torch.from_numpy(generator.random(PIXELS)) * bool(generator.random() < 0.6)
    return light, A, scene, default


@settings(max_examples=150)
@given(st.integers(0, 2**32 - 1), parameters, st.booleans())
def test_equals_the_reference(seed, params, asks):
    light, A, scene, default = random_case(seed)
    secondary, asked = random_secondary(np.random.default_rng(seed), light, A) if asks else (None, None)
    ssc = Ssc.prepare(light, params, default)
    scenes = [scene, moved(scene)]
    batch = ssc.utilisation(stacked(scenes), T, secondary).u
    for each, of_batch in zip(scenes, batch, strict=True):
        rays = reference.trace(each, light, T.numpy(), asked)
        expected, close = reference.map_reduce(A, rays, params, default.numpy(), COLS)
        for u in (ssc.utilisation(each, T, secondary).u, of_batch):
            # float64; pixels with an entry at a threshold are left out.
            np.testing.assert_allclose(u[~close], expected[~close], rtol=0, atol=1e-9)


def moved(scene: Primitives) -> Primitives:
    """A scene a little to the left, its observers' eyes a little higher."""
    observer = scene.observer and replace(scene.observer, eye=scene.observer.eye + torch.tensor([0.0, 0.0, 0.1]))
    return replace(scene, origin=scene.origin + torch.tensor([0.0, 0.21, 0.0]), observer=observer)


def stacked(scenes: list[Primitives]) -> Primitives:
    """Scenes that differ in places and setpoints alone as a batch, which takes all rays."""
    vectors = {name: torch.stack([getattr(each, name) for each in scenes]) for name in ("origin", "d1", "d2", "normal", "value", "weight")}
    who = [each.observer for each in scenes if each.observer is not None]
    eyes = {name: torch.stack([getattr(each, name) for each in who]) for name in ("eye", "origin", "d1", "d2")} if who else {}
    return replace(scenes[0], **vectors, observer=replace(who[0], **eyes) if who else None)


@pytest.mark.parametrize("a_x", [0.0, 0.3])
@pytest.mark.parametrize("bounds", [{}, {"upper_cd": 400.0, "a_m": 0.5}], ids=["products", "entries"])
@pytest.mark.parametrize("asks", [False, True], ids=["primary", "secondary"])
def test_float32_on_every_device(asks, a_x, bounds, device):
    off = 0
    for seed in range(15):
        light, A, scene, default = random_case(seed)
        secondary = random_secondary(np.random.default_rng(seed), light, A)[0] if asks else None
        params = MrpcParams(a_x=a_x, a_r=2, a_ac=0.2, **bounds)
        exact = Ssc.prepare(light, params, default).utilisation(scene, T, secondary).u
        single = replace(light, matrix=light.matrix.to(torch.float32)).to(device)
        ssc = Ssc.prepare(single, params, default.float().to(device))
        u = ssc.utilisation(scene.to(torch.float32).to(device), T.to(device), secondary).u
        assert (u.dtype, u.device.type) == (torch.float32, device.type)
        off += ((u.cpu() - exact).abs() > 1e-5).sum()
    # Of 120 pixels: rays that hit an outline, and light at a threshold, within a rounding.
    assert off <= 4


def test_a_list_in_any_order_gives_the_same_light():
    """No two lie in one plane here, where the order would decide."""
    light, _, scene, default = random_case(7)
    ssc = Ssc.prepare(light, MrpcParams(), default)
    flags = [torch.arange(len(scene)) == p for p in reversed(range(len(scene)))]
    backwards = concatenate(*(scene.select(flag) for flag in flags))
    assert len(scene) > 1
    torch.testing.assert_close(ssc.utilisation(scene, T).u, ssc.utilisation(backwards, T).u, rtol=0, atol=1e-12)


def test_gradients_in_many_primitives_are_those_of_differences():
    generator = np.random.default_rng(5)
    light, _ = random_lamp(generator)
    scene = concatenate(*(random_primitive(generator) for _ in range(3)))
    scene = replace(scene, quantity=torch.tensor([0, 2, 3]), weight=torch.tensor([1.0, 0.5, 2.0], dtype=torch.float64))
    ssc = Ssc.prepare(light, MrpcParams(), torch.full((PIXELS,), 0.3, dtype=torch.float64))

    def u(value: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        return ssc.utilisation(replace(scene, value=value, weight=weight), T).u

    value = torch.tensor([50.0, 0.4, 0.5], dtype=torch.float64, requires_grad=True)  # no ray comes near a bound
    assert torch.autograd.gradcheck(u, (value, scene.weight.clone().requires_grad_()), eps=1e-5, rtol=1e-4)
