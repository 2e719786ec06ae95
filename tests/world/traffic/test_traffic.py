"""Figures stand on the ground, walk without sliding, differ by their seeds, and look like what their parts are made of."""

import math

import numpy as np
import pytest
import torch
import trimesh
from pydantic import TypeAdapter, ValidationError

from luxloop.world.light.emitters import ambient_luminance
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.scene.body import SHAPES, Body
from luxloop.world.scene.scene import Scene
from luxloop.world.traffic.car import LOW_BEAM_CD, CarParams
from luxloop.world.traffic.generator import SIGHT, TrafficParams
from luxloop.world.traffic.objects import MeshParams, ObjectParams
from luxloop.world.traffic.people import SHANK, STRIDE, THIGH, PedestrianParams, riding, someone, walking
from luxloop.world.traffic.shapes import Piece, blob, block, ellipsoid, limb, tube
from luxloop.world.traffic.tracked import WayParams
from tests.refusal import refusal
from tests.world.grids import see

HERE = ({"position_m": (0.0, 0.0, 0.0)},)
KINDS = ["pedestrian", "cyclist", "motorcycle", "car", "animal", "traffic_sign", "clutter"]


def made(kind: str, seed: int = 0, **keys: object) -> Body:
    body = TypeAdapter(ObjectParams).validate_python({"kind": kind, "name": "it", "seed": seed, "track": HERE, **keys}).build()
    assert isinstance(body, Body)
    return body


def volume(piece: Piece) -> float:
    return float(trimesh.Trimesh(piece.vertices, piece.faces).volume)


def test_pieces_are_closed_and_seen_from_outside():
    """A volume is positive only where corners run counter-clockwise from outside; a polygon of n sides has n sin(2 pi/n) / 2 of r^2."""
    prism = 8 * math.sin(math.pi / 4) / 2
    assert volume(tube("a", [(0, 0, 0), (0, 0, 2)], [(0.5, 0.5)] * 2, (0, 1, 0), 8)) == pytest.approx(2 * prism * 0.25, rel=1e-9)
    for stop in ((1, 0, 0), (0, 1, 0), (-1, -1, 1), (0, 0, -1)):
        assert volume(limb("a", (0, 0, 0), stop, 0.1, 0.1)) > 0.9 * prism * 0.01 * np.linalg.norm(stop)
    ball = volume(ellipsoid("a", (1, 2, 3), (0.1, 0.2, 0.3), sides=32, rings=24))
    assert ball == pytest.approx(4 / 3 * math.pi * 0.006, rel=0.03)  # 32 sides and 24 rings miss some 2 %
    assert volume(block("a", (0, 0, 0), (1, 2, 3))) == pytest.approx(6)
    assert volume(blob("a", (0, 0, 0), (1, 1, 1), np.random.default_rng(0))) > 3


def test_a_walker_does_not_slide():
    """From the foot's landing to its leaving it goes back under the body as far as the body goes ahead, half a stride."""
    who = someone(np.random.default_rng(0), 1.8, None)
    ankle = np.stack([walking(who, phase).ankle[0] - walking(who, phase).hips for phase in (0.25, 0.75)])
    assert ankle[0, 0] - ankle[1, 0] == pytest.approx(STRIDE / 2 * 1.8, rel=0.1)  # of an eighth, that a foot rolls
    for k in range(16):
        joints = walking(who, k / 16)
        assert np.allclose(np.linalg.norm(joints.knee - joints.hip, axis=1), THIGH * 1.8)
        assert np.allclose(joints.ankle, walking(who, k / 16 + 0.5).ankle[::-1] * [1, -1, 1])  # the other leg, half a stride later


def test_a_rider_keeps_the_bones_and_feet_on_the_pedals():
    who = someone(np.random.default_rng(0), 1.7, None)
    for k in range(8):
        joints = riding(who, k / 8, 0.5)
        assert np.allclose(np.linalg.norm(joints.knee - joints.hip, axis=1), THIGH * 1.7)
        # a leg may be stretched out a little where the pedal is farthest
        assert np.linalg.norm(joints.ankle - joints.knee, axis=1) == pytest.approx(SHANK * 1.7, rel=0.03)


