"""Boxes of parts become boxes of wholes, by their class and by what was expected; they are placed on the road, and found by their lamps."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.testing import assert_close

from luxloop.perception.boxes import (
    ABOVE_M,
    FARTHEST_M,
    HEIGHTS_M,
    LEANS,
    LEAST_EVIDENCE,
    LENGTH_M,
    MEASURED,
    MISSING,
    USUAL_HEIGHTS_M,
    by_lamps,
    complete,
    extend_cut,
    occluders_of,
    parts_of,
    place_boxes,
    plausible,
    spread_of,
    standing,
)
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.world.frames import transform

VIEW = camera_view(CameraParams(width_px=640, height_px=360, pitch_deg=1.5))


def upright(x: float, width_m: float, height_m: float) -> torch.Tensor:
    """`[1, 4]` px: a plate on the road, ahead."""
    corners = torch.tensor([[x, width_m / 2, height_m], [x, -width_m / 2, 0.0]], dtype=torch.float64).T
    return VIEW.project(corners)[0].T.reshape(1, 4)


@given(st.floats(7, 60), st.floats(1.05, 2.0))
def test_whoever_stands_on_the_road_is_left_alone(x, height_m):
    """Between the least and the greatest height, but for 2 %: rows of a camera that looks down are no heights on the road."""
    box = upright(x, 0.6, height_m)
    assert_close(standing(box, ("pedestrian",), VIEW), box)


def test_a_box_too_high_for_its_class_loses_score_by_bayes_and_a_low_one_none():
    """1.43 m is the geometric middle of a pedestrian's limits, 1.05 and 2.0 m lie within two standard deviations of it; 4 m lose most."""
    scores = torch.tensor([[0.7, 0.2]]).double()

    def of(height_m: float, x: float = 20.0) -> torch.Tensor:
        return plausible(scores, upright(x, 0.6, height_m), ["pedestrian"], VIEW)

    for height_m in (0.6, 1.05, 1.7):
        assert_close(of(height_m), scores)
    assert 0.7 > float(of(2.0)[0, 0]) > float(of(2.4)[0, 0]) > float(of(4.0)[0, 0])
    assert_close(of(4.0), torch.special.expit(torch.logit(scores) + LEAST_EVIDENCE))
    assert_close(of(2.4, x=4.0), scores)  # the image cuts off its foot
    assert_close(plausible(torch.ones(1, 2).double(), upright(20.0, 0.6, 4.0), ["pedestrian"], VIEW), torch.ones(1, 2).double())


@given(st.floats(7, 60), st.floats(0.2, 0.9))
def test_a_foot_in_the_light_gets_the_least_of_its_class(x, height_m):
    found = standing(upright(x, 0.6, height_m), ("pedestrian",), VIEW)
    size = place_boxes(found, ("pedestrian",), VIEW).size_m[0]
    assert float(size[2]) == pytest.approx(HEIGHTS_M["pedestrian"][0], rel=0.02)  # rows of a camera that looks down
    assert_close(found[:, 3], upright(x, 0.6, height_m)[:, 3])


@given(st.floats(10, 40), st.floats(0.4, 0.8))
def test_a_foot_that_is_hidden_is_put_where_somebody_so_high_stands(x, hidden):
    whole = upright(x, 0.6, HEIGHTS_M["pedestrian"][1])
    half = whole.clone()
    half[:, 3] -= hidden * 0.5 * (whole[:, 3] - whole[:, 1])
    assert_close(standing(half, ("pedestrian",), VIEW), whole, rtol=0, atol=1.0)  # px; as above, of the top's row


@pytest.mark.parametrize(
    ("x", "kind", "width_m", "height_m"),
    [*((x, "pedestrian", 0.6, USUAL_HEIGHTS_M["pedestrian"]) for x in (3.0, 4.0, 5.0)), (4.0, "car", 1.8, 1.5)],
)
def test_whoever_is_nearer_than_the_lowest_row_is_placed_by_the_usual_height_or_width(x, kind, width_m, height_m):
    """The row of the foot would say 6.25 m from the lamps; the camera is 1.6 m behind them."""
    whole = upright(x, width_m, height_m)
    assert float(whole[0, 3]) > VIEW.height
    whole[0, 3] = VIEW.height
    place = place_boxes(standing(whole, (kind,), VIEW), (kind,), VIEW)
    assert float(place.T_world_box[0, 0, 3]) - LENGTH_M[kind] / 2 == pytest.approx(x, rel=0.05)
    assert kind == "car" or float(place.size_m[0, 2]) == pytest.approx(height_m, rel=0.05)


