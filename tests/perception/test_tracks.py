"""Tracks keep their identity through occlusion, misses and borders of the image; the filters do what their equations say."""

import math
import pickle
from dataclasses import replace

import pytest
import torch

from luxloop.perception.boxes import WIDTHS_M
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.detection.detector import Detections
from luxloop.perception.tracking import EACH, LINGER_S, Tracker, TrackerParams, Tracks

CLASSES = ("pedestrian", "cyclist", "car", "animal")
RATE_HZ = 30.0
VIEW = camera_view(CameraParams(width_px=640, height_px=360, pitch_deg=1.5))
TRACKER = Tracker(CLASSES, VIEW, TrackerParams())
SIZES = {"pedestrian": (0.6, 1.75), "car": (1.8, 1.5)}  # m
Box = tuple[float, float, float, float]
BOX = (300.0, 126.0, 340.0, 226.0)  # of a pedestrian of 1.75 m
NOTHING = Detections(torch.zeros(0, 4), torch.zeros(0, len(CLASSES)))
PEDESTRIAN, CYCLIST, CAR = [0.8, 0.1, 0.05, 0.0], [0.1, 0.7, 0.0, 0.0], [0.0, 0.0, 0.9, 0.0]  # scores
CHILD = (0.45, 1.2)  # m


def detections(*boxes: Box, scores: list[list[float]] | None = None) -> Detections:
    given = scores or [PEDESTRIAN] * len(boxes)
    return Detections(torch.tensor(boxes, dtype=torch.float32).view(-1, 4), torch.tensor(given).view(-1, len(CLASSES)))


def moved(box: Box, left: float = 0, top: float = 0, right: float = 0, bottom: float = 0) -> Box:
    return box[0] + left, box[1] + top, box[2] + right, box[3] + bottom


def plate(x: float, y: float, width_m: float, height_m: float) -> Box:
    """Its box, upright on the road."""
    corners = torch.tensor([[x, y + width_m / 2, height_m], [x, y - width_m / 2, 0.0]], dtype=torch.float64).T
    left, top, right, bottom = VIEW.project(corners)[0].T.flatten().tolist()
    return left, top, right, bottom


def shown(frames: int, params: TrackerParams = TRACKER.params, then: int = 0, rate_hz: float = RATE_HZ) -> Tracks:
    """Tracks after so many frames with one box, then so many with none."""
    return tracked([detections(BOX)] * frames + [NOTHING] * then, Tracker(CLASSES, VIEW, params), rate_hz)


def tracked(frames: list[Detections], tracker: Tracker = TRACKER, rate_hz: float = RATE_HZ) -> Tracks:
    tracks = tracker.start()
    for k, each in enumerate(frames):
        tracks = tracker.step(tracks, each, k / rate_hz)
    return tracks


def test_a_new_object_is_reported_after_the_frames_that_confirm_it():
    assert [len(shown(n).confirmed_tracks) for n in (1, 2, 3, 4)] == [0, 0, 1, 1]
    assert float(shown(5).confirmed_tracks.since_s) == pytest.approx(2 / RATE_HZ)
    assert len(shown(1, TrackerParams(confirm_frames=1)).confirmed_tracks) == 1
    assert len(shown(2, then=1)) == 0  # what a single miss tells from an object is dropped
    assert len(tracked([detections(BOX, scores=[[0.49, 0.1, 0, 0]])])) == 0


def test_a_lost_one_is_kept_for_a_while_then_lost_then_forgotten():
    kept, lost = (shown(30, then=round(RATE_HZ * TRACKER.params.keep_s) + more) for more in (-1, 1))
    assert math.isinf(float(kept.confirmed_tracks.until_s)) and bool(kept.confirmed_tracks.score.isnan().all())
    assert float(lost.confirmed_tracks.until_s) == pytest.approx(
        29 / RATE_HZ + TRACKER.params.keep_s, abs=1.1 / RATE_HZ
    )  # the first frame after it
    assert [len(TRACKER.step(lost, NOTHING, lost.time_s + share * LINGER_S)) for share in (0.9, 1.1)] == [1, 0]
    again = TRACKER.step(lost, detections(BOX), lost.time_s + 1 / RATE_HZ)
    assert sorted(again.number.tolist()) == [1, 2]  # the number of a lost one is not given again


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 100.0])
@pytest.mark.parametrize("score", [0.4, 0.8, 1.0])
def test_a_track_outlasts_misses_by_the_log_odds_of_its_detections_and_no_longer_than_keep_s(rate_hz, score):
    """A miss costs 1, a detection after the first gains logit(score) - logit(start_score), where scores above 0.95 count as 0.95."""
    start = TRACKER.params.start_score
    ratio = min(score, 0.95) / (1 - min(score, 0.95)) * (1 - start) / start
    for frames, keep_s in ((3, 1.0), (4, 10.0), (10, 0.4)):
        params = TrackerParams(keep_s=keep_s)
        known = tracked(
            [detections(BOX)] + [detections(BOX, scores=[[score, 0.1, 0, 0]])] * (frames - 1), Tracker(CLASSES, VIEW, params), rate_hz
        )
        confirmed = replace(known, since_s=torch.zeros(1).double())  # also where the score starts no track
        kept = max(round(min((frames - 1) * math.log(ratio), keep_s * rate_hz)), 0)
        found = []
        for k in range(kept + 1):
            confirmed = Tracker(CLASSES, VIEW, params).step(confirmed, NOTHING, (frames + k) / rate_hz)
            found.append(len(confirmed.present))
        assert found == [1] * kept + [0]


