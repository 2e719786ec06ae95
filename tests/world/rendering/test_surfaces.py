"""What OpenGL interpolates against exact intersections, and a view that moves against a world that does."""

from dataclasses import replace
from functools import cache

import pytest
import torch

from luxloop.world.frames import View, inverse, pose_from_degrees, transform
from luxloop.world.materials.library import RoadSurfaceParams
from luxloop.world.rendering.deferred import DeferredRenderer
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.rendering.rasterise import NoOpenGL
from luxloop.world.rendering.raycast import RayCaster, sees
from luxloop.world.rendering.surfaces import ExactSurfaces, QuickSurfaces, SurfaceSource
from luxloop.world.scene.body import Body, PoseTrack
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import NOTHING, Triangles
from luxloop.world.traffic.objects import BoxParams
from tests.world.grids import bumpy, camera, lamp

SURFACE = RoadSurfaceParams(markings=True, beads=True)


@pytest.fixture(params=["exact", "quick"])
def surfaces(request: pytest.FixtureRequest) -> SurfaceSource:
    return ExactSurfaces(RayCaster()) if request.param == "exact" else quick()


def quick() -> QuickSurfaces:
    try:
        return QuickSurfaces(DeferredRenderer())
    except NoOpenGL as error:
        pytest.skip(str(error))


@cache
def bodies() -> tuple[Body, ...]:
    """A bumpy road with paint, a box and a two-sided sheet."""
    box = BoxParams(name="box", size_m=(1, 1, 1), albedo=0.05, track=[{"position_m": (14, 0.3, 0), "yaw_deg": 30}]).build()
    road = Body("road", bumpy(), 0.2, SURFACE.texture(), smooth=True, ground=True)
    sheet = replace(box, name="sheet", two_sided=True, track=PoseTrack.static(pose_from_degrees((20.0, -2.0, 0.5), yaw_deg=70)))
    return road, box, sheet


def scene(T_moved: torch.Tensor | None = None) -> Scene:
    """The bodies, all of them moved."""
    T = torch.eye(4, dtype=torch.float64) if T_moved is None else T_moved
    return Scene(tuple(replace(body, track=PoseTrack.static(T @ body.track.pose_at(0.0))) for body in bodies()))


def both(triangles: Triangles, view: View) -> tuple[GBuffer, GBuffer]:
    """Surfaces as rays find them, and as the quick way does."""
    return ExactSurfaces(RayCaster()).gbuffer(triangles, view), quick().gbuffer(triangles, view)


def test_the_quick_way_sees_what_the_exact_one_sees():
    triangles, view = scene().at(0.0), camera()
    exact, fast = both(triangles, view)
    same = exact.object_id == fast.object_id
    # outlines, at which a ray passes a corner that is snapped to 1/256 px
    assert same.float().mean() > 0.999 and set(fast.object_id.unique().tolist()) == {-1, 0, 1, 2}
    seen = same & (exact.object_id >= 0)
    distance = (exact.position - view.origin[:, None, None]).norm(dim=0)
    apart = ((exact.position - fast.position).norm(dim=0) / distance)[seen]
    # float32 along a grazing ray; where bumps hide each other a ray may also meet the next one
    assert apart.quantile(0.99) < 1e-5 and (apart < 1e-3).float().mean() > 0.998
    on_same = seen & ((exact.position - fast.position).norm(dim=0) < 1e-3 * distance)
    assert (exact.normal - fast.normal).norm(dim=0)[on_same].quantile(0.99) < 1e-3
    assert (exact.albedo - fast.albedo).abs()[on_same].mean() < 1e-3
    assert exact.finish is not None and fast.finish is not None and exact.finish.materials == fast.finish.materials
    assert (exact.finish.material == fast.finish.material)[on_same].float().mean() > 0.999
    nothing = fast.object_id < 0
    assert not fast.position[:, nothing].any() and not fast.normal[:, nothing].any() and not fast.albedo[nothing].any()


def test_far_from_the_origin_of_the_world_smooth_bumps_shade_no_points_more():
    T, view = pose_from_degrees((1500.0, 0.0, 0.0)), camera()
    mesh = bumpy().apply_translation((1500.0, 0.0, 0.0))
    triangles, lamp_m = Scene((Body("road", mesh, smooth=True, ground=True),)).at(0.0), lamp().origin + T[:3, 3]
    view = replace(view, T_world_view=T @ view.T_world_view)
    exact, fast = both(triangles, view)
    away = lamp_m.float()[:, None, None] - exact.position
    facing = (exact.object_id == 0) & (fast.object_id == 0) & ((exact.normal * away).sum(0) > 0) & (away[0] < -3)
    in_light, found = (sees(triangles, lamp_m, each.position[:, facing]) for each in (exact, fast))
    # positions are float32: 0.06 mm at 1,500 m, so that a few rays that graze a bump take the other side
    assert (~in_light).sum() > 100 and (in_light & ~found).sum() <= 5


