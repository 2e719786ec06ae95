"""Boxes, shares and parts against what can be counted: each object rendered alone, and corners projected one by one."""

from dataclasses import replace

import pytest
import torch

from luxloop.perception.ground_truth import GroundTruth, ground_truth, part_mask
from luxloop.world.rendering.gbuffer import GBuffer
from luxloop.world.scene.body import Body
from luxloop.world.scene.scene import Scene
from luxloop.world.scene.triangles import Triangles
from luxloop.world.traffic.car import CarParams
from luxloop.world.traffic.objects import BoxParams
from luxloop.world.traffic.people import PedestrianParams
from luxloop.world.traffic.tracked import EYES
from tests.world.grids import camera, flat, see

VIEW = camera(480, 270)
ROAD = Body("road", flat(), smooth=True)


def seen(*bodies: Body) -> tuple[GBuffer, Triangles]:
    return see(ROAD, *bodies, view=VIEW), Scene((ROAD, *bodies)).at(0.0)


def truth(*bodies: Body) -> tuple[GroundTruth, ...]:
    return ground_truth(*seen(*bodies), VIEW, ["pedestrian"] * len(bodies))


def someone(x_m: float, y_m: float = 0.0, name: str = "eva") -> Body:
    body = PedestrianParams(name=name, seed=1, stance="standing", track=({"position_m": (x_m, y_m, 0), "yaw_deg": 180},)).build()
    assert isinstance(body, Body)
    return body


def wall(x_m: float, y_m: float, height_m: float) -> Body:
    return BoxParams(name="wall", size_m=(0.1, 2.0, height_m), track=({"position_m": (x_m, y_m, 0)},)).build()


def test_a_box_holds_all_pixels_and_nothing_more():
    (found,) = truth(someone(12.0))
    surfaces, _ = seen(someone(12.0))
    rows, columns = torch.nonzero(surfaces.object_id == 1).unbind(1)
    assert found.box == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    assert found.pixels == len(rows) and found.visible == pytest.approx(1.0, abs=0.02)  # soles lie in the road's plane
    assert found.inside == 1.0 and found.category == "pedestrian" and found.box[3] - found.box[1] >= 24
    assert {"skin", "hair", "cloth"} <= set(found.materials) and sum(found.materials.values()) == found.pixels
    # the whole box is of corners, which lie within a pixel of those that are seen
    assert found.whole == pytest.approx(found.box, abs=1.0)


def test_what_is_hidden_is_counted_against_the_object_alone():
    alone, _ = seen(someone(12.0))
    hidden, _ = seen(someone(12.0), wall(8.0, 0.0, 0.9))
    behind = next(each for each in truth(someone(12.0), wall(8.0, 0.0, 0.9)) if each.name == "eva")
    share = int((hidden.object_id == 1).sum()) / int((alone.object_id == 1).sum())
    assert 0.1 < share < 0.9 and behind.visible == pytest.approx(share, abs=0.02)  # soles, as above
    assert behind.whole[3] > behind.box[3] + 10  # of all of it, legs included


def test_what_reaches_out_of_the_image_is_told_and_what_is_hidden_altogether_is_not_there():
    box = BoxParams(name="box", size_m=(1.0, 2.0, 1.0), track=({"position_m": (10.0, 3.1, 0)},)).build()
    (found,) = ground_truth(*seen(box), VIEW, [None])
    assert found.whole[0] < 0 < found.whole[2] and found.box[0] == 0
    assert found.category is None and found.materials == {"matt": found.pixels}
    assert 0.2 < found.inside < 0.8
    assert [each.name for each in truth(someone(12.0), wall(8.0, 0.0, 3.0))] == ["wall"]


def test_heads_and_windscreens_are_found_by_their_names():
    car = CarParams(name="car", style="hatchback", track=({"position_m": (16.0, 2.0, 0), "yaw_deg": 180},)).build()
    surfaces, triangles = seen(someone(12.0), car)
    mask = part_mask(surfaces, triangles, EYES)
    heads, glass = mask & (surfaces.object_id == 1), mask & (surfaces.object_id == 2)
    assert heads.any() and glass.any() and not (mask & (surfaces.object_id == 0)).any()
    # a head begins at 0.86 of the height and a neck below it at 0.82 (Drillis & Contini)
    person = surfaces.position[2][surfaces.object_id == 1]
    assert surfaces.position[2][heads].min() > 0.8 * person.max()
    # the windscreen looks ahead and up
    assert (surfaces.normal[0][glass] < 0).all() and (surfaces.normal[2][glass] > 0.3).all()
    boxes = seen(wall(8.0, 0.0, 1.0))
    assert not part_mask(*boxes, EYES).any()


def test_bodies_without_parts_have_no_heads_whatever_their_numbers():
    plain = [replace(wall(14.0, y, 1.0), parts=()) for y in (-3.0, 3.0)]
    surfaces, triangles = seen(someone(12.0), *plain)
    assert {1, 2, 3} <= set(surfaces.object_id.unique().tolist())
    mask = part_mask(surfaces, triangles, EYES)
    assert mask.any() and (surfaces.object_id[mask] == 1).all()
