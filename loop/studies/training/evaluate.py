"""Metrics of a detector on held-out scenes: detections at one illuminance, confidence at all illuminances."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.functions.object_based import ObjectLightParams
from luxloop.loop.studies.training.light import lit_alone, luminance
from luxloop.loop.studies.training.scenes import CAMERA, CLASSES, DarkScene, Row, SceneObject, read
from luxloop.perception.camera import expose
from luxloop.perception.detection.detector import Detections, Detector, overlaps
from luxloop.perception.noise import FrameNoise

ILLUMINANCES_LX = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
REFERENCE_LX = 10.0
ALONE_LX, AROUND_LX, EDGE_PX = 20.0, 0.1, 2.0  # object-based light: on objects, beside them, scale of the lamps' blur
FRAMES = 4  # frames with different noise for mean confidences
AGREE = 0.05  # accepted loss of confidence from full to object-based light
SURE = 0.5  # least score of a detection, at which a box is as likely right as wrong at REFERENCE_LX
SCORES = (0.2, 0.3, 0.4, SURE, 0.6, 0.7, 0.8)  # thresholds for comparison
BINS = (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)  # of scores, for the share of right boxes
FOUND_IOU = 0.5
HEIGHT_PX, VISIBLE, INSIDE = 24, 0.5, 0.5  # least values of required objects; others are optional


@dataclass(frozen=True)
class FrameScores:
    """Scores of the detections in one frame, by required object.

    confidences: best score of the object's class among boxes on it, 0 without a box. found: whether a sure box detects it. right: whether
    that box has its class. false: number of sure boxes without an object.
    """

    labels: tuple[int, ...]
    confidences: tuple[float, ...]
    found: tuple[bool, ...]
    right: tuple[bool, ...]
    false: int


def evaluate(detector: Detector, rows: Sequence[Row]) -> dict[str, Any]:
    """Metrics of a detector on scenes that `luxloop.loop.studies.training.scenes.draw` returned as rows.

    At x lx every surface facing the lamps gets x lx at any distance: the intensity grows with the square of the distance. Confidence
    against illuminance is computed without any other light, and with the scene's night light, as are all other metrics.
    """
    labels_of = [CLASSES.index(name) for name in detector.classes]
    in_darkness: dict[float, list[FrameScores]] = {lx: [] for lx in ILLUMINANCES_LX}
    at_night: dict[float, list[FrameScores]] = {lx: [] for lx in ILLUMINANCES_LX}
    by_score: dict[float, list[FrameScores]] = {score: [] for score in SCORES}
    agreements: list[tuple[int, float, float]] = []
    asked: list[tuple[float, bool]] = []
    times_ms = []
    for row in rows:
        scene, seed = read(row), int(row["seed"])
        dark = replace(scene, own=torch.zeros_like(scene.own), sky=torch.zeros_like(scene.sky))
        for number, lx in enumerate(ILLUMINANCES_LX):
            frames = torch.stack([expose_scene(each, lx, seed, number) for each in (dark, scene)])
            start = time.process_time()
            alone, found = detector.detect(frames)
            times_ms.append(1e3 * (time.process_time() - start) / len(frames))
            in_darkness[lx].append(score_frame(alone, scene.objects, labels_of))
            at_night[lx].append(score_frame(found, scene.objects, labels_of))
            if lx == REFERENCE_LX:
                asked += boxes_right(found, scene.objects, labels_of)
                for score, of in by_score.items():
                    of.append(score_frame(found, scene.objects, labels_of, score))
        agreements += agreement(detector, scene, seed)
    return {
        "scenes": len(rows),
        "sure": SURE,
        "well_lit": _found(by_score[SURE]),
        "by_score": [{"score": score, **{key: _found(of)[key] for key in ("recall", "false_a_frame")}} for score, of in by_score.items()],
        "confidence": _confidence(in_darkness),
        "confidence_at_night": _confidence(at_night),
        "right": _right(asked),
        "alone": _alone(agreements),
        "ms_a_frame": round(float(np.median(times_ms)), 1),
    }


def score_frame(found: Detections, objects: Sequence[SceneObject], labels_of: Sequence[int], sure: float = SURE) -> FrameScores:
    """Scores of the detections in one frame. labels_of: luxloop's class for each of the detector's."""
    must = [_must(each) for each in objects]
    boxes, scores = found.boxes.cpu(), found.scores.cpu()
    overlap = overlaps(boxes, torch.tensor([each.box for each in objects]).view(-1, 4))
    owner = [-1] * len(objects)
    false = 0
    for k in torch.nonzero(scores.amax(1) >= sure)[:, 0].tolist() if len(scores) else []:
        free = torch.tensor([number < 0 for number in owner])
        taken = overlap[k] * free
        if len(objects) and float(taken.max()) >= FOUND_IOU:
            owner[int(taken.argmax())] = k
        else:
            false += not _on_any(boxes[k], [each for each, needed in zip(objects, must, strict=True) if not needed])
    labels, confidences, hits, right = [], [], [], []
    for number, each in enumerate(objects):
        if not must[number]:
            continue
        of_class = [column for column, label in enumerate(labels_of) if label == each.label]
        on_it = scores[overlap[:, number] >= FOUND_IOU][:, of_class]
        labels.append(each.label)
        confidences.append(float(on_it.max()) if on_it.numel() else 0.0)
        hits.append(owner[number] >= 0)
        right.append(owner[number] >= 0 and labels_of[int(scores[owner[number]].argmax())] == each.label)
    return FrameScores(tuple(labels), tuple(confidences), tuple(hits), tuple(right), false)


def boxes_right(found: Detections, objects: Sequence[SceneObject], labels_of: Sequence[int]) -> list[tuple[float, bool]]:
    """Score of each box, and whether it is the best-scored box on an object of its class.

    Other boxes on optional objects are left out.
    """
    boxes, (scores, columns) = found.boxes.cpu(), found.scores.cpu().max(1)
    overlap = overlaps(boxes, torch.tensor([each.box for each in objects]).view(-1, 4))
    overlap *= torch.tensor([[labels_of[column] == each.label for each in objects] for column in columns.tolist()]).view(overlap.shape)
    found_boxes, taken = [], set[int]()
    for k in scores.argsort(descending=True).tolist():
        best = int(overlap[k].argmax()) if objects else -1
        hit = best >= 0 and best not in taken and float(overlap[k, best]) >= FOUND_IOU
        taken |= {best} if hit else set()
        if hit or not _on_any(boxes[k], [each for each in objects if not _must(each)]):
            found_boxes.append((float(scores[k]), hit))
    return found_boxes


def agreement(detector: Detector, scene: DarkScene, seed: int) -> list[tuple[int, float, float]]:
    """Label, and mean confidence in full and in object-based light, of required objects that are surely detected in full light."""
    labels_of = [CLASSES.index(name) for name in detector.classes]

    def means(light: Tensor | float, first: int) -> tuple[tuple[int, ...], list[float]]:
        frames = torch.stack([expose_scene(scene, light, seed, first + k) for k in range(FRAMES)])
        frame_scores = [score_frame(found, scene.objects, labels_of) for found in detector.detect(frames)]
        return frame_scores[0].labels, np.mean([each.confidences for each in frame_scores], 0).tolist()

    first = len(ILLUMINANCES_LX)
    (labels, full), (_, dark) = means(ALONE_LX, first), means(light_on_objects(scene), first + FRAMES)
    return [each for each in zip(labels, full, dark, strict=True) if each[1] >= SURE]


def expose_scene(scene: DarkScene, light: Tensor | float, seed: int, number: int) -> Tensor:
    """Frame of a scene in a light, in 0..1, with noise of this seed and number."""
    return expose(luminance(scene, light), CAMERA, FrameNoise.of(seed, number, 0)) / (2**CAMERA.bits - 1)


def light_on_objects(scene: DarkScene) -> Tensor:
    """Light on objects alone, approximately as object-based lighting by default, but without its handling of nearer objects."""
    params = ObjectLightParams()
    return lit_alone(scene, ALONE_LX, AROUND_LX, params.dark, params.dark_lx, EDGE_PX)


def _must(each: SceneObject) -> bool:
    return each.height >= HEIGHT_PX and each.visible >= VISIBLE and each.inside >= INSIDE


def _on_any(box: Tensor, objects: Sequence[SceneObject]) -> bool:
    """Whether most of a box lies on one of the objects."""
    for each in objects:
        other = torch.tensor(each.box)
        both = (torch.minimum(box[2:], other[2:]) - torch.maximum(box[:2], other[:2])).clamp(min=0).prod()
        if both > 0.5 * (box[2:] - box[:2]).prod():
            return True
    return False


def _share(hits: Sequence[bool]) -> float | None:
    return round(float(np.mean(hits)), 3) if hits else None


def _found(frame_scores: Sequence[FrameScores]) -> dict[str, Any]:

    pairs = [(label, hit, right) for each in frame_scores for label, hit, right in zip(each.labels, each.found, each.right, strict=True)]
    false, true = sum(each.false for each in frame_scores), sum(hit for _, hit, _ in pairs)
    return {
        "objects": len(pairs),
        "recall": _share([hit for _, hit, _ in pairs]),
        "precision": round(true / max(true + false, 1), 3),
        "false_a_frame": round(false / len(frame_scores), 3),
        "class_accuracy": _share([right for _, hit, right in pairs if hit]),
        "recall_by_class": {name: _share([hit for label, hit, _ in pairs if label == k]) for k, name in enumerate(CLASSES)},
    }


def _right(asked: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Number, mean score and share of right boxes at `REFERENCE_LX`, by bin of the score."""
    rows = []
    for low, high in pairwise(BINS):
        boxes = [(score, right) for score, right in asked if low <= score < high or score == high == BINS[-1]]
        score, right = np.mean(boxes, 0).round(3).tolist() if boxes else (None, None)
        rows.append({"from": low, "to": high, "boxes": len(boxes), "score": score, "right": right})
    return rows


