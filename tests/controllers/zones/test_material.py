"""Light by material: from the camera's own place, every ray asks for the light of what the camera sees along it."""

import math
from dataclasses import replace

import pytest
import torch
from pydantic import ValidationError
from torch import Tensor
from torch.testing import assert_close

from luxloop.controllers.functions.material import MaterialParams, image_plane
from luxloop.controllers.functions.zone import box_region
from luxloop.controllers.pixels.primitives import Primitives
from luxloop.controllers.pixels.rthc import Setpoints, trace
from luxloop.controllers.situation import CameraImage, Situation, TrackedObject
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.frames import pose_from_degrees, transform
from luxloop.world.lamps.presets import idealised
from tests.refusal import refusal

HERE = torch.eye(4, dtype=torch.float64)
VIEW = camera_view(CameraParams(x_m=0.0, z_m=1.0, pitch_deg=2.0, width_px=320, height_px=180))
NAMES = ("asphalt", "lane_paint", "cloth", "skin")
LIGHTS = [
    {"materials": ["lane_paint"], "lx": 12.0},
    {"materials": ["asphalt"], "lx": 3.0},
    {"materials": ["cloth"], "luminance_cd_m2": 0.5},
]
BOX = torch.tensor([0.2, 0.6, 1.6], dtype=torch.float64)
EVA = TrackedObject("eva", "pedestrian", pose_from_degrees((15.0, 1.0, 0.0)), (0.2, 0.6, 1.6))


def seen() -> CameraImage:
    """A road with a line of paint along y = -1 to -0.6, and a box of cloth whose upper fifth is skin."""
    material = torch.zeros(180, 320, dtype=torch.int64)
    far = torch.tensor([[5.0, -1.0, 0.0], [60.0, -0.6, 0.0]], dtype=torch.float64)
    material[box_region(VIEW, HERE, far[0], far[1])] = 1
    low, high = torch.tensor([[-0.1, -0.3, 0.0], [0.1, 0.3, 1.6]], dtype=torch.float64)
    material[box_region(VIEW, EVA.T_world_object, low, high)] = 2
    material[box_region(VIEW, EVA.T_world_object, torch.tensor([-0.1, -0.3, 1.3]).double(), high)] = 3
    above = VIEW.rays()[2] >= 0
    material[above & (material < 2)] = -1
    albedo = torch.tensor([0.1, 0.6, 0.05, 0.4, 0.0])[material]
    return CameraImage(0.0, VIEW, torch.zeros(180, 320), albedo=albedo, material=material, materials=NAMES)


def situation(**more: object) -> Situation:
    return Situation(0.0, HERE, VIEW.origin[None], (EVA,), **more)


def drawn(function: MaterialParams, now: CameraImage) -> tuple[Primitives, ...]:
    return function.adapted(function.step(function.start(), situation(seen=now)), situation())


def seen_along_rays(picture: Tensor, points: Tensor) -> Tensor:
    """What the camera's picture shows of points `[3, N]`."""
    (u, v), _ = VIEW.project(points)
    return picture[v.long().clamp(0, 179), u.long().clamp(0, 319)]


def test_rays_ask_for_the_light_of_what_the_camera_sees_along_them():
    function, now = MaterialParams(lights=LIGHTS), seen()
    standing, lying = drawn(function, now)
    grid = idealised(120, 400)
    T = pose_from_degrees(VIEW.origin.tolist(), pitch_deg=2.0)
    for part, wanted in ((lying, {0: 3.0, 1: 12.0}), (standing, {2: math.pi * 0.5 / 0.05})):
        found: Setpoints = trace(part, grid, T)
        y, z = grid.tangents()
        rays = torch.einsum("ij,jrc->irc", T[:3, :3], torch.stack(torch.broadcast_tensors(torch.ones(1, 1).double(), y, z[:, None])))
        n, q = part.normal[0], part.origin[0] - VIEW.origin
        along = (q @ n) / torch.einsum("i,irc->rc", n, rays)
        points = (VIEW.origin[:, None, None] + along * rays).flatten(1)
        material = seen_along_rays(now.material, points).view(along.shape)
        distance = (along * rays).norm(dim=0)
        lx = found.value * (rays.norm(dim=0) ** -1 * torch.einsum("i,irc->rc", -n, rays)) / distance**2
        for number, light in wanted.items():
            of_it = (found.hit & (material == number)).double()
            of_it = -torch.nn.functional.max_pool2d(-of_it[None], 3, 1, 1)[0] > 0  # clear of borders, where rounding decides
            assert int(of_it.sum()) > 20
            assert_close(lx[of_it], torch.full_like(lx[of_it], light), rtol=1e-3, atol=0)
        others = ~torch.isin(material, torch.tensor(list(wanted)))
        alone = -torch.nn.functional.max_pool2d(-others.double()[None], 3, 1, 1)[0] > 0
        assert not bool((found.hit & alone).any())  # skin has no light here, and what stands is not lit by the road's picture


def test_the_first_light_that_is_meant_counts_and_albedo_chooses_too():
    now = seen()
    paint = MaterialParams(lights=[{"albedo": [0.5, 1.0], "lx": 9.0}, {"lx": 1.0}])
    state = paint.step(None, situation(seen=now))
    assert state.lx[now.material == 1].unique().tolist() == [9.0] and state.lx[now.material == 0].unique().tolist() == [1.0]
    assert bool(state.lx[now.material == -1].isnan().all())


def test_nothing_is_drawn_before_anything_is_seen_and_without_materials_it_is_refused():
    function = MaterialParams(lights=LIGHTS)
    assert function.adapted(function.start(), situation()) == ()
    assert len(drawn(function.model_copy(update={"road_m": None}), seen())) == 1
    with refusal("source of materials"):
        function.step(None, situation(seen=replace(seen(), material=None)))


def test_the_image_plane_is_the_cameras_image():
    eye, corner, right, down = image_plane(VIEW)
    assert_close(eye, VIEW.origin)
    points = torch.stack([corner, corner + right + down, corner + right / 2 + down / 2], 1)
    uv, _ = VIEW.project(transform(HERE, points))
    assert_close(uv.T, torch.tensor([[0, 0], [320, 180], [160, 90]], dtype=torch.float64), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    "light", [{"lx": 1.0, "luminance_cd_m2": 1.0}, {}, {"lx": 1.0, "albedo": [0.5, 0.5]}, {"lx": 1.0, "materials": ["velvet"]}]
)
def test_lights_that_are_none_are_refused(light):
    with pytest.raises(ValidationError):
        MaterialParams(lights=[light])
