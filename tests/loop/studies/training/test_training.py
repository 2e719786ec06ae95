"""Training a detector: scenes in the dark, light for them, what is learnt from them, and how it is evaluated."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from luxloop import Detections, LuxloopError
from luxloop.loop.studies.jobs import local
from luxloop.loop.studies.training import fit
from luxloop.loop.studies.training.evaluate import boxes_right, evaluate, score_frame
from luxloop.loop.studies.training.fit import SIZE, Examples, targets
from luxloop.loop.studies.training.light import WELL_LIT_LX, darken, full_light, lit_alone, lit_share, luminance, object_light
from luxloop.loop.studies.training.scenes import CAMERA, CLASSES, HELD_OUT, TRAINING, DarkScene, SceneObject, draw, read
from luxloop.loop.studies.training.train import LEAST_SCORE, calibrate, draw_scenes, logistic, page, store
from luxloop.perception.detection.build import WEIGHTS, detector
from luxloop.perception.detection.detector import NetworkParams
from luxloop.perception.detection.network import STRIDE, NetworkDetector
from tests.loop.conftest import assert_refused

CPU = torch.device("cpu")
ROOT = Path(__file__).parents[4]
REPORT = (ROOT / "perception" / "detection" / WEIGHTS).with_suffix(".json")


@pytest.fixture(scope="module")
def row(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    folder = str(tmp_path_factory.mktemp("scenes"))
    return {**draw(HELD_OUT + 1, folder), "seed": HELD_OUT + 1, "folder": folder}


def plain(distance: float, box: tuple[float, float, float, float] | None = None) -> DarkScene:
    """A white wall at 30 m, with a white pedestrian before it where there is a box."""
    shape, wall = (120, 200), torch.full((120, 200), 30.0)
    object_id = torch.zeros(shape, dtype=torch.int32)
    objects: tuple[SceneObject, ...] = ()
    if box is not None:
        u0, v0, u1, v1 = map(int, box)
        object_id[v0:v1, u0:u1] = 1
        wall[v0:v1, u0:u1] = distance
        objects = (SceneObject(1, 0, box, 1.0, 1.0),)
    return DarkScene(torch.full(shape, 1 / math.pi), wall, torch.zeros(shape), torch.zeros(shape), object_id, 0.0, objects)


def test_a_scene_reflects_what_its_materials_let_it(row):
    scene = read(row)
    assert scene.shape == (CAMERA.height_px, CAMERA.width_px)
    assert (scene.lamps >= 0).all() and (scene.sky >= 0).all() and (scene.sky <= 1 / math.pi + 1e-3).all()
    # but for what is glossy or sends light back, nothing looks brighter than a white wall that faces the lamps
    assert (scene.lamps <= 1 / math.pi).float().mean() > 0.98
    assert (scene.distance[scene.object_id < 0].isinf() | (scene.distance[scene.object_id < 0] >= 6e4)).all()
    assert len(scene.objects) >= 3 and all((scene.object_id == each.object_id).any() for each in scene.objects)
    assert torch.allclose(luminance(scene, 8.0) - luminance(scene, 0.0), 8 * scene.lamps, rtol=1e-3, atol=1e-3)  # own light is up to 3e4


def test_parts_and_mirror_images_keep_boxes_on_their_objects(row):
    whole, part = read(row), read(row, slice(60, 300), slice(100, 500)).mirror()
    for each in part.objects:
        (same,) = (other for other in whole.objects if other.object_id == each.object_id)
        u0, v0, u1, v1 = same.box
        expected = [400 - min(u1 - 100, 400), max(v0 - 60, 0), 400 - max(u0 - 100, 0), min(v1 - 60, 240)]
        assert list(each.box) == pytest.approx(expected)
        seen = torch.nonzero(part.object_id == each.object_id)
        if each.visible > 0.99 and len(seen):
            # the truth's box is that of corners, pixels are seen at their centres
            low, high = seen.amin(0), seen.amax(0) + 1
            assert abs(low[1] - each.box[0]) <= 2 and abs(high[0] - each.box[3]) <= 2


def test_the_nearer_object_hides_the_farther_one():
    far, near = plain(20.0, (50, 20, 90, 100)), plain(10.0, (70, 20, 110, 100))
    for both in (far.behind(near), near.behind(far)):
        assert sorted((each.visible, each.box[0]) for each in both.objects) == [(0.5, 50), (1.0, 70)]
        assert both.object_id.unique().numel() == 3


def test_the_lit_share_of_an_object_is_of_what_is_seen():
    scene = plain(20.0, (50, 20, 90, 100))
    light = torch.zeros(scene.shape)
    light[20:40, 50:90] = WELL_LIT_LX
    assert lit_share(scene, light, WELL_LIT_LX).tolist() == [0.25]
    for seed in range(20):
        for kind in (full_light, object_light):
            anything = kind(scene, np.random.default_rng(seed))
            assert anything.shape == scene.shape and (anything >= 0).all() and anything.isfinite().all()


def test_object_based_light_leaves_heads_dark_and_lights_bodies():
    scene = plain(20.0, (50, 20, 90, 100))
    light = lit_alone(scene, 20.0, 0.1, {"pedestrian": 0.25}, 0.5, 0.5)
    # 3 px from the edge are 6 of its scales, where 20 lx are less than 0.05 lx from what was asked for
    assert torch.allclose(light[20:37, 50:90], torch.tensor(0.5), atol=0.05)
    assert torch.allclose(light[43:97, 53:87], torch.tensor(20.0), atol=0.1)
    assert torch.allclose(light[:, :35], torch.tensor(0.1)) and torch.allclose(light[:, 110:], torch.tensor(0.1))
    assert float(lit_share(scene, light, WELL_LIT_LX)) == pytest.approx(0.75, abs=2 / 80)  # a row of 80 to both sides
    whole = lit_alone(scene, 20.0, 0.1, {}, 0.5, 0.5)
    assert torch.allclose(darken(scene, whole, scene.objects[0], 0.25, 0.5, 0.5), light)


def test_targets_are_the_middles_and_boxes_of_what_must_be_found():
    boxes = torch.tensor([[40.0, 40, 80, 140], [200, 60, 300, 120], [320, 100, 340, 160]])
    heat, counts, of_cell, share = targets(boxes, torch.tensor([0, 2, 1]), torch.tensor([True, True, False]))
    assert heat.shape == (4, SIZE[0] // STRIDE, SIZE[1] // STRIDE)
    assert torch.nonzero(heat == 1).tolist() == [[0, 90 // 8, 60 // 8], [2, 90 // 8, 250 // 8]]
    assert counts[:, 130 // 8, 330 // 8].tolist() == [0, 0, 0, 0] and counts[:, 0, 0].tolist() == [1, 1, 1, 1]
    assert of_cell[:, 11, 7].tolist() == boxes[0].tolist() and of_cell[:, 11, 31].tolist() == boxes[1].tolist()
    assert float(share.sum()) == pytest.approx(2)  # 1 an object
    nothing = targets(boxes[:0], torch.zeros(0).long(), torch.zeros(0).bool())
    assert float(nothing[0].sum()) == 0 and float(nothing[1].mean()) == 1 and float(nothing[3].sum()) == 0


def test_losses_are_least_for_what_is_true():
    boxes = torch.tensor([[40.0, 40, 80, 140], [200, 60, 300, 120]])
    parts = targets(boxes, torch.tensor([0, 2]), torch.tensor([True, True]))
    given = Examples(torch.zeros(1, *SIZE), *(each[None] for each in parts))
    right = torch.where(given.heat == 1, 9.0, -9.0)
    assert float(fit.heat_loss(right, given)) < 0.01 < float(fit.heat_loss(-right, given))
    at = fit.middles(*given.share.shape[1:], CPU)
    sides = torch.cat([at - given.boxes[:, :2], given.boxes[:, 2:] - at], 1)
    assert float(fit.box_loss(sides, given)) == pytest.approx(0, abs=1e-5)
    assert float(fit.box_loss(sides * 1.2, given)) > 0.1


def test_what_object_based_light_takes_from_a_logit_is_a_loss_of_that_light_alone():
    parts = targets(torch.tensor([[40.0, 40, 80, 140]]), torch.tensor([2]), torch.tensor([True]))
    given = Examples(torch.zeros(2, *SIZE), *(torch.stack([each, each]) for each in parts))
    logits = torch.zeros(2, 4, *given.share.shape[1:])
    assert float(fit.agree_loss(logits, given)) == 0
    logits[0, 2], logits[1, 0] = 1.0, -9.0  # full light is surer; other classes do not count
    lost = logits.requires_grad_()
    loss = fit.agree_loss(lost, given)
    loss.backward()
    assert float(loss.detach()) == pytest.approx(0.75)  # 1 - beta / 2, of one object
    assert lost.grad is not None and (lost.grad[0] == 0).all() and (lost.grad[1, 2] < 0).any() and (lost.grad[1, 0] == 0).all()
    assert float(fit.agree_loss(logits.flip(0), given).detach()) == 0  # nothing is lost where object-based light is surer
    dark = replace(given, share=torch.stack([parts[3], 0 * parts[3]]))
    assert float(fit.agree_loss(logits, dark).detach()) == 0


def test_examples_come_from_a_seed(row):
    first, again, other = (Examples.draw([row], 3, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert torch.equal(first.frames, again.frames) and torch.equal(first.heat, again.heat)
    assert not torch.equal(first.frames, other.frames)
    assert first.frames.shape == (6, *SIZE) and first.frames.min() >= 0 and first.frames.max() <= 1
    full, alone = first.frames.chunk(2)
    assert alone.mean() < 0.7 * full.mean()
    of_full, of_alone = first.boxes.movedim(1, -1).chunk(2)
    both = (first.share > 0).view(2, 3, *first.share.shape[1:]).all(0)
    same = (of_full == of_alone).all(-1)[both]
    assert len(same) and same.float().mean() > 0.8  # but where one of two that overlap is dark


def test_what_is_too_dark_is_not_there_and_what_is_dim_does_not_count():
    scene = plain(20.0, (50, 20, 90, 100))
    dark, dim, lit = (fit.example(scene, torch.full(scene.shape, lx), 1.0, np.random.default_rng(0)) for lx in (0.1, 1.0, 10.0))
    middle = (60 * SIZE[0] // 120 // STRIDE, 70 * SIZE[1] // 200 // STRIDE)
    counts = [each[2][(0, *middle)] for each in (dark, dim, lit)]
    assert counts == [1, 0, 1]
    assert [int((each[1] == 1).sum()) for each in (dark, dim, lit)] == [0, 0, 1] and lit[1][(0, *middle)] > 0.5
    # as bright by a street lamp as by 1 lx of the headlamps, on one half
    half = scene.own.clone()
    half[20:60] = scene.lamps[20:60]
    assert fit.example(replace(scene, own=half), torch.zeros(scene.shape), 1.0, np.random.default_rng(0))[2][(0, *middle)] == 0


ONE = SceneObject(1, 0, (10.0, 10.0, 30.0, 60.0), 1.0, 1.0)
SMALL = replace(ONE, box=(200.0, 0.0, 210.0, 20.0))  # too small to be asked for


def test_metrics_count_what_is_found_missed_and_false():
    objects = [ONE, replace(ONE, label=2, box=(100.0, 10.0, 160.0, 50.0)), SMALL]
    boxes = torch.tensor([[10.0, 10, 30, 58], [11, 10, 30, 60], [101, 10, 160, 50], [200, 0, 210, 20], [300, 300, 340, 380]])
    scores = torch.tensor([[0.9, 0, 0, 0], [0.2, 0, 0, 0], [0.1, 0.6, 0.4, 0], [0.5, 0, 0, 0], [0, 0, 0, 0.7]])
    found = score_frame(Detections(boxes, scores), objects, range(4))
    assert (found.labels, found.found, found.right) == ((0, 2), (True, True), (True, False))
    assert found.confidences == pytest.approx((0.9, 0.4))
    assert found.false == 1  # the third object is too small, but it is one
    nothing = score_frame(Detections(boxes[:0], scores[:0]), objects, range(4))
    assert (nothing.found, nothing.confidences, nothing.false) == ((False, False), (0.0, 0.0), 0)


def test_the_shipped_weights_are_as_good_as_their_report_says_on_one_scene(row):
    report = json.loads(REPORT.read_text("utf-8"))
    found = evaluate(detector(NetworkParams(threshold=0.01), CPU), [row])
    assert found["alone"]["objects"] >= 2 and abs(found["alone"]["median_change"]) < 0.1
    median = dict(zip(found["confidence"]["lx"], found["confidence"]["all"]["median"], strict=True))
    assert found["well_lit"]["recall"] >= report["well_lit"]["recall"] - 0.3  # of the few objects of one scene
    assert median[0.05] < 0.1 < 0.4 < median[10.0]


def test_the_page_says_what_the_report_says():
    text = page(json.loads(REPORT.read_text("utf-8")))
    assert text in (ROOT / "docs" / "detectors.md").read_text("utf-8")
    assert REPORT.with_suffix(".md").read_text("utf-8").endswith(text)


def test_a_network_that_has_learnt_nothing_is_refused(lux, tmp_path):
    """From a scene with nobody in it nothing can be learnt."""
    out = tmp_path / "out"
    draw_scenes(out, TRAINING, 1, local(1), "scene")
    jobs = [json.loads(line) for line in (out / "scenes.jsonl").read_text("utf-8").splitlines()]
    jobs[0]["result"]["objects"] = []
    (out / "scenes.jsonl").write_text(json.dumps(jobs[0]) + "\n", "utf-8")
    line = ["train-detector", "--out", str(out), "--scenes", "1", "--held-out", "1", "--epochs", "1", "--jobs", "1", "--wide", "0"]
    code, _, error = lux(*line)
    assert code == 2 and "scores do not separate correct boxes from wrong ones; give more --scenes or --epochs" in error
    assert sorted(path.name for path in out.iterdir()) == ["scenes", "scenes.jsonl"]
    files = sorted((out / "scenes").iterdir())
    assert [path.stem for path in files] == [str(TRAINING), str(HELD_OUT)]
    files[0].unlink()
    code, _, error = lux(*line)
    assert code == 2 and f"remove {out / 'scenes.jsonl'}" in error


def test_weights_and_report_are_stored_whole_or_not_at_all(tmp_path):
    ours, report = shipped(), json.loads(REPORT.read_text("utf-8"))
    with pytest.raises(ValueError, match="JSON"):
        store(ours, report | {"ms_a_frame": math.nan}, tmp_path)
    assert not any(tmp_path.iterdir())
    store(ours, report, tmp_path)
    assert json.loads((tmp_path / "report.json").read_text("utf-8")) == report
    assert "median confidence" in (tmp_path / "report.md").read_text("utf-8") and (tmp_path / "confidence.jpg").is_file()
    again = detector(NetworkParams(weights=str(tmp_path / "detector.pt")), CPU)
    frames = torch.rand(2, 64, 96)
    assert again.classes == CLASSES
    assert all(torch.equal(one.scores, other.scores) for one, other in zip(again.detect(frames), ours.detect(frames), strict=True))


def shipped() -> NetworkDetector:
    found = detector(NetworkParams(threshold=LEAST_SCORE), CPU)
    assert isinstance(found, NetworkDetector)
    return found


def test_a_wrong_slope_is_calibrated_away(row):
    ours, other = shipped(), shipped()
    ours.network.calibrate(0.3, 0.0)  # as it was learnt: far from 1, where scores are cut off
    other.network.calibrate(0.15, 0.1)
    least = 0.5 * math.log(LEAST_SCORE / (1 - LEAST_SCORE)) + 0.1
    slope, shift = calibrate(ours, [row])
    same_boxes = replace(other, threshold=1 / (1 + math.exp(-least)))
    assert calibrate(same_boxes, [row]) == pytest.approx((2 * slope, shift - 0.2 * slope), rel=0.01)
    ours.network.calibrate(50.0, 0.0)  # scores of 1 in single precision
    assert all(math.isfinite(each) for each in calibrate(ours, [row]))
    upside_down = shipped()
    upside_down.network.calibrate(-1.0, 0.0)
    with pytest.raises(LuxloopError, match="do not separate correct boxes"):
        calibrate(upside_down, [row])


def test_a_logistic_curve_is_found_again():
    x = torch.linspace(-4, 4, 4000).double()
    rng = np.random.default_rng(0)
    right = torch.tensor(rng.random(4000)) < (2 * x - 1).sigmoid()
    # 4000 draws leave a standard error of about 0.08 of the slope
    assert logistic(x, right.double()) == pytest.approx((2, -1), abs=0.25)
    assert np.isfinite(logistic(x, (x > 0).double())).all() and np.isfinite(logistic(x[:0], x[:0])).all()


def test_boxes_are_right_once_an_object():
    boxes = torch.tensor([[10.0, 10, 30, 58], [11, 10, 30, 60], [10, 10, 30, 60], [200, 10, 210, 20], [300, 300, 340, 380]])
    scores = torch.tensor([[0.8, 0], [0.9, 0], [0, 0.7], [0.6, 0], [0.5, 0]])
    # the second box is the surest on the object, the third of another class, the fourth on half of what is too small
    found = boxes_right(Detections(boxes, scores), [ONE, SMALL], range(2))
    expected = zip((0.9, 0.8, 0.7, 0.6, 0.5), (True, False, False, True, False), strict=True)
    assert found == [(pytest.approx(score), right) for score, right in expected]


def test_numbers_that_make_no_sense_are_refused(lux):
    for key, value, least in (("epochs", "0", 1), ("jobs", "0", 1), ("seed", "-1", 0)):
        assert_refused(lux("train-detector", "--out", "set", f"--{key}", value), f"for --{key}; must be >= {least}")
    assert not Path("set").exists()
