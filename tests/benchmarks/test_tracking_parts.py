"""Tracks of what is seen in part, at the border of the image, within other boxes or behind something."""

import pytest
import torch

from benchmarks.tracking import RATE_HZ, SIZES, TRACKER, VIEW
from luxloop.perception.boxes import WIDTHS_M
from tests.benchmarks.tracked import BOX, NOTHING, detections, plate, shown

CHILD = (0.45, 1.2)  # m


def test_a_size_follows_what_is_seen_and_a_part_does_not_move_what_it_is_of() -> None:
    tracks = shown(10)
    before = TRACKER.boxes(tracks)
    legs = (BOX[0] + 4, BOX[1] + 30, BOX[2] - 4, BOX[3])
    for k in range(10, 100):
        if k == 13:
            # After 0.1 s of the time constant of 1 s a tenth of the way to the logarithm of 0.7, 3.5 % of 100 px
            assert float((TRACKER.boxes(tracks) - before)[0, 1]) == pytest.approx(3.5, abs=0.5)
        tracks = TRACKER.step(tracks, detections(legs), k / RATE_HZ)
    assert tracks.number.tolist() == [1]
    left, top, right, bottom = (TRACKER.boxes(tracks) - before)[0].tolist()
    assert top == pytest.approx(30, abs=3) and bottom == pytest.approx(0, abs=1) and left == pytest.approx(-right, abs=1)


def walked(k: int, px: float = 4.0) -> tuple[float, float, float, float]:
    """BOX, moved by so many px a frame."""
    return BOX[0] + px * k, BOX[1], BOX[2] + px * k, BOX[3]


def test_whoever_goes_behind_something_comes_out_on_the_other_side() -> None:
    """From the 20th frame on less and less is seen, without feet, then nothing, then a part."""
    tracks = TRACKER.start()
    for k in range(50):
        left, top, right, bottom = walked(k - 30)
        hides = 20 <= k < 45
        seen_right = min(right, walked(-10)[2]) if hides else right
        box = (left, top, seen_right, bottom - 20 * hides)
        tracks = TRACKER.step(tracks, detections(box) if seen_right - left > 10 and k != 45 else NOTHING, k / RATE_HZ)
        if 28 <= k < 45:
            assert float(tracks.mean[0, 0, 1]) == pytest.approx(4 * RATE_HZ, rel=0.15)  # 8 parts of which each tells a little less
    assert tracks.number.tolist() == [1]
    assert (TRACKER.boxes(tracks)[0] - torch.tensor(walked(19))).abs().max() < 6  # px; 5 % of its height


def test_a_box_of_two_who_pass_each_other_moves_neither() -> None:
    """For eight frames the detector finds the nearer one alone, who lags as strides do."""
    tracks, other = TRACKER.start(), [each - 3 for each in BOX]
    for k in range(-25, 25):
        right = walked(k, 2.5)
        left = (other[0] - 2.5 * k, other[1], other[2] - 2.5 * k, other[3])
        apart = abs(k) > 4
        shared = walked(k - 2, 2.5)
        tracks = TRACKER.step(tracks, detections(*((right, left) if apart else (shared,))), (k + 25) / RATE_HZ)
    assert tracks.number.tolist() == [1, 2]
    wanted = torch.tensor([walked(24, 2.5), (other[0] - 60, other[1], other[2] - 60, other[3])]).double()
    torch.testing.assert_close(TRACKER.boxes(tracks), wanted, rtol=0, atol=2.0)  # px, half of the noise that is reckoned with


@pytest.mark.parametrize("side", [-1, 1])
def test_whoever_walks_out_of_the_image_is_followed_to_its_border_and_no_longer(side: int) -> None:
    tracks, found = TRACKER.start(), 0
    for k in range(90):
        left, top, right, bottom = plate(12.0, side * (2.0 + 1.4 * k / RATE_HZ), *SIZES["pedestrian"])
        box = torch.tensor([max(left, 0), top, min(right, VIEW.width), bottom]).double()
        share = float(box[2] - box[0]) / (right - left)
        tracks = TRACKER.step(tracks, detections(tuple(box.tolist())) if share > 0.3 else NOTHING, k / RATE_HZ)
        if k > 2 and share > 0.3:
            found += share < 0.9
            whole = torch.tensor([left, top, right, bottom]).double()
            assert (TRACKER.whole(tracks.present)[0] - whole).abs().max() < 2  # px; exact boxes, a filter that knows no size yet
        if share < 0:
            assert len(tracks.present) == 0
    assert found > 3


