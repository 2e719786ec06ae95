import gc

import numpy as np
import pytest
import torch
import trimesh
from torch.nn.functional import max_pool2d

from luxloop.world.frames import View, pose_from_degrees
from luxloop.world.materials.library import Texture
from luxloop.world.rendering import rasterise
from luxloop.world.rendering.gbuffer import GBuffer, gbuffer
from luxloop.world.rendering.rasterise import NoOpenGL
from luxloop.world.rendering.raycast import RayCaster, depths, first_hits, hits_on
from luxloop.world.rendering.surfaces import FaceSource, face_source
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.embree import EmbreeMesh
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import Instance, Triangles
from luxloop.world.traffic.objects import BoxParams
from tests.world.grids import bumpy, camera, flat, grid, lamp


@pytest.fixture(params=["opengl", "raycast"])
def source(request: pytest.FixtureRequest) -> FaceSource:
    try:
        return face_source(request.param)
    except NoOpenGL as error:
        pytest.skip(str(error))


def see(scene: Scene, view: View, source: FaceSource, t_s: float = 0.0) -> GBuffer:
    triangles = scene.at(t_s)
    return gbuffer(triangles, view, source.face_ids(triangles, view))


def box(x_m: float = 14.0, **keys) -> Body:
    params = {"name": "box", "size_m": (1, 1, 1), "albedo": 0.05, "track": [{"position_m": (x_m, 0.3, 0), "yaw_deg": 30}]}
    return BoxParams(**(params | keys)).build()


@pytest.mark.parametrize("view", [camera(), camera(pitch_deg=10), lamp(256, 128)], ids=["camera", "pitched", "off-centre, oblong pixels"])
def test_a_flat_road_lies_where_it_must(source, view):
    seen = see(Scene((Body("road", flat(500), albedo=0.3),)), view, source)
    rays = view.rays()
    depth = -view.origin[2] / rays[2]
    exact = view.origin[:, None, None] + depth * rays
    expected = (rays[2] < 0) & (exact[0] < 500) & (exact[1].abs() < 10)
    border = (exact[0] > 499) | (exact[1].abs() > 9.9)
    assert torch.equal((seen.object_id == 0)[~border], expected[~border])
    near = expected & (exact[0] < 200)
    assert near.sum() > 5000
    # float32 of 200 m is good to 1e-5 m
    assert ((seen.position - exact).norm(dim=0)[near] < 1e-4).all()
    assert torch.equal(seen.normal[:, near], torch.tensor([0.0, 0.0, 1.0])[:, None].expand(-1, int(near.sum())))
    assert (seen.albedo[near] == 0.3).all()
    sky = seen.object_id < 0
    assert (seen.position[:, sky] == 0).all() and (seen.normal[:, sky] == 0).all() and (seen.albedo[sky] == 0).all()


def test_opengl_and_rays_agree():
    try:
        opengl = face_source("opengl")
    except NoOpenGL as error:
        pytest.skip(str(error))
    scene = Scene((Body("road", bumpy(), smooth=True), box(), box(9.0, size_m=(0.3, 0.4, 0.2), name="kerbstone")))
    view = camera(640, 360)
    a, b = see(scene, view, opengl), see(scene, view, RayCaster())
    depth = ((a.position - view.origin[:, None, None].float()) * view.T_world_view[:3, 2].float()[:, None, None]).sum(0)

    def spread(image: torch.Tensor) -> torch.Tensor:
        image = image.float()[None]
        return (max_pool2d(image, 3, 1, 1) + max_pool2d(-image, 3, 1, 1))[0]

    inner = (a.object_id >= 0) & (spread(a.object_id) == 0) & (spread(depth) < 0.1 * depth)
    assert inner.sum() > 0.9 * (a.object_id >= 0).sum()
    off = (a.position - b.position).norm(dim=0) > 1e-3
    turned = (a.normal - b.normal).norm(dim=0) > np.radians(0.5)
    # the rest are crests of bumps whose step in depth is less than a tenth
    assert ((off | turned) & inner).sum() < 1e-3 * inner.sum()
    assert torch.equal(a.object_id[inner], b.object_id[inner])


