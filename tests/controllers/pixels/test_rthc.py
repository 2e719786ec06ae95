"""The homography against rays solved one by one, and the conventions of setpoints."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from luxloop.controllers.pixels.primitives import Primitives, concatenate, rectangle, road_symbol
from luxloop.controllers.pixels.rthc import Setpoints, trace
from luxloop.controllers.pixels.windows import projected_windows, row_bands, union, whole
from luxloop.world.frames import pose_from_degrees
from luxloop.world.lamps.presets import idealised
from luxloop.world.texels import Window
from tests.reference import ssc as reference

LAMP = idealised(10, 16)  # 40 x 32 texels
T_LEFT = pose_from_degrees((0.0, 0.6, 0.75))
T_ORIGIN = pose_from_degrees((0.0, 0.0, 0.0))


def primitives(
    *rectangles: tuple, symbols: Tensor | None = None, quantity: str = "u_abs", dtype: torch.dtype = torch.float64
) -> Primitives:
    """Rectangles given as (origin, d1, d2, value), with the normal that looks back at the lamp."""
    parts = []
    for k, r in enumerate(rectangles):
        origin, d1, d2 = (torch.tensor(vector, dtype=dtype) for vector in r[:3])
        normal = torch.linalg.cross(d1, d2)
        symbol = None if symbols is None else symbols[k].to(dtype)
        parts.append(rectangle(origin, d1, d2, r[3], quantity, normal=-normal * torch.sign(normal @ origin), symbol=symbol))
    return concatenate(*parts)


def facing(x: float, value: float = 1.0, half: float = 100.0, y: float = 0.0) -> tuple:
    """A square wall at x, seen upright: u to the right, v down."""
    return (x, y + half, half), (0.0, -2 * half, 0.0), (0.0, 0.0, -2 * half), value


def random_scene(seed: int, quantity: str) -> Primitives:
    """Four skewed rectangles all over the field of view, each with a symbol of its own."""
    generator = np.random.default_rng(seed)
    rectangles = []
    for value in generator.uniform(0.1, 2, 4):
        x = generator.uniform(5, 30)
        centre = x * np.array([1, generator.uniform(-0.15, 0.15), generator.uniform(-0.06, 0.03)])
        d1, d2 = generator.normal(size=(2, 3)) * x * 0.1
        rectangles.append((tuple(centre - (d1 + d2) / 2), tuple(d1), tuple(d2), value))
    return primitives(*rectangles, symbols=torch.from_numpy(generator.random((4, 5, 7))), quantity=quantity)


def plain(scene: Primitives, T: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints and hits of the reference, `[rows, cols]`."""
    rays = reference.trace(scene, LAMP, T.numpy())
    shape = (LAMP.rows, LAMP.cols)
    return np.array([ray.value for ray in rays]).reshape(shape), np.array([ray.hit for ray in rays]).reshape(shape)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("quantity", ["u_abs", "E_v"])
def test_rays_are_those_solved_one_by_one_and_pass_where_an_image_is_transparent(seed, quantity):
    T = pose_from_degrees((0.3, 0.2, 0.1), roll_deg=5, pitch_deg=-1, yaw_deg=3)
    scene = opaque = random_scene(seed, quantity)
    opacity = torch.from_numpy(np.random.default_rng(seed).random((4, 5, 7)))
    scene = replace(scene, symbols=tuple(torch.stack([image, alpha]) for image, alpha in zip(scene.symbols, opacity, strict=True)))
    value, hit = plain(scene, T)
    seen = trace(scene, LAMP, T)
    assert 0 < hit.sum() < trace(opaque, LAMP, T).hit.sum()
    np.testing.assert_array_equal(seen.hit, hit)
    # Both float64; a ray that grazes its rectangle costs the solver some digits.
    np.testing.assert_allclose(seen.value, value, rtol=1e-9, atol=1e-9)
    mask = replace(scene, value=torch.zeros_like(scene.value), weight=torch.full_like(scene.weight, torch.inf))
    whole_mask = replace(mask, symbols=tuple(image[0] for image in mask.symbols))
    for windows in (None, [whole(LAMP)] * 4):
        assert torch.equal(trace(mask, LAMP, T, windows).hit, trace(whole_mask, LAMP, T, windows).hit)


