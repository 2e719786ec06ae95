"""Light on surfaces against `E = I cos / d^2` in closed form, and the folded matrix against the plain path."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import scipy.sparse as sp
import torch
import trimesh
from scipy.ndimage import map_coordinates
from torch import Tensor
from torch.testing import assert_close

from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised
from luxloop.world.light.illumination import (
    DirectTransport,
    Shadows,
    added_light,
    illuminance,
    lit_surface,
    luminance,
    lux_per_cd,
    transport,
)
from luxloop.world.rendering.gbuffer import GBuffer, flat_road
from luxloop.world.scene.body import Body
from luxloop.world.scene.scene import Scene
from luxloop.world.spmv import Csr
from tests.world.grids import camera

CD = 30_000.0


class Light(NamedTuple):
    u: Tensor
    band: slice | None = None


LAMP = idealised(20, 32, intensity_cd=CD)
T_LEFT = pose_from_degrees((0.0, 0.6, 0.75))


def test_lux_per_candela_falls_with_distance_squared_and_the_cosine_of_incidence():
    lamps = torch.tensor([[0.0, 0.0, 2.0], [0.0, 3.0, 4.0], [3.0, 0.0, 0.0], [0.0, 0.0, -1.0]]).double()  # from the point, [n, 3]
    up = torch.tensor([[0.0], [0.0], [1.0]]).double()
    assert_close(lux_per_cd(lamps.T, up), torch.tensor([1 / 4, 0.8 / 25, 0.0, 0.0]).double())  # above, 3-4-5, grazing, below
    assert_close(lux_per_cd(lamps.T), torch.tensor([1 / 4, 1 / 25, 1 / 9, 1.0]).double())
    assert lux_per_cd(lamps.T.expand(5, 3, 4), up).shape == (5, 4)


def surface_at(points: Tensor, normal: tuple[float, float, float], albedo: float = 0.3) -> GBuffer:
    """One row of a G-buffer with points `[3, N]` and one normal."""
    n = points.shape[1]
    normals = torch.tensor(normal, dtype=torch.float64).to(points)[:, None].expand(3, n)
    shape = (1, n)
    return GBuffer(
        points[:, None], normals[:, None], torch.full(shape, albedo).to(points), torch.zeros(shape, dtype=torch.int32).to(points.device)
    )


def wall(x_m: float, device: torch.device) -> GBuffer:
    """A wall that the left lamp's field lies well within."""
    y, z = torch.meshgrid(torch.linspace(-0.25, 0.25, 61, device=device), torch.linspace(-0.1, 0.06, 31, device=device), indexing="ij")
    return surface_at(torch.stack([torch.full_like(y, x_m), 0.6 + x_m * y, 0.75 + x_m * z]).flatten(1), (-1.0, 0.0, 0.0))


def inner_field(gbuffer: GBuffer, T_world_headlight: Tensor, lamp: Headlight = LAMP) -> Tensor:
    """Mask `[N]` of the points that the lamp sees at least one pixellight away from its border, where it is even."""
    x, y, z = transform(inverse(T_world_headlight).to(gbuffer.position), gbuffer.position.flatten(1))
    row, col = lamp.texel_of(y / x, z / x)
    margin_r, margin_c = lamp.rows / lamp.pixel_rows, lamp.cols / lamp.pixel_cols
    inside = (row > margin_r) & (row < lamp.rows - margin_r) & (col > margin_c) & (col < lamp.cols - margin_c)
    return inside & (x > 0) & (gbuffer.object_id.flatten() >= 0)


def closed_form(gbuffer: GBuffer, T_world_headlight: Tensor) -> Tensor:
    """`I cos / d^2` `[N]` in float64 of an even lamp."""
    away = T_world_headlight[:3, 3:].to(gbuffer.position.device) - gbuffer.position.flatten(1).double()
    d = away.norm(dim=0)
    return CD * (gbuffer.normal.flatten(1).double() * away).sum(0) / d**3


def light_on(gbuffer: GBuffer, T_world_headlight: Tensor, lamp: Headlight = LAMP, utilisation: Tensor | None = None) -> Tensor:
    """Illuminance `[N]` of a whole G-buffer through the plain path, the lamp at full utilisation by default."""
    u = gbuffer.position.new_ones(lamp.n_pixels) if utilisation is None else utilisation
    lit = lit_surface(gbuffer, lamp, T_world_headlight)
    image = torch.zeros_like(gbuffer.albedo).flatten()
    image[lit.index] = illuminance(lit, lamp.light_texture(u))
    return image


