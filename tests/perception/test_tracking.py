"""Tracks keep their identity: through crossings, overtaking, occlusion, noise and misses; the filters do what their equations say."""

import math
import pickle
from collections.abc import Callable
from dataclasses import fields, replace

import pytest
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from perception.camera import CameraParams, camera_view
from perception.detection.protocol import Detections
from perception.detection.suppression import overlaps
from perception.tracking import EACH, LINGER_S, TrackerParams, Tracks, no_tracks, track
from world.tracked import Category

CLASSES: tuple[Category, ...] = ("pedestrian", "cyclist", "car", "animal")
RATE_HZ = 30.0
VIEW = camera_view(CameraParams(width_px=640, height_px=360, pitch_deg=1.5))
SIZES: dict[Category, tuple[float, float]] = {"pedestrian": (0.6, 1.75), "cyclist": (0.7, 1.8), "car": (1.8, 1.5)}
Road = Callable[[float], tuple[Category, float, float]]  # class, x and y in m at a time


def seen(objects: list[tuple[Category, float, float]]) -> tuple[Tensor, list[bool]]:
    """Boxes `[n, 4]` px of upright plates on the road, and whether more than 60 % of one is behind a nearer one."""
    boxes = []
    for category, x, y in objects:
        width, height = SIZES[category]
        corners = torch.tensor([[x, y + width / 2, height], [x, y - width / 2, 0.0]], dtype=torch.float64).T
        boxes.append(VIEW.project(corners)[0].T.flatten())
    stacked = torch.stack(boxes)
    hidden = []
    for k, (_, x, _) in enumerate(objects):
        low, high = torch.maximum(stacked[k, :2], stacked[:, :2]), torch.minimum(stacked[k, 2:], stacked[:, 2:])
        covered = (high - low).clamp(min=0).prod(-1) / (stacked[k, 2:] - stacked[k, :2]).prod()
        hidden.append(any(covered[j] > 0.6 and objects[j][1] < x for j in range(len(objects)) if j != k))
    return stacked, hidden


def identities(roads: list[Road], frames: int, seed: int, noise: float = 0.04, misses: float = 0.1) -> list[set[int]]:
    """Numbers that each object's confirmed tracks bore; boxes are noisy and missing as a detector's are.

    As for MOTA, an object's track stays its own while it overlaps by 0.3, and other pairs are those of most overlap.
    """
    rng = torch.Generator().manual_seed(seed)
    tracks, found, owner = no_tracks(CLASSES), [set[int]() for _ in roads], dict[int, int]()
    for k in range(frames):
        objects = [road(k / RATE_HZ) for road in roads]
        true, hidden = seen(objects)
        size = (true[:, 2:] - true[:, :2]).prod(-1, keepdim=True).sqrt()
        boxes = true + noise * size * torch.randn(true.shape, generator=rng, dtype=torch.float64)
        shown = torch.tensor([not each for each in hidden]) & (torch.rand(len(roads), generator=rng) > misses)
        scores = 0.1 * torch.rand(len(roads), len(CLASSES), generator=rng, dtype=torch.float64)
        for n, (category, _, _) in enumerate(objects):
            scores[n, CLASSES.index(category)] = 0.4 + 0.4 * float(torch.rand(1, generator=rng))
        tracks = track(tracks, Detections(boxes[shown], scores[shown]), k / RATE_HZ, TrackerParams())
        known = tracks.known
        known = known.take(known.until_s.isinf())
        shares, numbers = overlaps(true, known.boxes), known.number.tolist()
        for n, number in owner.items():
            if number in numbers and shares[n, numbers.index(number)] > 0.3:
                shares[n, numbers.index(number)] += 2
        owner = {n: numbers[j] for n, j in zip(*linear_sum_assignment(-shares), strict=True) if shown[n] and shares[n, j] > 0.3} | {
            n: number for n, number in owner.items() if not shown[n]
        }
        for n, number in owner.items():
            found[n].add(number)
    return found