@pytest.mark.parametrize(("dtype", "gap_m"), [(torch.float32, 1e-4), (torch.float64, 1e-12)])
def test_a_panel_before_a_wall_wins(dtype, gap_m):
    """Only what rounding cannot tell apart, 0.03 mm at 30 m in float32, lies in one plane; there the later one wins."""
    wall = facing(30.0, value=0.7)
    for gap, order in ((0.002, False), (gap_m, False), (gap_m / 10, True)):
        panel = facing(30.0 - gap, value=0.3, half=2.0)
        seen = trace(primitives(panel, wall, dtype=dtype), LAMP, T_ORIGIN)
        alone = trace(primitives(panel, dtype=dtype), LAMP, T_ORIGIN)
        assert alone.hit.sum() > 100
        expected = torch.tensor(0.7 if order else 0.3, dtype=dtype)
        assert (seen.value[alone.hit] == expected).all(), f"{gap:g} m"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_in_any_plane_the_later_wins_and_not_what_rounding_brings_nearer(dtype):
    generator = np.random.default_rng(0)
    met = 0
    for _ in range(300):
        T = pose_from_degrees(tuple(generator.normal(size=3) * 10 ** generator.uniform(-1, 2)), pitch_deg=generator.uniform(-4, 4))
        ray = T[:3, :3].numpy() @ np.array([1.0, generator.uniform(-0.1, 0.1), generator.uniform(-0.06, 0.03)])
        normal = generator.normal(size=3) * np.array([generator.choice([0.05, 1.0]), 0.3, 1.0])
        normal *= -np.sign(normal @ ray) / np.linalg.norm(normal)
        length = 10 ** generator.uniform(-0.3, 1.3) / -(normal @ ray)  # the lamp is 0.5 to 20 m from the plane
        if length > 200:
            continue
        right = np.cross(normal, ray) / np.linalg.norm(np.cross(normal, ray))
        parts = []
        for value in (0.25, 0.5):
            turn = 10 ** generator.uniform(-0.5, 1.5, 2)[:, None] * generator.normal(size=(2, 2))
            d1, d2 = turn @ np.array([right, np.cross(right, normal)])
            origin = T[:3, 3].numpy() + length * ray - generator.uniform(0.1, 0.9) * d1 - generator.uniform(0.1, 0.9) * d2
            edges = (torch.tensor(vector, dtype=dtype) for vector in (origin, d1, d2))
            parts.append(rectangle(*edges, value, normal=torch.tensor(normal, dtype=dtype)))
        later = trace(parts[1], LAMP, T)
        met += int(later.hit.sum())
        assert (trace(concatenate(*parts), LAMP, T).value[later.hit] == 0.5).all()
    assert met > 10_000


def test_back_faces_and_what_lies_behind_the_lamp_are_not_hit():
    scene = primitives(facing(10))
    assert trace(scene, LAMP, T_ORIGIN).hit.all()
    assert not trace(replace(scene, normal=-scene.normal), LAMP, T_ORIGIN).hit.any()
    assert not trace(replace(scene, origin=scene.origin - torch.tensor([20.0, 0, 0])), LAMP, T_ORIGIN).hit.any()


@pytest.mark.parametrize("weight", [1.0, math.inf])
@pytest.mark.parametrize(
    ("d1", "d2"),
    [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (0.0, 0.0, -2.0)), ((30.0, 0.0, 0.0), (0.0, 0.0, -2.0))],
    ids=["none", "line", "edge-on"],
)
def test_what_has_no_area_to_the_lamp_is_not_hit(d1, d2, weight, device):
    """By a batch as by a single scene, and another one behind it is hit as if it were not there."""
    alone = rectangle((8.0, 0.0, 1.0), d1, d2, 0.0, normal=(-1.0, 0.0, 0.0), weight=weight, symbol=torch.eye(3)).to(device)
    scene = concatenate(alone, primitives(facing(20.0, 0.5), dtype=torch.float32).to(device))
    for seen in (trace(scene, LAMP, T_ORIGIN), trace(batched(scene), LAMP, T_ORIGIN)):
        assert seen.hit.all() and (seen.value == 0.5).all() and (seen.weight is None or (seen.weight == 1).all())
    windows = projected_windows(alone, LAMP, T_ORIGIN, [weight == math.inf]) if device.type == "cpu" else None
    assert not any(trace(each, LAMP, T_ORIGIN, around).hit.any() for each, around in ((alone, windows), (batched(alone), None)))


def batched(scene: Primitives) -> Primitives:
    """A batch of one."""
    return replace(scene, **{name: getattr(scene, name)[None] for name in ("origin", "d1", "d2", "normal", "value", "weight")})


road_poses = st.tuples(st.floats(2, 60), st.floats(-8, 8), st.floats(-0.7, 0.7), st.floats(-0.5, 0.5))


def cut(setpoints: Setpoints, w: Window) -> tuple[Tensor, Tensor]:
    return setpoints.value[w.v_start : w.v_stop, w.u_start : w.u_stop], setpoints.hit[w.v_start : w.v_stop, w.u_start : w.u_stop]