def test_above_the_horizon_boxes_at_most_double():
    box = torch.tensor([[300.0, 20.0, 340.0, 60.0], [300.0, 100.0, 340.0, 140.0]]).double()
    found = standing(box, ("pedestrian", "sign"), VIEW)
    assert float((found[:, 3] - found[:, 1]).max()) <= 80 and torch.equal(found[1], box[1])  # of signs nothing is known
    assert standing(torch.zeros(0, 4), (), VIEW).shape == (0, 4)


def test_parts_are_completed_and_wholes_are_not():
    expected = torch.tensor([[100.0, 100, 140, 200]]).double()
    given = torch.tensor([[[105.0, 130, 135, 195]], [[90.0, 150, 110, 210]], [[98.0, 96, 139, 203]]]).double()
    # 30 of 40 px is less than 85 %. Its foot is 5 px higher; of the second the middle is 20 px to the left, where 10 px are needed
    wanted = [[100.0, 100 - 5 * LEANS, 140, 200 - 5 * LEANS], [90 - 10 * LEANS, 110.0, 130 - 10 * LEANS, 210], [98.0, 96, 139, 203]]
    assert_close(complete(given, expected)[:, 0], torch.tensor(wanted).double())


def test_what_is_inside_belongs_to_it_unless_it_is_before_what_is_seen_whole():
    expected = torch.tensor([[100.0, 100, 140, 200], [100.0, 100, 140, 200]]).double()
    boxes = torch.tensor([[105.0, 130, 135, 199], [105.0, 130, 135, 190], [125.0, 130, 155, 199]]).double()
    wanted = torch.tensor([[True, True, False], [False, True, False]])
    assert torch.equal(parts_of(boxes, expected, torch.tensor([False, True])), wanted)


def test_what_the_border_cuts_off_is_as_wide_as_expected():
    expected = torch.tensor([[100.0, 100, 140, 200]]).double()
    boxes = torch.tensor([[[0.0, 90, 25, 190]], [[620.0, 90, 640, 190]], [[300.0, 90, 325, 190]], [[0.0, 90, 60, 190]]]).double()
    wanted = torch.tensor([[-15.0, 90, 25, 190], [620.0, 90, 660, 190], [300.0, 90, 325, 190], [0.0, 90, 60, 190]]).double()
    assert_close(extend_cut(boxes, expected, 640)[:, 0], wanted)
    both = torch.tensor([[0.0, 90, 640, 300]]).double()
    assert torch.equal(extend_cut(both, torch.tensor([[-3.0, 90, 642, 300]]).double(), 640), both)  # no size is made of two guesses


def test_the_more_is_missing_the_less_a_part_says():
    expected = torch.tensor([[100.0, 100, 140, 200]]).double()
    boxes = torch.tensor([[100.0, 100, 140, 200], [90.0, 90, 160, 220], [100.0, 150, 110, 200]]).double()
    noise, missing = torch.tensor(MEASURED).double() * 4000**0.5, MISSING * torch.tensor([30.0, 50.0]).double()
    assert_close(spread_of(boxes, expected).sqrt(), torch.stack([noise, noise, (noise**2 + missing**2).sqrt()]))


def test_nobody_is_before_what_is_seen_whole():
    expected = torch.tensor([[100.0, 100, 140, 140], [100.0, 100, 140, 140]]).double()
    boxes = torch.tensor([[80.0, 80, 160, 170], [80.0, 80, 160, 130], [120.0, 80, 200, 170]]).double()
    assert torch.equal(occluders_of(boxes, expected, torch.tensor([True, False])), torch.tensor([[True, False, False], [False] * 3]))


TURNED = camera_view(CameraParams(width_px=640, height_px=360, pitch_deg=1.5, yaw_deg=3.0))