def _confidence(frame_scores: Mapping[float, Sequence[FrameScores]]) -> dict[str, Any]:
    """Quartiles of confidence by illuminance, of all objects and of each class."""
    curves: dict[str, Any] = {"lx": list(ILLUMINANCES_LX)}
    for name, labels in [("all", range(len(CLASSES))), *((name, [k]) for k, name in enumerate(CLASSES))]:
        of = [
            [c for each in frame_scores[lx] for c, k in zip(each.confidences, each.labels, strict=True) if k in labels]
            for lx in ILLUMINANCES_LX
        ]
        quartiles = [np.percentile(each, [25, 50, 75]).round(3).tolist() if each else [None] * 3 for each in of]
        curves[name] = {key: [each[k] for each in quartiles] for k, key in enumerate(("lower", "median", "upper"))}
    return curves


def _alone(agreements: Sequence[tuple[int, float, float]]) -> dict[str, Any]:
    """Share of objects whose confidence in object-based light is within AGREE of full light, and the median change."""

    def share_within(found: Sequence[tuple[int, float, float]]) -> float | None:
        return _share([dark >= full - AGREE for _, full, dark in found])

    changes = [dark - full for _, full, dark in agreements]
    return {
        "objects": len(agreements),
        "kept": share_within(agreements),
        "kept_by_class": {name: share_within([each for each in agreements if each[0] == k]) for k, name in enumerate(CLASSES)},
        "median_change": round(float(np.median(changes)), 3) if changes else None,
    }
