"""Tracks keep their identity: through crossings, overtaking, occlusion, noise and misses; the filters do what their equations say."""

import math
import pickle
from dataclasses import fields, replace

import pytest
import torch
from pydantic import ValidationError

from benchmarks.tracking import CLASSES, RATE_HZ, SCENES, SIZES, TRACKER, VIEW, Judge, followed, seen
from perception.detection.protocol import Detections
from perception.parts import WIDTHS_M
from perception.tracking import LINGER_S, Tracker, TrackerParams
from perception.tracks import EACH, Tracks

DEFAULTS = TRACKER.params


@pytest.mark.parametrize("name", SCENES)
def test_nobody_changes_identity(name: str) -> None:
    for seed in range(3):
        kept = followed(SCENES[name], 110, seed)
        assert all(len(numbers) == 1 for numbers in kept.numbers) and kept.switches == 0, f"{name}, seed {seed}: {kept}"


def test_an_occlusion_of_ten_frames_is_one() -> None:
    hidden = sum(seen([road(k / RATE_HZ) for road in SCENES["ten frames behind a car"]])[1][1] for k in range(55))
    assert hidden >= 10


def detections(*boxes: tuple[float, float, float, float], scores: list[list[float]] | None = None) -> Detections:
    given = scores or [[0.8, 0.1, 0.05, 0.0]] * len(boxes)
    return Detections(torch.tensor(boxes, dtype=torch.float32).view(-1, 4), torch.tensor(given).view(-1, len(CLASSES)))


BOX = (300.0, 126.0, 340.0, 226.0)  # of a pedestrian of 1.75 m
CHILD = (0.45, 1.2)  # m
NOTHING = Detections(torch.zeros(0, 4), torch.zeros(0, len(CLASSES)))


def plate(x: float, y: float, width_m: float, height_m: float) -> tuple[float, float, float, float]:
    """Its box, upright on the road."""
    corners = torch.tensor([[x, y + width_m / 2, height_m], [x, y - width_m / 2, 0.0]], dtype=torch.float64).T
    left, top, right, bottom = VIEW.project(corners)[0].T.flatten().tolist()
    return left, top, right, bottom


def shown(frames: int, params: TrackerParams = DEFAULTS, then: int = 0) -> Tracks:
    """Tracks after so many frames with one box, then so many with none."""
    tracker = Tracker(CLASSES, VIEW, params)
    tracks = tracker.start()
    for k in range(frames + then):
        tracks = tracker.step(tracks, detections(BOX) if k < frames else NOTHING, k / RATE_HZ)
    return tracks


def test_a_new_object_is_reported_after_the_frames_that_confirm_it() -> None:
    assert [len(shown(n).known) for n in (1, 2, 3, 4)] == [0, 0, 1, 1]
    assert float(shown(5).known.since_s) == pytest.approx(2 / RATE_HZ)
    assert len(shown(1, TrackerParams(confirm_frames=1)).known) == 1
    assert len(shown(2, then=1)) == 0  # what a single miss tells from an object is dropped
    weak = TRACKER.step(TRACKER.start(), detections(BOX, scores=[[0.49, 0.1, 0, 0]]), 0.0)
    assert len(weak) == 0


def test_one_that_is_lost_is_kept_for_a_while_then_told_as_lost_then_forgotten() -> None:
    keep_s = DEFAULTS.keep_s
    kept = shown(20, then=29)
    assert math.isinf(float(kept.known.until_s)) and bool(kept.known.score.isnan().all())
    lost = shown(20, then=31)
    assert float(lost.known.until_s) == pytest.approx(19 / RATE_HZ + keep_s, abs=1.1 / RATE_HZ)  # the first frame after it
    later = replace(lost, time_s=lost.time_s)
    assert len(TRACKER.step(later, NOTHING, lost.time_s + 0.9 * LINGER_S)) == 1
    assert len(TRACKER.step(later, NOTHING, lost.time_s + 1.1 * LINGER_S)) == 0
    again = TRACKER.step(lost, detections(BOX), lost.time_s + 1 / RATE_HZ)
    assert sorted(again.number.tolist()) == [1, 2]  # the name of a lost one is not given again


