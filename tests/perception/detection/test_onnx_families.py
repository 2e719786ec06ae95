"""Networks of many families find what is there, without keys where their outputs tell enough."""

import sys

import pytest
import torch

from luxloop.perception.detection.onnx import OnnxDetector
from tests.perception.detection.exports import (
    BOX,
    DENSE,
    FAMILIES,
    LIST,
    NAMES,
    PAIR,
    Export,
    detr,
    frame,
    posed,
    rtdetr,
    torchvision,
    yolov8,
    yolov10,
)
from tests.refusal import refusal


@pytest.mark.parametrize("family", FAMILIES)
def test_the_bright_rectangle_is_found(family, tmp_path):
    export = FAMILIES[family]
    found = OnnxDetector(export.write(tmp_path / "network.onnx"))
    assert found.layout == export.layout
    (seen,) = found.detect(frame())
    assert found.classes[int(seen.scores[0].argmax())] == "pedestrian"
    assert 0.4 < float(seen.scores[0].max()) < 0.95  # DETR's share of 80 classes
    # a frame of 96 px is drawn on 64: a border may be off by half of one of its pixels, 0.75 px
    torch.testing.assert_close(seen.boxes[0], torch.tensor(BOX), atol=1.0, rtol=0.0)


@pytest.mark.parametrize("fit", ["letterbox", "stretch", "tiles"])
def test_frames_are_fitted_in(fit, tmp_path):
    """Of tiles, two show the rectangle, one of them only a part."""
    params = FAMILIES["YOLOv8"].write(tmp_path / "network.onnx")
    (seen,) = OnnxDetector(params.model_copy(update={"fit": fit})).detect(frame())
    torch.testing.assert_close(seen.boxes[0], torch.tensor(BOX), atol=1.0, rtol=0.0)
    assert (seen.scores.amax(1) > 0.5).sum() == 1


def test_open_cv_reads_what_onnxruntime_reads(tmp_path, monkeypatch):
    for family in ("YOLOv8", "YOLOv10", "YOLOX", "RT-DETR", "YOLO-NAS, all boxes"):
        params = FAMILIES[family].write(tmp_path / "network.onnx")
        (with_it,) = OnnxDetector(params).detect(frame())
        with monkeypatch.context() as context:
            context.setitem(sys.modules, "onnxruntime", None)
            (without,) = OnnxDetector(params).detect(frame())
        torch.testing.assert_close(without.boxes, with_it.boxes)
        torch.testing.assert_close(without.scores, with_it.scores)


UNCLEAR = {
    "listed without numbering": (Export(torchvision, "listed", outputs=LIST), r'classes: .* set detector.classes = "coco" .* or "coco91"'),
    "YOLOv10 without names": (Export(yolov10, "yolov10"), r'classes: .* set detector.classes = "coco" .* or "coco91"'),
    "boxes with an angle": (
        Export(lambda boxes, scores: posed(boxes, scores)[:, :7], "yolov8", 2, boxes=DENSE, metadata=NAMES),
        "layout: .* an angle, which is not read",
    ),
    "Deformable DETR without its mean": (Export(rtdetr, "rtdetr", 91, outputs=PAIR), "mean: .* set detector.mean ="),
    "DETR of own classes": (Export(detr, "detr", 3, outputs=PAIR, params={"classes": {1: "car"}}), "layout: .* may be rtdetr or detr; set"),
    "DETR without its mean": (Export(detr, "detr", 91, outputs=PAIR, params={"layout": "detr"}), "mean: .* set detector.mean ="),
    "names that it lacks": (
        Export(yolov8, "yolov8", 2, boxes=DENSE, metadata=NAMES, params={"classes": {"persn": "car"}}),
        "classes: .* no class 'persn'; did you mean 'person'",
    ),
    "no class of ours": (Export(yolov8, "yolov8", 2, boxes=DENSE, metadata={"names": "['cup', 'fork']"}), "classes: .* cup, fork; set"),
    "features": (
        Export(lambda boxes, scores: (scores + boxes.sum())[None, None], "yolov8"),
        "layout: .* none of the known forms .* detector of your own",
    ),
}


@pytest.mark.parametrize("case", UNCLEAR)
def test_what_is_unclear_is_asked_for(case, tmp_path):
    export, message = UNCLEAR[case]
    with refusal(rf"^detector\.{message}"):
        OnnxDetector(export.write(tmp_path / "network.onnx"))
