"""Models stand on the ground, are closed to the eye, have heads, windscreens and lamps where others have them, and walk without sliding."""

import math

import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter

from luxloop.world.scene.body import Body, Figure
from luxloop.world.scene.vehicle import VehicleParams
from luxloop.world.traffic.figures import STRIDE, build, walker
from luxloop.world.traffic.generator import ARM_M, TrafficParams, random_tables, second_tables
from luxloop.world.traffic.models import MODELS, Model, ModelParams
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.traffic.solids import Capsule, blend, box, hull
from luxloop.world.traffic.tracked import EYES, ROAD_USERS

HERE = ({"position_m": (0.0, 0.0, 0.0)},)
AHEAD = {"points_m": ((0.0, 0.0, 0.0), (20.0, 0.0, 0.0)), "speed_m_s": 1.0}
# Length, width with mirrors, and height in m, at most: Directive 96/53/EC, DIN 18040 and usual sizes.
LARGEST = {
    "bus": (12.5, 3.0, 4.0),
    "lorry": (12.0, 3.1, 4.0),
    "tractor": (4.5, 2.8, 3.3),
    "wheelchair": (1.3, 0.75, 1.6),
    "pram": (2.2, 0.7, 2),
}


def body(model: Model, seed: int = 0, moves: bool = False, **keys: object) -> Body:
    item = {"kind": "model", "model": model, "name": "it", "seed": seed, **({"path": AHEAD} if moves else {"track": HERE}), **keys}
    made = TypeAdapter(ObjectParams).validate_python(item).build()
    return made.at(0.5) if isinstance(made, Figure) else made


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("moves", [False, True])
def test_bodies_stand_on_the_ground_and_look_outwards(model, moves):
    """Of rays from all around, only slivers and seams between parts may meet a face from behind."""
    for seed in range(3):
        mesh = body(model, seed, moves).mesh
        low, high = mesh.triangles.min((0, 1)), mesh.triangles.max((0, 1))
        assert -0.005 < low[2] < 0.015, "soles and paws are round"
        assert (high - low < LARGEST.get(model, (5.7, 2.3, 3.1))).all() and high[2] - low[2] > 0.4
        angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
        heights = low[2] + (high[2] - low[2]) * (np.arange(400) * 0.618 % 1)
        origins = np.stack([20 * np.cos(angle), 20 * np.sin(angle), heights], 1)
        middle = (low + high) / 2
        ways = np.stack([middle[0] - origins[:, 0], middle[1] - origins[:, 1], 0 * angle], 1) / 20
        faces = mesh.ray.intersects_first(origins, ways)
        hit = faces >= 0
        assert hit.mean() > 0.3, "a pram is seen through"
        outwards = (mesh.face_normals[faces[hit]] * ways[hit]).sum(1) < 0.05
        assert outwards.mean() > 0.98


def test_a_blend_is_where_its_capsules_are():
    """A capsule alone has the volume of a cylinder and a ball; two that cross make one body, of two parts."""
    a, b = np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    (piece,) = blend([Capsule("a", a, b, 0.1, 0.1)], 0.03, 0.01)
    mesh = trimesh.Trimesh(piece.vertices, piece.faces)
    assert mesh.is_watertight and mesh.volume == pytest.approx(math.pi * 0.01 + 4 / 3 * math.pi * 0.001, rel=0.03)
    assert np.abs(np.linalg.norm(piece.vertices[:, :2], axis=1)[np.abs(piece.vertices[:, 2] - 0.5) < 0.4] - 0.1).max() < 1e-3
    parts = blend([Capsule("a", a, b, 0.1, 0.1), Capsule("b", (a + b) / 2, (a + b) / 2 + (1.0, 0, 0), 0.1, 0.05)], 0.03, 0.01)
    joined = trimesh.Trimesh(parts[0].vertices, np.concatenate([each.faces for each in parts]))
    assert [each.part for each in parts] == ["a", "b"] and joined.is_watertight and joined.body_count == 1
    for solid in (box("a", (0, 0, 0), (1, 2, 3), 0.01), hull("a", [(0, 0, 0), (6, 0, 0), (0, 1, 0), (0, 0, 6)])):
        assert trimesh.Trimesh(solid.vertices, solid.faces).volume == pytest.approx(6, rel=0.01)