def assert_closed_form(gbuffer: GBuffer, poses: list[Tensor]) -> None:
    lamp = LAMP.to(gbuffer.position.device)
    even = torch.stack([inner_field(gbuffer, T) for T in poses]).all(0)
    assert even.sum() > 100
    actual = torch.stack([light_on(gbuffer, T, lamp) for T in poses]).sum(0)[even].double()
    expected = torch.stack([closed_form(gbuffer, T) for T in poses]).sum(0)[even]
    # The promise is 0.1 %; float32 does 100 times better where the texture is even and interpolation cannot matter.
    assert_close(actual, expected, rtol=1e-5, atol=0)


@pytest.mark.parametrize("x_m", [2.0, 10.0, 50.0])
@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (3.0, -1.0, 5.0)])
def test_flat_wall(x_m, turned, device):
    assert_closed_form(wall(x_m, device), [pose_from_degrees((0.0, 0.6, 0.75), *turned)])


def test_nothing_is_lit_beyond_the_border_behind_the_lamp_or_on_the_back(device):
    gbuffer = wall(10.0, device)
    x, y, z = gbuffer.position.flatten(1) - T_LEFT[:3, 3:].to(gbuffer.position)
    outside = ((y / x).abs() > LAMP.left) | (z / x > LAMP.top) | (z / x < LAMP.bottom)
    lamp = LAMP.to(device)
    light = light_on(gbuffer, T_LEFT, lamp)
    assert (light[outside] == 0).all()
    assert (light[~outside] > 0).all(), "asymmetric tangents: +1.5 / -3.5 deg"
    assert not light_on(replace(gbuffer, normal=-gbuffer.normal), T_LEFT, lamp).any()
    assert not light_on(replace(gbuffer, position=-gbuffer.position), T_LEFT, lamp).any()
    assert not light_on(replace(gbuffer, object_id=gbuffer.object_id - 1), T_LEFT, lamp).any()


def texel_lamp(left: float, right: float, bottom: float, top: float, rows: int = 4, cols: int = 5) -> Headlight:
    """Every texel is a pixellight of its own with 1 cd."""
    matrix = Csr.from_scipy(sp.eye_array(rows * cols), torch.float64)
    return Headlight(
        name="texels", matrix=matrix, rows=rows, cols=cols, left=left, right=right, bottom=bottom, top=top, pixel_rows=rows, pixel_cols=cols
    )