@pytest.mark.parametrize("time_constant_s", [0.0, 0.15])
def test_confidence_is_a_first_order_filter_of_scores(time_constant_s):
    params = TrackerParams(confidence_s=time_constant_s)
    tracks, tracker = shown(10, params), Tracker(CLASSES, VIEW, params)
    step, missed = (tracker.step(tracks, each, 10 / RATE_HZ) for each in (detections(BOX, scores=[[0.2, 0.9, 0.05, 0.0]]), NOTHING))
    share = 1.0 if time_constant_s == 0 else 1 - math.exp(-1 / RATE_HZ / time_constant_s)
    # rtol: scores come in float32
    torch.testing.assert_close(step.confidence[0, :2], torch.tensor([0.8 - 0.6 * share, 0.1 + 0.8 * share]).double(), rtol=1e-6, atol=1e-7)
    assert float(missed.confidence[0, 0]) == pytest.approx(0.8 * (1 - share))
    assert CLASSES[int(step.category)] == ("pedestrian" if time_constant_s else "cyclist")  # one frame does not change a filtered class


@pytest.mark.parametrize(("other", "category"), [(0.6, "pedestrian"), (0.95, "cyclist")])
def test_a_class_changes_only_where_the_detector_is_much_surer(other, category):
    tracks = tracked([detections(BOX)] * 10 + [detections(BOX, scores=[[0.4, other, 0.0, 0.0]])] * 50)
    assert CLASSES[int(tracks.category)] == category


def test_the_filter_is_the_matrix_form_of_kalmans():
    tracks = shown(2)
    ahead, dt = TRACKER.at(tracks, 0.2), 0.2 - tracks.time_s
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


@pytest.mark.parametrize(("speed_m_s", "off_px"), [(8.0, 3.0), (20.0, 12.0)])
def test_who_comes_nearer_is_expected_where_constant_velocity_on_the_road_leads(speed_m_s, off_px):
    """After 0.3 s without a detection; constant rates in the image err by 11 and 41 px."""
    cars = [plate(12.0 + speed_m_s * (29 - k) / RATE_HZ, 2.0, *SIZES["car"]) for k in range(30)]
    tracks = tracked([detections(each, scores=[CAR]) for each in cars[:21]] + [NOTHING] * 9)
    assert (TRACKER.whole(tracks)[0] - torch.tensor(cars[-1])).abs().max() < off_px


def test_two_boxes_of_one_place_are_two_tracks_and_a_far_one_is_not_taken():
    far = moved(BOX, 300, 0, 300)
    after = TRACKER.step(shown(5), detections(BOX, far), 5 / RATE_HZ)
    assert after.number.tolist() == [1, 2] and after.frames.tolist() == [6, 1]
    other_order = TRACKER.step(after, detections(far, BOX), 6 / RATE_HZ)
    assert other_order.number.tolist() == [1, 2] and other_order.frames.tolist() == [7, 2]


def test_tracks_are_a_value():
    tracks = shown(5)
    after, again = (TRACKER.step(each, detections(BOX), 5 / RATE_HZ) for each in (tracks, pickle.loads(pickle.dumps(tracks))))
    assert tracks.frames.tolist() == [5]
    assert all(torch.equal(getattr(after, name), getattr(again, name)) for name in EACH if name != "score")