def test_feet_on_the_ground_do_not_slide():
    who = build(np.random.default_rng(0))

    def heel_x(phase: float) -> float:
        """Of the left foot, which is on the ground in the first half of a stride."""
        shoes = next(each for each in walker(who, phase) if each.part == "shoes")
        feet = shoes.vertices[np.unique(shoes.faces)]
        return float(feet[feet[:, 1] > 0, 0].min())

    way = STRIDE * who.height_m
    assert heel_x(0.05) - heel_x(0.35) == pytest.approx(0.3 * way, abs=0.005)


@pytest.mark.parametrize(("model", "category", "part"), [("coat", "pedestrian", "head"), ("bicycle", "cyclist", "head")])
def test_people_are_known_by_their_heads(model, category, part):
    made = {each.name for each in body(model).parts}
    assert part in made and EYES & made and MODELS[model][0] == category


def test_vehicles_have_windscreens_and_lamps_that_can_be_off():
    for model in ("microcar", "pickup", "lorry", "bus", "tractor"):
        lit, dark = body(model), body(model, lit=False)
        low, high = lit.mesh.triangles.min((0, 1)), lit.mesh.triangles.max((0, 1))
        ahead = np.array([(20.0, y, z) for y in np.linspace(low[1], high[1], 30) for z in np.linspace(low[2], high[2], 30)])
        faces = lit.mesh.ray.intersects_first(ahead, np.tile([-1.0, 0.0, 0.0], (len(ahead), 1)))
        assert lit.part_of_face is not None
        seen = [lit.parts[part].name for part in lit.part_of_face[faces[faces >= 0]].tolist()]
        assert seen.count("windscreen") > 0.2 * len(seen)
        assert len(lit.spotlights) == 4 and not dark.spotlights
        assert max(float(each.position[0]) for each in lit.spotlights) > 0 > min(float(each.position[0]) for each in lit.spotlights)


def test_nothing_on_a_poster_or_a_pedestal_can_be_dazzled():
    for model in ("poster", "statue"):
        assert not EYES & {each.name for each in body(model).parts}


def test_the_category_is_the_models_unless_given():
    for keys, category in (({"model": "bus"}, "truck"), ({"model": "statue"}, None), ({"model": "estate", "category": None}, None)):
        table = {"name": "a", "kind": "model", "track": HERE, **keys}
        assert ModelParams.model_validate(table).category == ModelParams.of(**table).category == category
    assert {category for category, *_ in MODELS.values()} <= {None, "animal", *ROAD_USERS}


def test_both_populations_have_no_kind_in_common():
    mine, theirs = (
        TrafficParams(seed=4, population=name, pedestrians=6, cyclists=3, cars=2, animals=1).objects() for name in ("first", "second")
    )
    assert {each.kind for each in theirs} == {"model"} and "model" not in {each.kind for each in mine}


@pytest.mark.parametrize("drives", [False, True])
def test_company_walks_at_the_left_hand(drives):
    traffic = TrafficParams(seed=1, population="second", pedestrians=8, far_m=40)
    vehicle = VehicleParams(course=({"speed_m_s": 10.0},))
    items = {each.name: each for each in (traffic.along(vehicle, 4.0) if drives else traffic.objects())}
    couples = [name for name in items if f"{name}_company" in items]
    assert couples
    for name in couples:
        one, other = (items[each].pose_track() for each in (name, f"{name}_company"))
        for t in (one.times_s[0], one.times_s[-1]):
            beside = one.pose_at(t)[:3, :3].T @ (other.pose_at(t)[:3, 3] - one.pose_at(t)[:3, 3])
            assert beside.tolist() == pytest.approx([0, ARM_M, 0], abs=0.01)


def test_worlds_of_the_second_population_drive_and_differ():
    worlds = [second_tables(seed) for seed in range(40)]
    speeds = [each["speed_m_s"] for world in worlds for each in world["vehicle"]["course"]]
    assert min(speeds) >= 5 and max(speeds) <= 20
    assert 5 < sum(world["conditions"][0]["wet"] for world in worlds) < 30
    assert sum(any(each["curvature_1_m"] for each in world["vehicle"]["course"]) for world in worlds) > 15
    assert worlds[3] == second_tables(3) != random_tables(3)