@pytest.mark.parametrize("side", [-1, 1])
def test_whoever_leaves_the_image_keeps_its_number_where_frames_miss_it(side: int) -> None:
    """Half of the car is outside from the 8th frame on, which is found 34 frames longer, nine times of ten."""
    for seed in range(2):
        rng = torch.Generator().manual_seed(seed)
        tracks, missed = TRACKER.start(), 0
        for k in range(45):
            left, top, right, bottom = plate(12.0, side * (3.0 + k / RATE_HZ), *SIZES["car"])
            box = (max(left, 0), top, min(right, VIEW.width), bottom)
            found = k < 3 or float(torch.rand(1, generator=rng)) > 0.1
            away = not 0 < (left + right) / 2 < VIEW.width
            missed += away and not found
            given = detections(box, scores=[[0.0, 0.0, 0.9, 0.0]]) if found and box[2] - box[0] > 0.2 * (right - left) else NOTHING
            tracks = TRACKER.step(tracks, given, k / RATE_HZ)
        assert missed > 0 and tracks.following == 2, f"seed {seed}: {tracks.number.tolist()}"


def test_a_car_around_a_car_that_is_seen_whole_is_none() -> None:
    far, near = plate(40.0, 2.0, *SIZES["car"]), plate(20.0, 1.0, 3.0, 2.1)
    sure = [0.0, 0.0, 0.9, 0.0]
    for both, tracks_then in ((True, 1), (False, 2)):
        tracks = TRACKER.start()
        for k in range(10):
            boxes = [far] if k < 5 else [far, near] if both else [near]
            tracks = TRACKER.step(tracks, detections(*boxes, scores=[sure] * len(boxes)), k / RATE_HZ)
        assert len(tracks.present) == tracks_then


def test_sizes_are_those_of_the_class() -> None:
    """What is found may be half of somebody, or of two."""
    u, foot, metre = 320.0, BOX[3], (BOX[3] - BOX[1]) / 1.755
    for high, wide, least, most in ((0.6, 0.4, 1.0, 1.1), (1.75, 3.0, 1.7, 1.8), (1.75, 0.1, 1.7, 1.8)):
        box = (u - wide * metre / 2, foot - high * metre, u + wide * metre / 2, foot)
        tracks = TRACKER.start()
        for k in range(5):
            tracks = TRACKER.step(tracks, detections(box), k / RATE_HZ)
        width_m, height_m = tracks.size_m[0].tolist()
        assert WIDTHS_M["pedestrian"][0] <= width_m <= WIDTHS_M["pedestrian"][1] and least <= height_m <= most


def test_what_is_expected_too_low_comes_back_to_where_it_is_seen() -> None:
    """A box that was too large holds all that is found afterwards, which must not keep it where it is."""
    left, top, right, bottom = plate(20.0, 0.0, *CHILD)
    tracks = TRACKER.start()
    for k in range(60):
        box = (left - 10, top - 15, right + 10, bottom + 20) if k < 5 else (left, top, right, bottom)
        tracks = TRACKER.step(tracks, detections(box), k / RATE_HZ)
    assert tracks.number.tolist() == [1]
    # 2 s are two time constants of the size: a seventh is left of what is too much, 35 px of height
    assert (TRACKER.boxes(tracks)[0] - torch.tensor([left, top, right, bottom])).abs().max() < 6


def test_a_part_of_what_is_known_is_nobody_new_but_somebody_of_another_kind_is() -> None:
    tracks = shown(5)
    part = (BOX[0] + 5, BOX[1] + 40, BOX[2] - 5, BOX[3] - 5)
    cyclist, car = [0.1, 0.7, 0.0, 0.0], [0.0, 0.1, 0.7, 0.0]
    sure = [0.8, 0.1, 0.05, 0.0]
    assert len(TRACKER.step(tracks, detections(BOX, part, scores=[sure, cyclist]), 5 / RATE_HZ)) == 1
    assert len(TRACKER.step(tracks, detections(BOX, part, scores=[sure, car]), 5 / RATE_HZ)) == 2


def test_a_child_before_an_adult_is_followed_too() -> None:
    """Its box lies in the adult's, who is found whole; legs alone, and who is behind, are taken for parts."""
    adult, child, behind = plate(15.0, 0.0, *SIZES["pedestrian"]), plate(14.7, 0.05, *CHILD), plate(17.0, 0.05, *CHILD)
    assert adult[0] < child[0] and adult[1] < child[1] and child[2] < adult[2] and adult[1] < behind[1] and behind[3] < adult[3]
    for other, followed_too in ((child, True), (behind, False)):
        tracks = TRACKER.start()
        for k in range(20):
            boxes = [adult] if k < 5 else [adult, other]
            tracks = TRACKER.step(tracks, detections(*boxes), k / RATE_HZ)
        assert len(tracks.present) == 1 + followed_too
        if followed_too:
            heights = sorted(tracks.size_m[:, 1].tolist())
            assert heights == pytest.approx([CHILD[1], SIZES["pedestrian"][1]], rel=0.05)