def test_weak_detections_neither_move_nor_take_nor_start_a_track():
    tracks = shown(10)
    weak = detections(moved(BOX, 30, 0, 30), scores=[[0.1, 0.0, 0.0, 0.0]])
    aside, missed = (TRACKER.step(tracks, each, 10 / RATE_HZ) for each in (weak, NOTHING))
    torch.testing.assert_close(aside.mean, missed.mean)
    assert bool(aside.score.isnan().all())
    missing, large = shown(20, then=5), moved(BOX, 5, -20, 45, 18)
    for score, matches in ((0.3, False), (0.9, True)):
        after = TRACKER.step(missing, detections(large, scores=[[score, 0.0, 0.0, 0.0]]), 25 / RATE_HZ)
        assert bool(after.score[0].isnan().all()) != matches
    half = detections(BOX, scores=[[0.5 * TRACKER.params.start_score + 0.01, 0.0, 0.0, 0.0]])
    assert len(tracked([half])) == 0
    kept = tracked([detections(BOX)] * 10 + [half] * 20)  # half the score that starts a track keeps it
    assert kept.number.tolist() == [1] and float(kept.score.max()) > 0 and bool(kept.until_s.isinf().all())


def test_a_size_follows_what_is_seen_and_stays_as_its_object_comes_nearer():
    tracks = tracked([detections(plate(30 - k / 3, 1.0, *SIZES["pedestrian"])) for k in range(45)])
    assert tracks.number.tolist() == [1]
    # A plate of 1.75 m; rows of a camera that looks down by 1.5 deg are 0.1 % farther apart
    assert tracks.size_m[0].tolist() == pytest.approx(SIZES["pedestrian"], rel=0.02)
    before, legs = TRACKER.boxes(shown(10)), detections(moved(BOX, 4, 30, -4))
    # After 0.1 s of the time constant of 1 s a tenth of the way to the logarithm of 0.7, 3.5 % of 100 px
    assert float((TRACKER.boxes(tracked([detections(BOX)] * 10 + [legs] * 3)) - before)[0, 1]) == pytest.approx(3.5, abs=0.5)
    after = tracked([detections(BOX)] * 10 + [legs] * 90)
    left, top, right, bottom = (TRACKER.boxes(after) - before)[0].tolist()
    assert after.number.tolist() == [1] and top == pytest.approx(30, abs=3) and bottom == pytest.approx(0, abs=1)
    assert left == pytest.approx(-right, abs=1)


@pytest.mark.parametrize(("high", "wide", "least", "most"), [(0.6, 0.4, 1.0, 1.1), (1.75, 3.0, 1.7, 1.8), (1.75, 0.1, 1.7, 1.8)])
def test_sizes_are_those_of_the_class(high, wide, least, most):
    """What is found may be half of somebody, or of two."""
    u, foot, metre = 320.0, BOX[3], (BOX[3] - BOX[1]) / 1.755
    tracks = tracked([detections((u - wide * metre / 2, foot - high * metre, u + wide * metre / 2, foot))] * 5)
    width_m, height_m = tracks.size_m[0].tolist()
    assert WIDTHS_M["pedestrian"][0] <= width_m <= WIDTHS_M["pedestrian"][1] and least <= height_m <= most


def walk(k: float, px: float = 4.0) -> Box:
    """BOX, moved by so many px a frame."""
    return moved(BOX, px * k, 0, px * k)


def test_whoever_goes_behind_something_comes_out_on_the_other_side():
    """From the 20th frame on less and less is seen, without feet, then nothing, then a part."""
    tracks = TRACKER.start()
    for k in range(50):
        left, top, right, bottom = walk(k - 30)
        hides = 20 <= k < 45
        seen_right = min(right, walk(-10)[2]) if hides else right
        box = (left, top, seen_right, bottom - 20 * hides)
        tracks = TRACKER.step(tracks, detections(box) if seen_right - left > 10 and k != 45 else NOTHING, k / RATE_HZ)
        if 28 <= k < 45:
            assert float(tracks.mean[0, 0, 1]) == pytest.approx(4 * RATE_HZ, rel=0.15)  # 8 parts of which each tells a little less
    assert tracks.number.tolist() == [1]
    assert (TRACKER.boxes(tracks)[0] - torch.tensor(walk(19))).abs().max() < 6  # px; 5 % of its height


def test_a_box_of_two_who_pass_each_other_moves_neither():
    """For eight frames the detector finds the nearer one alone, who lags as strides do."""
    other, frames = moved(BOX, -3, -3, -3, -3), []
    for k in range(-25, 25):
        right, left = walk(k, 2.5), moved(other, -2.5 * k, 0, -2.5 * k)
        frames.append(detections(*((right, left) if abs(k) > 4 else (walk(k - 2, 2.5),))))
    tracks = tracked(frames)
    assert tracks.number.tolist() == [1, 2]
    wanted = torch.tensor([walk(24, 2.5), moved(other, -60, 0, -60)]).double()
    torch.testing.assert_close(TRACKER.boxes(tracks), wanted, rtol=0, atol=2.0)  # px, half of the noise that is reckoned with