@settings(max_examples=100)
@given(road_poses)
def test_projected_window_holds_every_hit(pose):
    scene = road_symbol(torch.tensor(pose), 0.0, 2.0, 4.0, torch.rand(4, 4), 1.0, "u_abs")
    all_rays = trace(scene, LAMP, T_LEFT)
    (window,) = projected_windows(scene, LAMP, T_LEFT)
    value, hit = cut(all_rays, window)
    assert hit.sum() == all_rays.hit.sum()
    banded = trace(scene, LAMP, T_LEFT, [window])
    assert banded.hit.sum() == hit.sum()
    if hit.any():  # what turns its back is left out from the start
        assert banded.window == window
        assert torch.equal(banded.hit, hit)
        torch.testing.assert_close(banded.value, value, rtol=1e-5, atol=1e-6)


def test_window_is_tight_and_cut_where_it_reaches_behind():
    wall = primitives(facing(10, half=0.3))
    (window,) = projected_windows(wall, LAMP, T_ORIGIN)
    hit = torch.nonzero(trace(wall, LAMP, T_ORIGIN).hit)
    assert (hit.amin(0) - torch.tensor([window.v_start, window.u_start]) <= 1).all()
    assert (torch.tensor([window.v_stop, window.u_stop]) - hit.amax(0) <= 2).all()
    around = primitives(((-5.0, 3.0, -1.0), (40.0, 0.0, 0.0), (0.0, -6.0, 0.0), 1.0))
    (ahead,) = projected_windows(around, LAMP, T_ORIGIN)
    assert ahead == Window(25, LAMP.rows, 0, LAMP.cols), "as high as its far end, which lies 35 m ahead"
    assert projected_windows(around, LAMP, T_ORIGIN, [True]) == [whole(LAMP)]


@pytest.mark.parametrize("quantity", ["u_abs", "E_v"])
def test_gradient_survives_rays_along_the_plane(quantity):
    lamp = idealised(5, 4, texels_per_pixel=(1, 2), top_deg=5, bottom_deg=-5)
    assert lamp.tangents(torch.float32, torch.device("cpu"))[1][2] == 0, "the middle row looks along the road"
    pose = torch.tensor([17.0, 0.0, 0.0, 0.0], requires_grad=True)
    seen = trace(road_symbol(pose, 0.0, 6.0, 12.0, torch.rand(4, 4), 1.0, quantity), lamp, T_LEFT)
    assert seen.hit.any() and not seen.hit[:3].any()
    seen.value.sum().backward()
    assert pose.grad is not None and pose.grad.isfinite().all() and pose.grad.any()


def test_the_reference_interpolates_as_the_conventions_say():
    image = np.array([[1.0, 0.0], [0.0, 0.0]])
    assert reference.symbol_value(image, 0.25, 0.25) == 1
    assert reference.symbol_value(image, 0.5, 0.25) == 0.5
    assert reference.symbol_value(image, 0.5, 0.5) == 0.25
    assert reference.symbol_value(image, 0.1, 0.0) == 1


def test_a_given_normal_serves_the_cosine_only():
    scene = primitives(facing(10, value=5.0), quantity="E_v")
    tilted = replace(scene, normal=torch.tensor([[-0.6, 0.0, 0.8]], dtype=torch.float64))
    straight, slanting = trace(scene, LAMP, T_ORIGIN), trace(tilted, LAMP, T_ORIGIN)
    _, z = LAMP.tangents()
    cosine_ratio = 0.6 - 0.8 * z[:, None].expand(-1, LAMP.cols)  # of the unnormalised ray, whose length cancels
    torch.testing.assert_close(slanting.value, straight.value / cosine_ratio, rtol=1e-12, atol=0)


@pytest.mark.parametrize("y", [-2.5, 3.7])
@pytest.mark.parametrize("roll", [-0.03, 0.05])
def test_parts_of_a_primitive_hold_all_of_its_rays(roll, y):
    grid = idealised(200, 320)  # 512,000 texels
    one = road_symbol(torch.tensor([17.0, y, roll, 0.0]), 0.0, 2.0, 9.0, torch.rand(8, 8), 1.0, "u_abs")
    windows = projected_windows(one, grid, T_LEFT)
    whole_hit, (parts,) = trace(one, grid, T_LEFT, windows).hit.bool(), row_bands(one, grid, T_LEFT, windows)
    held = torch.zeros_like(whole_hit)
    for part in parts:
        held[part.within(union(windows))] = True
    assert whole_hit.any() and not (whole_hit & ~held).any()
    assert len(parts) > 1 and not held.all(), "it slants, as seen from beside"
