"""Moments, quadrant centroids and errors against shapes whose moments are known."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from luxloop.perception.appearance import DEGREES, Axes, appearance, errors, features, image_axes
from luxloop.world.frames import pose_from_degrees

H, W = 60, 80
AXES = image_axes(H, W, like=torch.zeros((), dtype=torch.float64))


def rectangle(u: tuple[float, float], v: tuple[float, float]) -> Tensor:
    """Exact share of every pixel that the rectangle covers."""

    def share(n: int, low: float, high: float) -> Tensor:
        edges = torch.arange(n + 1, dtype=torch.float64).clamp(low, high)
        return edges[1:] - edges[:-1]

    return share(H, *v)[:, None] * share(W, *u)


def sheared_ellipse(u: float, v: float, a: float, b: float, shear: float = 0.0, samples: int = 8) -> Tensor:
    """Share of every pixel, by samples, of an ellipse with half axes a, b (px), whose v then grows with u."""
    us = (torch.arange(W * samples, dtype=torch.float64) + 0.5) / samples - u
    vs = ((torch.arange(H * samples, dtype=torch.float64) + 0.5) / samples - v)[:, None] - shear * us
    inside = ((us / a) ** 2 + (vs / b) ** 2 <= 1).double()
    return inside.view(H, samples, W, samples).mean((1, 3))


@pytest.mark.parametrize(("u", "v"), [((10, 30), (20, 28)), ((10, 31), (20, 29)), ((3, 4), (50, 51))], ids=["even", "odd", "one pixel"])
def test_a_rectangle_of_whole_pixels_is_exact(u, v):
    seen = appearance(rectangle(u, v), AXES)
    width, height = u[1] - u[0], v[1] - v[0]
    centre_u, centre_v = sum(u) / 2, sum(v) / 2
    quadrants = [[centre_u + i * width / 4, centre_v + j * height / 4] for j in (-1, 1) for i in (-1, 1)]
    assert_close(seen.centroids, torch.tensor([[centre_u, centre_v], *quadrants], dtype=torch.float64))
    assert seen.area.item() == pytest.approx(width * height)
    # Pixels are points for second moments: (n^2 - 1) / 12.
    if width > 1:
        assert seen.shear.item() == pytest.approx(0, abs=1e-12)
        assert seen.length.item() == pytest.approx(math.sqrt((height**2 - 1) / 12))


@pytest.mark.parametrize("shear", [-0.4, 0.0, 0.3])
def test_a_sheared_ellipse(shear):
    u, v, a, b = 40.3, 29.6, 25.0, 12.0
    seen = appearance(sheared_ellipse(u, v, a, b, shear), AXES)
    # 64 samples a pixel leave 1e-3 of a pixel along the outline.
    assert seen.area.item() == pytest.approx(math.pi * a * b, rel=1e-3)
    assert seen.centroids[0].tolist() == pytest.approx([u, v], abs=5e-3)
    assert seen.shear.item() == pytest.approx(shear, abs=1e-3)
    assert seen.length.item() == pytest.approx(b / 2, rel=5e-3), "shear leaves the length"
    if shear == 0:
        quarter_u, quarter_v = 4 * a / (3 * math.pi), 4 * b / (3 * math.pi)
        expected = [[u + i * quarter_u, v + j * quarter_v] for j in (-1, 1) for i in (-1, 1)]
        # The pixels on the split are cut as if they were uniform; at the outline they are not.
        assert_close(seen.centroids[1:], torch.tensor(expected, dtype=torch.float64), rtol=0, atol=0.02)


def random_symbol() -> Tensor:
    """A lopsided blob with holes, far from the border."""
    image = torch.zeros(H, W, dtype=torch.float64)
    image[20:36, 30:54] = torch.rand(16, 24, dtype=torch.float64, generator=torch.Generator().manual_seed(3)).round()
    return image


@given(st.integers(-20, 20), st.integers(-25, 25))
def test_whole_pixels_shift_everything_alike(rows, cols):
    image = random_symbol()
    still, moved = appearance(image, AXES), appearance(image.roll((rows, cols), (0, 1)), AXES)
    shift = torch.tensor([cols, rows], dtype=torch.float64)
    assert_close(moved.centroids, still.centroids + shift, rtol=0, atol=1e-10)
    for name in ("area", "shear", "length"):
        assert_close(getattr(moved, name), getattr(still, name), rtol=0, atol=1e-10)
    off = errors(features(moved, "quadrants"), features(still, "quadrants"))
    assert_close(off, torch.tensor([cols, rows, 0.0, 0], dtype=torch.float64), rtol=0, atol=1e-10)


def test_nothing_jumps_while_a_symbol_moves_by_fractions_of_a_pixel():
    steps = torch.linspace(0, 2, 81, dtype=torch.float64)
    seen = [features(appearance(sheared_ellipse(40 + s, 30 + s, 20, 9, 0.3), AXES), "quadrants") for s in steps.tolist()]
    change = torch.stack(seen).diff(dim=0)[:, 2:].abs()
    # A hard split at the rounded centroid would jump by half a pixel; what is left is half from the outline's 64 samples a pixel.
    assert change.max() < 0.005
    assert (torch.stack(seen)[:, 2:].amax(0) - torch.stack(seen)[:, 2:].amin(0)).max() < 0.01


def test_features_are_the_printed_sums():
    seen = appearance(random_symbol(), AXES)
    _, tl, tr, bl, br = seen.centroids[:, 1].tolist()
    u, v, roll, pitch = features(seen, "quadrants").tolist()
    assert (u, v) == tuple(seen.centroids[0].tolist())
    assert roll == pytest.approx(((tr - tl) + (br - bl)) / 2)
    assert pitch == pytest.approx(((tr + tl) - (br + bl)) / 2)
    assert features(seen, "moments")[2:].tolist() == [seen.shear.item(), seen.length.item()]


def test_batches_are_loops_of_singles_and_float32_is_good_to_a_thousandth_of_a_pixel(device):
    images = torch.stack(
        [rectangle((10, 30.3), (20, 28)), sheared_ellipse(50, 20, 20, 9, 0.3), random_symbol(), rectangle((70, 75), (3, 9.5))]
    )
    batch = appearance(images.float().to(device).view(2, 2, H, W), image_axes(H, W, like=torch.zeros((), device=device)))
    assert batch.centroids.shape == (2, 2, 5, 2)
    assert (batch.centroids.dtype, batch.centroids.device.type) == (torch.float32, device.type)
    for k, image in enumerate(images):
        single = appearance(image, AXES)
        assert_close(batch.centroids[k // 2, k % 2].cpu().double(), single.centroids, rtol=0, atol=1e-3)
        assert_close(batch.length[k // 2, k % 2].cpu().double(), single.length, rtol=0, atol=1e-3)


@pytest.mark.parametrize(("rows", "cols"), [(0, 0), (H, 0), (1, W), (H, 1)])
def test_an_empty_image_and_a_crop_of_less_than_two_pixels_have_no_centre(rows, cols):
    """A crop of a command that leaves the camera's image; a batch is not spoilt."""
    crop = appearance(random_symbol()[:rows, :cols], Axes(AXES.u[:cols], AXES.v[:rows]))
    assert crop.area == 0 and not crop.centroids.isfinite().all()
    seen = appearance(torch.stack([torch.zeros(H, W, dtype=torch.float64), random_symbol()]), AXES)
    assert seen.area[0] == 0
    assert seen.centroids[0].isnan().all() and seen.shear[0].isnan() and seen.length[0].isnan()
    assert seen.centroids[1].isfinite().all()