@pytest.mark.parametrize("side", [-1, 1])
def test_whoever_walks_out_of_the_image_is_followed_to_its_border_and_no_longer(side):
    tracks, found = TRACKER.start(), 0
    for k in range(90):
        left, top, right, bottom = plate(12.0, side * (2.0 + 1.4 * k / RATE_HZ), *SIZES["pedestrian"])
        inside = max(left, 0.0), top, min(right, float(VIEW.width)), bottom
        share = (inside[2] - inside[0]) / (right - left)
        tracks = TRACKER.step(tracks, detections(inside) if share > 0.3 else NOTHING, k / RATE_HZ)
        if k > 2 and share > 0.3:
            found += share < 0.9
            whole = torch.tensor([left, top, right, bottom]).double()
            assert (TRACKER.whole(tracks.present)[0] - whole).abs().max() < 2  # px; exact boxes, a filter that knows no size yet
        if share < 0:
            assert len(tracks.present) == 0
    assert found > 3


@pytest.mark.parametrize(("side", "seed"), [(-1, 0), (1, 1)])
def test_whoever_leaves_the_image_keeps_its_number_where_frames_miss_it(side, seed):
    """Half of the car is outside from the 8th frame on, which is found 34 frames longer, nine times of ten."""
    rng = torch.Generator().manual_seed(seed)
    frames, missed = [], 0
    for k in range(45):
        left, top, right, bottom = plate(12.0, side * (3.0 + k / RATE_HZ), *SIZES["car"])
        box = (max(left, 0), top, min(right, VIEW.width), bottom)
        found = k < 3 or float(torch.rand(1, generator=rng)) > 0.1
        missed += not 0 < (left + right) / 2 < VIEW.width and not found
        frames.append(detections(box, scores=[CAR]) if found and box[2] - box[0] > 0.2 * (right - left) else NOTHING)
    assert missed > 0 and tracked(frames).following == 2


def test_what_is_expected_too_low_comes_back_to_where_it_is_seen():
    """A box that was too large holds all that is found afterwards, which must not keep it where it is."""
    box = plate(20.0, 0.0, *CHILD)
    tracks = tracked([detections(moved(box, -10, -15, 10, 20))] * 5 + [detections(box)] * 55)
    assert tracks.number.tolist() == [1]
    # 2 s are two time constants of the size: a seventh is left of what is too much, 35 px of height
    assert (TRACKER.boxes(tracks)[0] - torch.tensor(box)).abs().max() < 6


PART = moved(BOX, 5, 40, -5, -5)
CARS = [plate(*each) for each in ((40.0, 2.0, *SIZES["car"]), (20.0, 1.0, 3.0, 2.1))]
ADULT, SHORT, BEHIND = plate(15.0, 0.0, *SIZES["pedestrian"]), plate(14.7, 0.05, *CHILD), plate(17.0, 0.05, *CHILD)


@pytest.mark.parametrize(
    ("known", "then", "frames", "tracks"),
    [
        (detections(BOX), detections(BOX, PART, scores=[PEDESTRIAN, CYCLIST]), 5, 1),  # a part of what is known
        (detections(BOX), detections(BOX, PART, scores=[PEDESTRIAN, CAR]), 5, 2),  # of another kind
        (detections(CARS[0], scores=[CAR]), detections(*CARS, scores=[CAR, CAR]), 5, 1),  # around a car that is seen whole
        (detections(CARS[0], scores=[CAR]), detections(CARS[1], scores=[CAR]), 5, 2),
        (detections(ADULT), detections(ADULT, SHORT), 15, 2),  # a child before an adult, in whose box it lies
        (detections(ADULT), detections(ADULT, BEHIND), 15, 1),  # and behind, as legs alone
    ],
)
def test_a_detection_within_another_starts_a_track_or_is_a_part(known, then, frames, tracks):
    after = tracked([known] * 5 + [then] * frames)
    assert len(after.present) == tracks
    if then.boxes[-1].tolist() == pytest.approx(SHORT, rel=1e-6):
        assert sorted(after.size_m[:, 1].tolist()) == pytest.approx([CHILD[1], SIZES["pedestrian"][1]], rel=0.05)