@pytest.mark.parametrize("frames", [3, 6])
def test_one_that_was_hardly_found_is_kept_twice_as_long(frames: int) -> None:
    assert [len(shown(frames, then=then).present) for then in (2 * frames, 2 * frames + 1)] == [1, 0]


@pytest.mark.parametrize("time_constant_s", [0.0, 0.15, 1.0])
def test_confidence_is_a_first_order_filter_of_scores(time_constant_s: float) -> None:
    params = TrackerParams(confidence_s=time_constant_s)
    tracks = shown(10, params)
    tracker = Tracker(CLASSES, VIEW, params)
    step = tracker.step(tracks, detections(BOX, scores=[[0.2, 0.9, 0.05, 0.0]]), 10 / RATE_HZ)
    share = 1.0 if time_constant_s == 0 else 1 - math.exp(-1 / RATE_HZ / time_constant_s)
    # rtol: scores come in float32
    torch.testing.assert_close(step.confidence[0, :2], torch.tensor([0.8 - 0.6 * share, 0.1 + 0.8 * share]).double(), rtol=1e-6, atol=1e-7)
    missed = tracker.step(tracks, NOTHING, 10 / RATE_HZ)
    assert float(missed.confidence[0, 0]) == pytest.approx(0.8 * (1 - share))


def test_one_frame_of_another_class_does_not_change_the_class() -> None:
    tracks = TRACKER.step(shown(10), detections(BOX, scores=[[0.2, 0.9, 0.05, 0.0]]), 10 / RATE_HZ)
    assert tracks.number.tolist() == [1] and CLASSES[int(tracks.category)] == "pedestrian"


def test_boxes_are_smoother_than_detections_and_move_as_they_do() -> None:
    rng = torch.Generator().manual_seed(1)
    tracks, errors, raw = TRACKER.start(), [], []
    for k in range(60):
        true = torch.tensor([[100.0 + 4 * k, 126, 140 + 4 * k, 226]])
        noisy = true + 3 * torch.randn(1, 4, generator=rng)
        if k > 20:  # where it will be, said before it is seen
            errors.append(float((TRACKER.boxes(TRACKER.at(tracks, k / RATE_HZ)) - true).abs().mean()))
            raw.append(float((noisy - true).abs().mean()))
        tracks = TRACKER.step(tracks, Detections(noisy, torch.tensor([[0.8, 0, 0, 0]])), k / RATE_HZ)
    assert sum(errors) < sum(raw)  # a prediction by one frame is better than the measurement of that frame
    assert float(tracks.mean[0, 0, 1]) == pytest.approx(4 * RATE_HZ, rel=0.1)


def test_the_filter_is_the_matrix_form_of_kalmans() -> None:
    tracks = shown(2)
    ahead = TRACKER.at(tracks, 0.2)
    dt = 0.2 - tracks.time_s
    F = torch.tensor([[1, dt], [0, 1]], dtype=torch.float64)
    Q = torch.tensor([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], dtype=torch.float64)
    size = 4000**0.5  # of the box, 40 px by 100 px
    q = torch.tensor([1.0, 0.3], dtype=torch.float64) * size
    expected = F @ tracks.covariance[0] @ F.T + q[:, None, None] ** 2 * Q
    torch.testing.assert_close(ahead.covariance[0], expected)
    after = TRACKER.step(tracks, detections((310, 131, 352, 230)), 0.2)
    H, R = torch.tensor([[1.0, 0.0]], dtype=torch.float64), (0.05 * size) ** 2
    P, z = expected[0], 331.0
    K = P @ H.T / (H @ P @ H.T + R)
    torch.testing.assert_close(after.mean[0, 0], ahead.mean[0, 0] + K[:, 0] * (z - ahead.mean[0, 0, 0]))
    torch.testing.assert_close(after.covariance[0, 0], (torch.eye(2).double() - K @ H) @ P)


def test_two_boxes_of_one_place_are_two_tracks_and_a_far_one_is_not_taken() -> None:
    tracks = shown(5)
    far = (BOX[0] + 300, BOX[1], BOX[2] + 300, BOX[3])
    after = TRACKER.step(tracks, detections(BOX, far), 5 / RATE_HZ)
    assert after.number.tolist() == [1, 2] and after.frames.tolist() == [6, 1]
    swapped = TRACKER.step(after, detections(far, BOX), 6 / RATE_HZ)
    assert swapped.number.tolist() == [1, 2] and swapped.frames.tolist() == [7, 2]


