"""Tracks keep their identity: through crossings, overtaking, occlusion, noise and misses; the filters do what their equations say."""

import math
import pickle
from dataclasses import fields, replace

import pytest
import torch
from pydantic import ValidationError

from benchmarks.tracking import CLASSES, RATE_HZ, SCENES, SIZES, TRACKER, VIEW, Judge, followed, seen
from luxloop.perception.detection.detector import Detections
from luxloop.perception.tracking import EACH, LINGER_S, Tracker, TrackerParams
from tests.benchmarks.tracked import BOX, NOTHING, detections, shown

DEFAULTS = TRACKER.params


@pytest.mark.parametrize("name", SCENES)
def test_nobody_changes_identity(name: str) -> None:
    for seed in range(3):
        kept = followed(SCENES[name], 110, seed)
        assert all(len(numbers) == 1 for numbers in kept.numbers) and kept.switches == 0, f"{name}, seed {seed}: {kept}"


def test_an_occlusion_of_ten_frames_is_one() -> None:
    hidden = sum(seen([road(k / RATE_HZ) for road in SCENES["ten frames behind a car"]])[1][1] for k in range(55))
    assert hidden >= 10


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


@pytest.mark.parametrize("rate_hz", [10.0, 25.0, 30.0, 50.0, 100.0])
def test_one_that_is_not_found_is_kept_twice_as_long_as_it_was_found_and_no_longer_than_keep_s(rate_hz: float) -> None:
    for frames, keep_s in ((3, 1.0), (4, 10.0), (10, 0.4)):
        kept, params = min(2 * frames, round(keep_s * rate_hz)), TrackerParams(keep_s=keep_s)
        assert [len(shown(frames, params, then, rate_hz).present) for then in (kept, kept + 1)] == [1, 0]


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


def test_a_weak_box_that_fits_badly_does_not_take_a_track_that_is_not_found() -> None:
    tracks = shown(20, then=5)
    large = (BOX[0] + 5, BOX[1] - 20, BOX[2] + 45, BOX[3] + 18)
    for score, taken in ((0.3, False), (0.9, True)):
        after = TRACKER.step(tracks, detections(large, scores=[[score, 0.0, 0.0, 0.0]]), 25 / RATE_HZ)
        assert bool(after.score[0].isnan().all()) != taken


def test_what_comes_nearer_looks_larger_and_stays_as_large() -> None:
    tracks = TRACKER.start()
    for k in range(90):
        box, _ = seen([("pedestrian", 30 - k / 6, 1.0)])
        tracks = TRACKER.step(tracks, Detections(box, torch.tensor([[0.8, 0, 0, 0]])), k / RATE_HZ)
    assert tracks.number.tolist() == [1]
    # A plate of 1.75 m; rows of a camera that looks down by 1.5 deg are 0.1 % farther apart
    assert tracks.size_m[0].tolist() == pytest.approx(SIZES["pedestrian"], rel=0.02)


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