def near_side(T: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """Middles `[3, 4]` m of the foot, the top, the left and the right edge of the side that looks at the camera."""
    length, width, height = size.tolist()
    edges = [[0.0, 0.0], [0.0, height], [width / 2, height / 2], [-width / 2, height / 2]]
    return transform(T, torch.tensor([[-length / 2, y, z] for y, z in edges], dtype=torch.float64).T)


@given(st.floats(6, 80), st.floats(-0.2, 0.2), st.floats(0.3, 2.5), st.floats(0.5, 2.2))
def test_what_stands_on_the_road_comes_back(x, share, width, height):
    """A plate that is turned to the camera: foot, height and width are its own."""
    origin = TURNED.origin
    foot = torch.tensor([x, share * x, 0.0], dtype=torch.float64)
    ahead = torch.nn.functional.normalize(foot[:2] - origin[:2], dim=0)
    aside = torch.tensor([-ahead[1], ahead[0], 0.0], dtype=torch.float64)
    up = torch.tensor([0.0, 0.0, height], dtype=torch.float64)
    (u, v), _ = TURNED.project(torch.stack([foot, foot + up, foot + aside * width / 2, foot - aside * width / 2], -1))
    found = place_boxes(torch.tensor([[u[0] - (u[3] - u[2]) / 2, v[1], u[0] + (u[3] - u[2]) / 2, v[0]]]), ("pedestrian",), TURNED)
    length = LENGTH_M["pedestrian"]
    assert_close(near_side(found.T_world_box[0], found.size_m[0])[:, 0], foot, rtol=1e-5, atol=1e-5)
    assert found.size_m[0, 0] == length
    # Beside the middle of the image, where 12 deg away a pixel is 1 / cos^2 wide and top and foot are not above each other, 2 %
    assert float(found.size_m[0, 1]) == pytest.approx(width, rel=0.05)
    assert float(found.size_m[0, 2]) == pytest.approx(height, rel=0.05)


def test_what_reaches_above_the_horizon_is_far_away():
    found = place_boxes(torch.tensor([[300.0, 20.0, 340.0, 60.0]]), ("car",), TURNED)
    away = (found.T_world_box[0, :2, 3] - TURNED.origin[:2]).norm()
    assert float(away) == pytest.approx(FARTHEST_M + LENGTH_M["car"] / 2, rel=0.01)  # which is a depth, not a distance


def test_boxes_stand_upright_and_look_at_the_camera():
    found = place_boxes(torch.tensor([[100.0, 100.0, 140.0, 250.0], [500.0, 150.0, 600.0, 300.0]]), ("car", "sign"), TURNED)
    R = found.T_world_box[:, :3, :3]
    assert_close(R @ R.transpose(1, 2), torch.eye(3).double().expand(2, 3, 3))
    assert_close(R[:, :, 2], torch.tensor([0.0, 0, 1]).double().expand(2, 3))
    to_box = torch.nn.functional.normalize(found.T_world_box[:, :2, 3] - TURNED.origin[:2], dim=-1)
    assert_close(R[:, :2, 0], to_box)
    assert found.T_world_box[:, 2, 3].tolist() == [0.0, 0.0]
    none = place_boxes(torch.zeros(0, 4), (), TURNED)
    assert none.T_world_box.shape == (0, 4, 4) and none.size_m.shape == (0, 3)
    low = camera_view(CameraParams(width_px=640, height_px=360, z_m=0.0))
    assert bool(place_boxes(torch.tensor([[300.0, 100.0, 340.0, 300.0]]), ("car",), low).T_world_box.isfinite().all())


METRE = 20.0  # px
BOX = torch.tensor([[100.0, 100.0, 136.0, 130.0]]).double()  # 1.8 m by 1.5 m
NOBODY = torch.zeros(0, 4).double()


def frame(*spots: tuple[int, int]) -> torch.Tensor:
    """Dark, with bright spots of 3 px by 3 px around u and v."""
    picture = torch.full((200, 300), 0.01)
    for u, v in spots:
        picture[v - 1 : v + 2, u - 1 : u + 2] = 1.0
    return picture


@pytest.mark.parametrize("moved", [(0, 0), (5, 3), (-8, 2)])
def test_a_box_goes_where_both_lamps_are(moved):
    lamps = [(u + moved[0], 130 - round(ABOVE_M * METRE) + moved[1]) for u in (105, 130)]
    found = by_lamps(frame(*lamps), BOX, torch.tensor([METRE]).double(), NOBODY)
    wanted = BOX + torch.tensor([*moved, *moved])
    torch.testing.assert_close(found, wanted.double(), rtol=0, atol=0.5)  # lamps are whole pixels, whose middles are half a pixel on


def test_without_lamps_there_is_nothing_to_say():
    metre = torch.tensor([METRE]).double()
    assert bool(by_lamps(frame(), BOX, metre, NOBODY).isnan().all())
    assert bool(by_lamps(frame((20, 20)), BOX, metre, NOBODY).isnan().all())  # far from the box
    assert bool(by_lamps(frame((105, 118), (130, 118)), BOX, metre, BOX).isnan().all())  # somebody who is lit
    assert bool(by_lamps(frame((112, 118), (124, 118)), BOX, metre, NOBODY).isnan().all())  # of somebody else, farther away
    assert bool(by_lamps(frame((105, 118)), BOX, metre, NOBODY).isnan().all())  # one says little of where the car is
    wide = frame(*((u, 118) for u in range(104, 134)))
    assert bool(by_lamps(wide, BOX, metre, NOBODY).isnan().all())  # one light, not two
    assert by_lamps(frame((118, 115)), NOBODY, metre[:0], NOBODY).shape == (0, 4)