def test_a_figure_walks_with_its_way_and_is_made_anew_only_when_it_changes():
    path = {"points_m": ((10, 0, 0), (20, 0, 0)), "speed_m_s": 1.0, "start_s": 1.0}
    figure = PedestrianParams(name="eva", path=path, height_m=1.8).build()
    scene, stride_s = Scene((figure,)), STRIDE * 1.8
    assert figure.at(0.0) is figure.at(1.0) and scene.key_at(0.0) == scene.key_at(0.5)
    assert figure.at(1.0) is figure.at(1.0 + stride_s) and figure.at(1.0) is not figure.at(1.0 + stride_s / 2)
    assert len({id(figure.at(1 + stride_s * k / 64)) for k in range(64)}) == SHAPES
    low, high = figure.bounds
    corners = torch.cat([figure.at(1 + stride_s * k / SHAPES).corners.flatten(0, 1) for k in range(SHAPES)])
    assert low.equal(corners.amin(0)) and high.equal(corners.amax(0))
    walked = scene.at(1.0 + stride_s / 2).placed[0]
    assert walked.body is figure.at(1.0 + stride_s / 2)
    assert float(walked.corners[..., 0].mean()) == pytest.approx(10 + stride_s / 2, abs=0.1)


def test_a_path_keeps_its_speed_and_looks_ahead():
    path = WayParams(points_m=((0, 0, 0), (10, 0, 0), (10, 10, 0)), speed_m_s=2.0, start_s=3.0)
    track = PedestrianParams(name="eva", path=path).pose_track()
    times, places = np.array(track.times_s), track.T_world_body[:, :3, 3].numpy()
    assert np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times) == pytest.approx(2.0)
    assert np.abs(places - [10, 0, 0]).sum(1).min() < 0.3  # poses are every 0.5 m
    steps, ahead = np.diff(places, axis=0), track.T_world_body[:-1, :2, 0].numpy()
    turned = (steps[:, :2] * ahead).sum(1) / np.linalg.norm(steps, axis=1)
    assert turned.min() > 0.97 and track.travelled_m(4.0) == pytest.approx(2.0)


def test_an_unknown_part_is_told_with_the_nearest():
    with refusal("object 'it': parts: there is no part 'jaket'; did you mean 'jacket'"):
        made("pedestrian", parts={"jaket": {"albedo": 0.5}})


def test_parts_are_seen_as_they_are_given():
    body = made("pedestrian", 2, stance="standing", parts={"jacket": {"albedo": 0.77}, "head": {"material": "metal"}})
    moved = Scene((body,)).at(0.0).placed[0]
    seen = see(_at(body, 9.0))
    names = [part.name for part in moved.body.parts]
    jacket, head = (seen.part == names.index(name) for name in ("jacket", "head"))
    here = seen.object_id == 0
    assert jacket[here].sum() > 50 and seen.albedo[jacket & here].unique().tolist() == pytest.approx([0.77])
    assert (head & here).any() and not seen.part[~here].any()
    row = torch.arange(seen.part.shape[0])[:, None].expand_as(seen.part)
    assert row[head & here].max() < row[jacket & here].float().mean()  # the head is on top
    metal = seen.finish.material[head & here].unique()
    assert [seen.finish.materials[int(number)].f0 for number in metal] == [0.5]


def _at(body: Body, x_m: float) -> Body:
    track = PedestrianParams(name="it", track=({"position_m": (x_m, 0.0, 0.0), "yaw_deg": 180},)).pose_track()
    return Body(body.name, body.mesh, smooth=True, track=track, parts=body.parts, part_of_face=body.part_of_face)


def test_lamps_of_a_car_shine_and_light_what_is_before_them():
    params = {"name": "car", "style": "saloon", "track": ({"position_m": (20.0, 0.0, 0.0), "yaw_deg": 180},)}
    lit, parked = CarParams(**params).build(), CarParams(**params, lit=False).build()
    scene = Scene((lit,))
    seen = see(lit)
    assert float(ambient_luminance(seen, 0.0).max()) == pytest.approx(3e4)
    assert not ambient_luminance(see(parked), 0.0).any() and not parked.spotlights
    # a white plate square to the axis of a headlamp, 5 m before it
    lamp = scene.spotlights_at(0.0)[0]
    point = (lamp.position + 5 * lamp.axis).float()
    plate = GBuffer(point[:, None, None], -lamp.axis.float()[:, None, None], torch.ones(1, 1), torch.ones(1, 1, dtype=torch.int32))
    assert float(ambient_luminance(plate, 0.0, (), (lamp,))) == pytest.approx(LOW_BEAM_CD / 25 / math.pi, rel=1e-4)
    assert lamp.axis[0] < -0.99 and 17 < float(lamp.position[0]) < 18.2  # it comes towards us