def test_bodies_move_appear_and_vanish_under_their_own_id(source):
    passing = box(track=[{"time_s": 0, "position_m": (12, 1, 0)}, {"time_s": 1, "position_m": (12, -1, 0)}], vanishes_s=2.0)
    late = box(track=[{"position_m": (20, 2, 0)}], appears_s=1.0)
    scene = Scene((Body("road", flat()), passing, late))
    view = camera()

    def column(seen: GBuffer, object_id: int) -> float:
        return torch.nonzero(seen.object_id == object_id)[:, 1].float().mean().item()

    start, middle, end = (see(scene, view, source, t) for t in (0.0, 1.0, 2.0))
    assert start.object_id.unique().tolist() == [-1, 0, 1]
    assert middle.object_id.unique().tolist() == [-1, 0, 1, 2]
    assert end.object_id.unique().tolist() == [-1, 0, 2]
    assert column(start, 1) < 160 < column(middle, 1)
    # back where it was: the same picture, whatever was drawn between
    again = see(scene, view, source, 0.0)
    assert torch.equal(start.position, again.position) and torch.equal(start.normal, again.normal)


def test_albedo_comes_from_the_texture_in_the_bodys_frame(source):
    # a chequered tile: bright for x in [0, 2), y in [0, 1) of the body frame, which is turned by 90 deg in the world
    tile = torch.tensor([[0.8, 0.1], [0.8, 0.1], [0.1, 0.1], [0.1, 0.1]])
    texture = Texture(tile.repeat_interleave(50, 0).repeat_interleave(50, 1), texel_m=0.02)
    turned = PoseTrack.static(pose_from_degrees((15, 0, 0), yaw_deg=90))
    road = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    seen = see(Scene((Body("road", road, texture=texture, track=turned),)), camera(), source)
    x, y, _ = seen.position
    body_x, body_y = y % 4, (15 - x) % 2
    bright = (body_x < 2) & (body_y < 1)
    clear = (seen.object_id == 0) & ((body_x % 2 - 1).abs() < 0.98) & ((body_y % 1 - 0.5).abs() < 0.48)
    assert clear.sum() > 3000
    assert torch.allclose(seen.albedo[clear], torch.where(bright, 0.8, 0.1)[clear])


def test_a_sheet_is_seen_from_its_back_if_two_sided(source):
    facing_away = trimesh.Trimesh([[10, -1, 0], [10, 1, 0], [10, 1, 2], [10, -1, 2]], [[0, 1, 2], [0, 2, 3]])
    seen = see(Scene((Body("sheet", facing_away, two_sided=True),)), camera(), source)
    on = seen.object_id == 0
    assert on.sum() > 1000
    assert torch.equal(seen.normal[:, on].unique(dim=1), torch.tensor([[-1.0], [0.0], [0.0]]))


def test_auto_falls_back_to_rays_with_a_warning(monkeypatch):
    monkeypatch.setenv("PYOPENGL_PLATFORM", "none")
    monkeypatch.setattr(rasterise, "_context", rasterise._context.__wrapped__)
    with pytest.warns(UserWarning, match="ray casting"):
        assert isinstance(face_source("auto"), RayCaster)
    with pytest.raises(NoOpenGL, match="libegl1"):
        face_source("opengl")


def test_embree_forgets_a_body_with_its_last_use():
    """It has no room for more than about 1,000, which a run of many scenes reaches before the garbage collector comes."""

    def scenes() -> int:
        return sum(isinstance(each, EmbreeMesh) for each in gc.get_objects())

    gc.collect()
    gc.disable()
    try:
        before = scenes()
        triangles = Scene((box(),)).at(0.0)
        assert first_hits(triangles, torch.zeros(3).double(), torch.tensor([[14.0], [0.3], [0.5]]).double()) >= 0
        assert scenes() == before + 1
        del triangles
        assert scenes() == before
    finally:
        gc.enable()