def line(category: Category, x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Road:
    return lambda t: (category, x + vx * t, y + vy * t)


SCENES: dict[str, list[Road]] = {
    "two pedestrians cross": [line("pedestrian", 15, 3, vy=-1.4), line("pedestrian", 16, -3, vy=1.4)],
    "two pedestrians cross side by side": [line("pedestrian", 15, 2, vy=-1.4), line("pedestrian", 15.2, -2, vy=1.2)],
    "a cyclist overtakes": [line("pedestrian", 12, -2, vx=1.2), line("cyclist", 8.5, -1.2, vx=5)],
    "a cyclist is overtaken by a car": [line("cyclist", 14, -1.0, vx=4), line("car", 9, 0.5, vx=9)],
    "ten frames behind a car": [line("car", 14, 0, vy=0), line("pedestrian", 18, -2.2, vy=4.2)],
}


@pytest.mark.parametrize("name", SCENES)
def test_nobody_changes_identity(name: str) -> None:
    for seed in range(5):
        for numbers in identities(SCENES[name], 110, seed):
            assert len(numbers) == 1, f"{name}, seed {seed}: {numbers}"


def test_an_occlusion_of_ten_frames_is_one() -> None:
    hidden = sum(seen([road(k / RATE_HZ) for road in SCENES["ten frames behind a car"]])[1][1] for k in range(110))
    assert hidden >= 10


def detections(*boxes: tuple[float, float, float, float], scores: list[list[float]] | None = None) -> Detections:
    given = scores or [[0.8, 0.1, 0.05, 0.0]] * len(boxes)
    return Detections(torch.tensor(boxes, dtype=torch.float32).view(-1, 4), torch.tensor(given).view(-1, len(CLASSES)))


BOX = (300.0, 100.0, 340.0, 200.0)
DEFAULTS = TrackerParams()
NOTHING = Detections(torch.zeros(0, 4), torch.zeros(0, len(CLASSES)))


def shown(frames: int, params: TrackerParams = DEFAULTS, then: int = 0) -> Tracks:
    """Tracks after so many frames with one box, then so many with none."""
    tracks = no_tracks(CLASSES)
    for k in range(frames + then):
        tracks = track(tracks, detections(BOX) if k < frames else NOTHING, k / RATE_HZ, params)
    return tracks


def test_a_new_object_is_reported_after_the_frames_that_confirm_it() -> None:
    assert [len(shown(n).known) for n in (1, 2, 3, 4)] == [0, 0, 1, 1]
    assert float(shown(5).known.since_s) == pytest.approx(2 / RATE_HZ)
    assert len(shown(1, TrackerParams(confirm_frames=1)).known) == 1
    assert len(shown(2, then=1)) == 0  # what a single miss tells from an object is dropped
    weak = track(no_tracks(CLASSES), detections(BOX, scores=[[0.29, 0.1, 0, 0]]), 0.0, DEFAULTS)
    assert len(weak) == 0


def test_one_that_is_lost_is_kept_for_a_while_then_told_as_lost_then_forgotten() -> None:
    keep_s = DEFAULTS.keep_s
    kept = shown(10, then=20)
    assert math.isinf(float(kept.known.until_s)) and bool(kept.known.score.isnan().all())
    lost = shown(10, then=22)
    assert float(lost.known.until_s) == pytest.approx(9 / RATE_HZ + keep_s, abs=1.1 / RATE_HZ)  # the first frame after it
    later = replace(lost, time_s=lost.time_s)
    assert len(track(later, NOTHING, lost.time_s + 0.9 * LINGER_S, DEFAULTS)) == 1
    assert len(track(later, NOTHING, lost.time_s + 1.1 * LINGER_S, DEFAULTS)) == 0
    again = track(lost, detections(BOX), lost.time_s + 1 / RATE_HZ, DEFAULTS)
    assert sorted(again.number.tolist()) == [1, 2]  # the name of a lost one is not given again


@pytest.mark.parametrize("time_constant_s", [0.0, 0.15, 1.0])
def test_confidence_is_a_first_order_filter_of_scores(time_constant_s: float) -> None:
    params = TrackerParams(confidence_s=time_constant_s)
    tracks = shown(10, params)
    step = track(tracks, detections(BOX, scores=[[0.2, 0.9, 0.05, 0.0]]), 10 / RATE_HZ, params)
    share = 1.0 if time_constant_s == 0 else 1 - math.exp(-1 / RATE_HZ / time_constant_s)
    # rtol: scores come in float32
    torch.testing.assert_close(step.confidence[0, :2], torch.tensor([0.8 - 0.6 * share, 0.1 + 0.8 * share]).double(), rtol=1e-6, atol=1e-7)
    missed = track(tracks, NOTHING, 10 / RATE_HZ, params)
    assert float(missed.confidence[0, 0]) == pytest.approx(0.8 * (1 - share))


def test_one_frame_of_another_class_does_not_change_the_class() -> None:
    tracks = track(shown(10), detections(BOX, scores=[[0.2, 0.9, 0.05, 0.0]]), 10 / RATE_HZ, DEFAULTS)
    assert tracks.number.tolist() == [1] and CLASSES[int(tracks.category)] == "pedestrian"


def test_boxes_are_smoother_than_detections_and_move_as_they_do() -> None:
    rng = torch.Generator().manual_seed(1)
    tracks, errors, raw = no_tracks(CLASSES), [], []
    for k in range(60):
        true = torch.tensor([[100.0 + 4 * k, 100, 140 + 4 * k, 200]])
        noisy = true + 3 * torch.randn(1, 4, generator=rng)
        if k > 20:  # where it will be, said before it is seen
            errors.append(float((tracks.at(k / RATE_HZ).boxes - true).abs().mean()))
            raw.append(float((noisy - true).abs().mean()))
        tracks = track(tracks, Detections(noisy, torch.tensor([[0.8, 0, 0, 0]])), k / RATE_HZ, DEFAULTS)
    assert sum(errors) < sum(raw)  # a prediction by one frame is better than the measurement of that frame
    assert float(tracks.mean[0, 0, 1]) == pytest.approx(4 * RATE_HZ, rel=0.1)


def test_the_filter_is_the_matrix_form_of_kalmans() -> None:
    tracks = shown(2)
    ahead = tracks.at(0.2)
    dt = 0.2 - tracks.time_s
    F = torch.tensor([[1, dt], [0, 1]], dtype=torch.float64)
    Q = torch.tensor([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], dtype=torch.float64)
    size = 4000**0.5  # of the box, 40 px by 100 px
    q = torch.tensor([2.0 * size, 0.5 * size, 0.5, 0.5], dtype=torch.float64) ** 2
    expected = F @ tracks.covariance[0] @ F.T + q[:, None, None] * Q
    torch.testing.assert_close(ahead.covariance[0], expected)
    after = track(tracks, detections((310, 105, 352, 204)), 0.2, DEFAULTS)
    H, R = torch.tensor([[1.0, 0.0]], dtype=torch.float64), (0.05 * size) ** 2
    P, z = expected[0], 331.0
    K = P @ H.T / (H @ P @ H.T + R)
    torch.testing.assert_close(after.mean[0, 0], ahead.mean[0, 0] + K[:, 0] * (z - ahead.mean[0, 0, 0]))
    torch.testing.assert_close(after.covariance[0, 0], (torch.eye(2).double() - K @ H) @ P)


def test_two_boxes_of_one_place_are_two_tracks_and_a_far_one_is_not_taken() -> None:
    tracks = shown(5)
    far = (BOX[0] + 300, BOX[1], BOX[2] + 300, BOX[3])
    after = track(tracks, detections(BOX, far), 5 / RATE_HZ, DEFAULTS)
    assert after.number.tolist() == [1, 2] and after.frames.tolist() == [6, 1]
    swapped = track(after, detections(far, BOX), 6 / RATE_HZ, DEFAULTS)
    assert swapped.number.tolist() == [1, 2] and swapped.frames.tolist() == [7, 2]


def test_tracks_are_a_value() -> None:
    tracks = shown(5)
    kept = pickle.loads(pickle.dumps(tracks))
    after, again = (track(each, detections(BOX), 5 / RATE_HZ, DEFAULTS) for each in (tracks, kept))
    assert set(EACH) <= {each.name for each in fields(tracks)} and tracks.frames.tolist() == [5]
    assert all(torch.equal(getattr(after, name), getattr(again, name)) for name in EACH if name != "score")