def test_gradient_against_differences():
    image = (random_symbol()[18:38, 28:56] + 0.1).requires_grad_()
    axes = image_axes(20, 28, like=image)

    def all_features(image: Tensor) -> Tensor:
        seen = appearance(image, axes)
        return torch.cat([features(seen, "quadrants"), features(seen, "moments"), seen.area[None]])

    assert torch.autograd.gradcheck(all_features, (image,), eps=1e-5, atol=1e-6)


def test_a_pose_gives_back_the_values_it_was_made_of():
    T = pose_from_degrees((17.0, -0.4, 0.2), roll_deg=3.0, pitch_deg=-2.0)
    found = {degree.name: float(degree.of_pose(T)) for degree in DEGREES}
    assert found == pytest.approx({"x": 17.0, "y": -0.4, "roll": math.radians(3.0), "pitch": math.radians(-2.0)})


def test_mirrored_symbols_roll_the_other_way():
    image = sheared_ellipse(40, 30, 20, 9, 0.3) + rectangle((30, 34), (20, 24))
    mirrored, upside_down = image.flip(1), image.flip(0)
    for shape in ("quadrants", "moments"):
        roll, pitch = features(appearance(image, AXES), shape)[2:]
        assert roll > 0.1, "the right side is lower in the image"
        assert features(appearance(mirrored, AXES), shape)[2:].tolist() == pytest.approx([-roll.item(), pitch.item()], abs=1e-9)
        assert features(appearance(upside_down, AXES), shape)[2:].tolist() == pytest.approx([-roll.item(), pitch.item()], abs=1e-9)


def test_axes_in_metres_scale_everything():
    image, cell = random_symbol(), 0.04
    metres = appearance(image, Axes(AXES.u * cell - 1.5, AXES.v * cell - 19))
    pixels = appearance(image, AXES)
    assert_close(metres.centroids, pixels.centroids * cell - torch.tensor([1.5, 19.0], dtype=torch.float64))
    assert_close(metres.area, pixels.area * cell**2)
    assert_close(metres.length, pixels.length * cell)
    assert_close(metres.shear, pixels.shear)