def test_a_part_equals_that_part_of_the_whole(source):
    """OpenGL rounds corners by the viewport's size: a smaller one moves samples on a bumpy road by up to 15 um."""
    triangles, view, part = Scene((Body("road", bumpy(), smooth=True), box())).at(0.0), camera(), (slice(33, 130), slice(71, 202))
    assert torch.equal(source.face_ids(triangles, view, part), source.face_ids(triangles, view)[part])


def test_a_box_shows_its_faces(source):
    seen = see(Scene((Body("road", flat()), box())), camera(), source)
    on_box = seen.object_id == 1
    assert on_box.sum() > 300
    assert (seen.albedo[on_box] == 0.05).all()
    yaw = np.radians(30)
    faces = torch.tensor([[-np.cos(yaw), -np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]], dtype=torch.float32)
    assert ((seen.normal[:, on_box].T @ faces.T).amax(1) > 1 - 1e-6).all()
    local = pose_from_degrees((14, 0.3, 0), yaw_deg=30)
    p = local[:3, :3].T @ (seen.position[:, on_box].double() - local[:3, 3:])
    distance = (p - torch.tensor([[0], [0], [0.5]])).abs().amax(0) - 0.5
    assert distance.abs().max() < 1e-4


def test_each_pixel_sees_a_face_that_its_ray_goes_through(source):
    """Small faces, of which a corner that OpenGL snaps to 1/256 px is much: beside them, light would be that of no place on the road."""
    x, y = np.linspace(-5, 30, 1500), np.linspace(-6, 6, 400)
    rough = grid(lambda x, y: np.random.default_rng(0).normal(0, 0.003, x.shape), x, y)
    triangles, view = Scene((Body("road", rough, smooth=True),)).at(0.0), camera()
    face_ids = source.face_ids(triangles, view).flatten()
    hits = list(hits_on(triangles, face_ids, view.origin, view.rays().flatten(1)))
    assert len(torch.cat([each.pixels for each in hits]).unique()) == (face_ids >= 0).sum() > 0.5 * len(face_ids)
    assert min(float(each.barycentric.min()) for each in hits) >= -1e-4


def test_bodies_cast_at_together_are_met_as_alone():
    """Far from the world's origin, turned, from within some of them, which one sees out of, and with sheets among them."""
    generator = torch.Generator().manual_seed(5)
    places = torch.rand(12, 6, generator=generator, dtype=torch.float64)
    eye = torch.tensor([2000.0, -1000.0, 3.0]).double()
    bodies = []
    for k, numbers in enumerate(places):
        x, y, z, *angles = numbers.tolist()
        T = pose_from_degrees((2000 + 8 * (x - 0.5), -1000 + 8 * (y - 0.5), 3 + 8 * (z - 0.5)), *(360 * a for a in angles))
        mesh = trimesh.creation.box((4.0, 3.0, 2.0)) if k % 3 else trimesh.Trimesh([[0, 0, 0], [0, 3, 0], [0, 0, 3]], [[0, 1, 2]])
        bodies.append(Instance(k, Body(f"body {k}", mesh, two_sided=not k % 3), T))
    rays = torch.randn(3, 4000, generator=generator, dtype=torch.float64)
    together = Triangles.of(*bodies)
    alone = torch.stack([depths(each, first_hits(each, eye, rays), eye, rays) for each in map(Triangles.of, bodies)])
    face = first_hits(together, eye, rays)
    met = depths(together, face, eye, rays)
    assert 0.2 < (face >= 0).double().mean() < 1
    same = torch.isclose(met, alone.amin(0), rtol=0, atol=1e-9) | (met == alone.amin(0))
    assert same.double().mean() > 0.998  # but for rays through an edge, within embree's float32