def test_what_stands_still_is_seen_the_same_in_every_further_look():
    """A body that moves, one that goes, and one that comes, before and behind what stands."""
    road, box, sheet = bodies()
    moving = replace(box, track=PoseTrack((0.0, 3.0), torch.stack([pose_from_degrees((x, -3.0 + 6 * (x < 15), 0)) for x in (12.0, 25.0)])))
    going, coming = (replace(sheet, track=replace(sheet.track, **life)) for life in ({"vanishes_s": 1.5}, {"appears_s": 1.5}))
    world, again, view = Scene((road, moving, going, box, coming)), quick(), camera()
    triangles = NOTHING
    for t_s in (0.0, 0.5, 1.0, 1.5, 2.0, 2.0, 3.0):
        triangles = world.at(t_s, before=triangles)
        seen, fresh = (way.gbuffer(triangles, view) for way in (again, quick()))
        same = seen.object_id == fresh.object_id  # but where depths are equal to 24 bits, at a foot on the road
        assert same.float().mean() > 0.9999 and set(seen.object_id.unique().tolist()) == set(fresh.object_id.unique().tolist())
        assert torch.equal(seen.position[:, same], fresh.position[:, same]) and torch.equal(seen.normal[:, same], fresh.normal[:, same])
        assert torch.equal(seen.albedo[same], fresh.albedo[same])


def test_a_thin_wall_shades_what_stands_close_behind_it():
    """6 cm, 30 times the tolerance by which a surface lies before itself."""
    wall = BoxParams(name="wall", size_m=(0.02, 1, 1), track=[{"position_m": (9.95, 0, 0)}]).build()
    points = torch.tensor([[10.0, 10.0], [0.0, 2.0], [0.3, 0.3]])  # behind it and beside it
    triangles, eye = Scene((wall,)).at(0.0), torch.tensor([0.0, 0, 0.6]).double()
    assert sees(triangles, eye, points).tolist() == [False, True]
    nowhere = torch.tensor([[10.0], [torch.nan], [0.3]])
    several = torch.stack([torch.cat([points, nowhere], 1), torch.cat([nowhere, points], 1)])
    assert sees(triangles, eye, several).tolist() == [[False, True, False], [False, False, True]]


def test_the_quick_way_finds_the_same_points_in_shadow():
    triangles, view, lamp_m = scene().at(0.0), camera(), lamp().origin
    exact, fast = both(triangles, view)
    road = (exact.object_id == 0) & (fast.object_id == 0) & (exact.position[0] > 3)
    in_light, found = (sees(triangles, lamp_m, each.position[:, road]) for each in (exact, fast))
    assert 0.01 < (~in_light).float().mean() < 0.9  # there are shadows
    # where bumps hide each other a ray may meet the next one, as above
    assert (in_light == found).float().mean() > 0.998


def test_one_sees_out_of_a_closed_box_and_not_into_it():
    box = BoxParams(name="box", size_m=(2, 2, 2), track=[{"position_m": (5, 0, 0)}]).build()
    within, beyond = torch.tensor([5.0, 0.1, 1.0]).double(), torch.tensor([9.0, 0.2, 1.1]).double()
    triangles = Scene((box,)).at(0.0)
    assert sees(triangles, within, beyond[:, None]).all() and not sees(triangles, beyond, within[:, None]).any()


def test_a_view_that_moves_sees_what_a_standing_one_sees_of_a_world_that_moves_the_other_way(surfaces):
    T = pose_from_degrees((3.0, -0.4, 0.05), 1.0, 0.7, 4.0)
    view = camera()
    moved = surfaces.gbuffer(scene().at(0.0), replace(view, T_world_view=T @ view.T_world_view))
    standing = surfaces.gbuffer(scene(inverse(T)).at(0.0), view)
    same = moved.object_id == standing.object_id
    assert same.float().mean() > 0.999  # rays that pass an edge within rounding
    seen = (same & (moved.object_id >= 0)).flatten()
    back = transform(inverse(T).float(), moved.position.flatten(1))[:, seen]
    away = (back - standing.position.flatten(1)[:, seen]).norm(dim=0)
    assert away.quantile(0.999) < 1e-3  # of 60 m, seen at a grazing angle in float32
    turned = inverse(T).float()[:3, :3] @ moved.normal.flatten(1)[:, seen]
    assert (turned - standing.normal.flatten(1)[:, seen]).norm(dim=0).quantile(0.999) < 1e-3
    assert (moved.albedo - standing.albedo).flatten()[seen].abs().quantile(0.99) < 1e-3