@pytest.mark.parametrize("borders", [(0.2, -0.2, -0.06, 0.03), (0.5, 0.1, -0.3, -0.1)], ids=["asymmetric", "looking aside"])
def test_texture_is_bilinear_between_centres_and_clamped_outside_of_them(borders):
    left, right, bottom, top = borders
    lamp = texel_lamp(left, right, bottom, top)
    u = torch.rand(20, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    t = u.view(4, 5)

    def intensity(row: float, col: float) -> float:
        """Of the direction at continuous texture coordinates; texel (r, c) covers r..r + 1, c..c + 1."""
        point = torch.tensor([[1.0], [left + col / 5 * (right - left)], [top + row / 4 * (bottom - top)]], dtype=torch.float64)
        toward = tuple((-point[:, 0] / point.norm()).tolist())
        return light_on(surface_at(point, toward), torch.eye(4, dtype=torch.float64), lamp, u).item() * point.square().sum().item()

    for at in ((1.5, 2.5), (2.0, 2.5), (1.75, 2.75), (0.1, 0.2), (3.9, 2.5), (3.9, 4.9)):  # texel centres are at integer + 1/2
        (expected,) = map_coordinates(t, np.array(at)[:, None] - 0.5, order=1, mode="nearest")
        assert intensity(*at) == pytest.approx(expected, rel=1e-9)
    assert intensity(-0.01, 2.5) == intensity(4.01, 2.5) == intensity(2.5, -0.01) == intensity(2.5, 5.01) == 0


def test_a_box_throws_a_shadow_as_long_as_its_height_asks():
    box = trimesh.creation.box(bounds=[[8, 0.1, 0], [9, 1.1, 0.5]])
    road = trimesh.Trimesh([[-5, -20, 0], [80, -20, 0], [80, 20, 0], [-5, 20, 0]], [[0, 1, 2], [0, 2, 3]])
    scene = Scene((Body("road", road), Body("box", box)))
    # The ray over the far upper edge falls 0.25 m in 9 m and meets the road at 27 m.
    x = torch.tensor([13.0, 20.0, 26.5, 27.5, 40.0, 20.0])
    y = torch.tensor([0.6, 0.6, 0.6, 0.6, 0.6, 2.5])
    points = surface_at(torch.stack([x, y, torch.zeros(6)]), (0.0, 0.0, 1.0))
    lit = lit_surface(points, LAMP, T_LEFT, scene.at(0.0))
    assert lit.index.tolist() == [3, 4, 5]
    free = lit_surface(points, LAMP, T_LEFT)
    assert_close(lit.factor, free.factor[3:])


@pytest.fixture(scope="module")
def folded() -> tuple:
    lit = lit_surface(flat_road(camera(160, 90), 0.2), LAMP, T_LEFT)
    return lit, transport(lit, LAMP, 160)


def test_transport_equals_the_plain_path(folded):
    lit, folded_transport = folded
    u = torch.rand(3, LAMP.n_pixels, generator=torch.Generator().manual_seed(4))
    actual, index = folded_transport.luminance(u)
    # At most eight float32 products a pixel, none negative: some 1e-6.
    assert_close(actual, luminance(lit, LAMP.light_texture(u)), rtol=1e-5, atol=0)
    assert torch.equal(index, lit.index)


@pytest.mark.parametrize(
    "band", [slice(0, 640), slice(330, 331), slice(300, 420), slice(0, 32), slice(639, 640), slice(0, 0), slice(640, 640)]
)
def test_banded_light_equals_whole_light(folded, band):
    _, folded_transport = folded
    u = torch.zeros(LAMP.n_pixels)
    u[band] = torch.rand(u[band].shape, generator=torch.Generator().manual_seed(5))
    image, expected = torch.zeros(2, 160 * 90)
    part, index = folded_transport.luminance(u, band)
    image[index] = part
    whole, index = folded_transport.luminance(u)
    expected[index] = whole
    assert_close(image, expected, rtol=1e-6, atol=0)


def test_transport_passes_gradients(folded):
    lit, folded_transport = folded
    u = torch.full((2, LAMP.n_pixels), 0.5, requires_grad=True)
    folded_transport.luminance(u)[0].square().sum().backward()
    v = torch.full((2, LAMP.n_pixels), 0.5, requires_grad=True)
    luminance(lit, LAMP.light_texture(v)).square().sum().backward()
    assert_close(u.grad, v.grad, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("oversampling", [1, 3])
def test_the_direct_way_gives_what_the_matrix_gives(device, oversampling):
    view = camera(160, 90).with_rows(oversampling)
    road, T_world_lamp, headlight = flat_road(view, 0.2).to(device), T_LEFT.to(device), LAMP.to(device)
    box = Body("box", trimesh.creation.box(bounds=[[8, 0.1, 0], [9, 1.1, 0.5]]))
    triangles = Scene((box,)).at(0.0)
    u = torch.rand(3, headlight.n_pixels, generator=torch.Generator().manual_seed(1)).to(device)
    u[:, : headlight.n_pixels // 2] = 0
    base = torch.zeros(90, 160, device=device)
    lit = lit_surface(road, headlight, T_world_lamp, triangles)
    shadows = Shadows(road.position.flatten(1), T_world_lamp[:3, 3], triangles)
    direct = DirectTransport(road, headlight, T_world_lamp, shadows, view.width, oversampling)
    expected = added_light([transport(lit, headlight, view.width, oversampling)], [Light(u)], base)
    image = added_light([direct], [Light(u)], base)
    assert len(lit.index) < len(direct.surface.index), "nothing is in shadow"
    assert expected.max() > 0
    assert added_light([direct], [Light(u)], base, slice(40, 60)).equal(image[..., 40:60, :])
    assert torch.allclose(image, expected, rtol=1e-5, atol=1e-6 * float(expected.max()))  # sums of float32 in another order
    dark = direct.luminance(torch.zeros_like(u), slice(0, 0))
    assert dark[0].shape == (3, 0) and len(dark[1]) == 0