def test_no_face_of_a_car_lies_in_another_parts():
    """Of two faces at one place rounding decides which is seen."""
    body = made("car")
    assert body.part_of_face is not None
    a, b, c = body.corners.unbind(1)  # [F, 3] each
    normal = torch.linalg.cross(b - a, c - a)
    normal = normal / normal.norm(dim=1, keepdim=True).clamp(min=1e-12)
    middles = body.corners.mean(1)  # of the faces, [F, 3]
    middles = middles[:, None]
    beside = ((middles - a) * normal).sum(-1).abs() < 1e-6  # in the plane of another face, m, [F, F]
    beside &= body.part_of_face[:, None] != body.part_of_face
    inside = torch.stack(
        [(torch.linalg.cross((v - u).expand(len(a), -1, -1), middles - u) * normal).sum(-1) for u, v in ((a, b), (b, c), (c, a))]
    )
    assert not (beside & (inside > 0).all(0)).any()


def test_traffic_comes_from_its_seed_in_sight_and_with_room():
    params = TrafficParams(seed=5, pedestrians=6, cyclists=3, cars=2, parked=3, animals=1, signs=2, clutter=8)
    objects = params.objects()
    assert objects == params.objects() and objects != params.model_copy(update={"seed": 6}).objects()
    assert len({each.name for each in objects}) == len(objects) > 15
    places = np.array([each.pose_track().pose_at(0.0)[:2, 3].tolist() for each in objects])
    assert (np.abs(places[:, 1]) <= SIGHT * places[:, 0] + 1e-3).all()
    assert (places[:, 0] > params.near_m - 1e-3).all() and (places[:, 0] < params.far_m + 1e-3).all()
    apart = np.linalg.norm(places[:, None] - places, axis=-1) + 100 * np.eye(len(places))
    assert apart.min() > 1.0  # two pedestrians, half a metre each
    standing = params.model_copy(update={"moving": False})
    assert not any(len(each.pose_track().times_s) > 1 for each in standing.objects())
    assert any(len(each.pose_track().times_s) > 1 for each in objects)
    uphill = params.model_copy(update={"on_road": True}).objects()
    assert uphill == tuple(each.model_copy(update={"on_road": True}) for each in objects) != objects
    assert TrafficParams(pedestrians=0, cyclists=0, cars=0, parked=0, signs=0, clutter=0).objects() == ()


def test_traffic_that_is_nowhere_is_told():
    with pytest.raises(ValidationError, match="far_m: 60 is not above near_m = 70"):
        TrafficParams(near_m=70)


def test_cyclists_have_bicycles():
    assert {"head", "helmet", "tyres", "frame"} <= {part.name for part in made("cyclist", helmet=True).parts}
    assert "helmet" not in {part.name for part in made("cyclist", helmet=False).parts}


def test_a_motorcycle_has_a_rider_and_one_lamp_to_each_end():
    body = made("motorcycle", height_m=1.75)
    assert {"helmet", "visor", "jacket", "tyres", "engine", "headlamp", "tail_lamp", "plate"} <= {part.name for part in body.parts}
    (low, high), (head, tail) = body.bounds, body.spotlights
    size = (high - low).tolist()
    assert size == pytest.approx([2.1, 0.9, 1.75], abs=0.15) and not made("motorcycle", lit=False).spotlights
    assert head.intensity_cd == LOW_BEAM_CD and head.axis[0] > 0.99 and tail.axis[0] == -1
    # UN R53: headlamps 500 to 1200 mm, tail lamps 250 to 1500 mm above the ground
    assert 0.5 < float(head.position[2]) < 1.2 and 0.25 < float(tail.position[2]) < 1.5


def test_files_with_other_axes_are_turned(tmp_path):
    box = trimesh.creation.box((1.0, 3.0, 2.0))  # in a file with y up and -z ahead: 2 long, 1 wide, 3 high
    box.export(tmp_path / "box.obj")
    body = MeshParams(name="box", file=tmp_path / "box.obj", forward="-z", up="y", track=HERE).build()
    low, high = body.corners.flatten(0, 1).aminmax(dim=0)
    assert (high - low).tolist() == pytest.approx([2.0, 1.0, 3.0]) and body.mesh.volume == pytest.approx(6.0)
    with pytest.raises(ValidationError, match="lie along one axis"):
        MeshParams(name="box", file=tmp_path / "box.obj", forward="-z", up="z", track=HERE)