def test_tracks_are_a_value() -> None:
    tracks = shown(5)
    kept = pickle.loads(pickle.dumps(tracks))
    after, again = (TRACKER.step(each, detections(BOX), 5 / RATE_HZ) for each in (tracks, kept))
    assert set(EACH) <= {each.name for each in fields(tracks)} and tracks.frames.tolist() == [5]
    assert all(torch.equal(getattr(after, name), getattr(again, name)) for name in EACH if name != "score")


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


def test_a_weak_box_that_fits_badly_does_not_take_a_track_that_is_not_found() -> None:
    tracks = shown(20, then=5)
    large = (BOX[0] + 5, BOX[1] - 20, BOX[2] + 45, BOX[3] + 18)
    for score, taken in ((0.3, False), (0.9, True)):
        after = TRACKER.step(tracks, detections(large, scores=[[score, 0.0, 0.0, 0.0]]), 25 / RATE_HZ)
        assert bool(after.score[0].isnan().all()) != taken


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


def test_what_comes_nearer_looks_larger_and_stays_as_large() -> None:
    tracks = TRACKER.start()
    for k in range(90):
        box, _ = seen([("pedestrian", 30 - k / 6, 1.0)])
        tracks = TRACKER.step(tracks, Detections(box, torch.tensor([[0.8, 0, 0, 0]])), k / RATE_HZ)
    assert tracks.number.tolist() == [1]
    # A plate of 1.75 m; rows of a camera that looks down by 1.5 deg are 0.1 % farther apart
    assert tracks.size_m[0].tolist() == pytest.approx(SIZES["pedestrian"], rel=0.02)


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


def test_a_weak_detection_does_not_move_a_track() -> None:
    tracks, aside = shown(10), [each + 30 * (k % 2 == 0) for k, each in enumerate(BOX)]
    weak = detections((aside[0], aside[1], aside[2], aside[3]), scores=[[0.1, 0.0, 0.0, 0.0]])
    moved, missed = (TRACKER.step(tracks, each, 10 / RATE_HZ) for each in (weak, NOTHING))
    torch.testing.assert_close(moved.mean, missed.mean)
    assert bool(moved.score.isnan().all())


def test_half_the_score_that_starts_a_track_keeps_it_and_starts_none() -> None:
    tracks, half = shown(10), detections(BOX, scores=[[0.5 * DEFAULTS.start_score + 0.01, 0.0, 0.0, 0.0]])
    assert len(TRACKER.step(TRACKER.start(), half, 0.0)) == 0
    for k in range(10, 100):
        tracks = TRACKER.step(tracks, half, k / RATE_HZ)
    assert tracks.number.tolist() == [1] and float(tracks.seen_s) == 99 / RATE_HZ and bool(tracks.until_s.isinf().all())


def test_a_score_of_nothing_starts_no_track() -> None:
    with pytest.raises(ValidationError, match="greater than 0"):
        TrackerParams(start_score=0)


def test_a_class_changes_only_where_the_detector_is_much_surer() -> None:
    for other, changes in ((0.6, False), (0.95, True)):
        tracks = shown(10)
        for k in range(10, 60):
            tracks = TRACKER.step(tracks, detections(BOX, scores=[[0.4, other, 0.0, 0.0]]), k / RATE_HZ)
        assert CLASSES[int(tracks.category)] == ("cyclist" if changes else "pedestrian")


def test_switches_misses_and_ghosts_are_counted() -> None:
    one, other = torch.tensor([[0.0, 0, 10, 20]]), torch.tensor([[50.0, 0, 60, 20]])
    judge = Judge(1)
    for boxes, numbers in ((one, [1]), (other, [1]), (one, [2]), (torch.cat([one, other]), [2, 3])):
        judge.look(one, [True], boxes, numbers)
    kept = judge.kept
    assert (kept.seen, kept.missed, kept.false, kept.switches, kept.numbers) == (4, 1, 2, 1, [{1, 2}])
    assert kept.mota == pytest.approx(1 - 4 / 4)
