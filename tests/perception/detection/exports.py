"""Exports in the forms of many families, each of a network that finds the bright rectangle in its picture."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from luxloop.perception.detection.detector import OnnxParams

SIZE = 64  # px
BOX = (20.0, 8.0, 44.0, 24.0)  # px of a frame of 96 x 48: left, top, right, bottom
STRIDES = (4, 8, 16)


class Finder(nn.Module):
    """Boxes `[n, 4]` px (left, top, right, bottom) and scores `[n, classes]`: the bright rectangle, and others that are unlikely."""

    def __init__(
        self, form: Callable[..., Any], classes: int, number: int, boxes: int, given: Callable[[Tensor], Tensor], **more: Any
    ) -> None:
        super().__init__()
        self.form, self.given, self.boxes, self.more = form, given, boxes, more
        self.scores = torch.full((boxes, classes), 0.01)
        self.scores[0, number] = 0.9

    def forward(self, pictures: Tensor, *_: Tensor) -> Any:
        grey = self.given(pictures)[0, 0]
        lit = grey > 0.7
        columns, rows = (torch.arange(side, dtype=torch.float32) for side in (grey.shape[1], grey.shape[0]))
        nowhere = torch.full((1,), 1e4)

        def ends(lit: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
            return torch.where(lit, at, nowhere).amin(), torch.where(lit, at + 1, -nowhere).amax()

        left, right = ends(lit.any(0), columns)
        top, bottom = ends(lit.any(1), rows)
        found = torch.stack([left, top, right, bottom]).where(lit.any(), torch.tensor([0.0, 0, 1, 1]))
        others = torch.tensor([[1.0, 1, SIZE - 2, SIZE - 3]]).expand(self.boxes - 1, 4)
        return self.form(torch.cat([found[None], others]), self.scores, **self.more)


def middles(boxes: Tensor) -> Tensor:
    return torch.cat([(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]], 1)


def yolov8(boxes: Tensor, scores: Tensor) -> Tensor:
    return torch.cat([middles(boxes), scores], 1).T[None]


def segmented(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    return torch.cat([middles(boxes), scores, torch.full((len(boxes), 8), 7.0)], 1).T[None], torch.zeros(1, 8, 16, 16)


def posed(boxes: Tensor, scores: Tensor) -> Tensor:
    return torch.cat([middles(boxes), scores, torch.full((len(boxes), 51), 7.0)], 1).T[None]


def yolov5(boxes: Tensor, scores: Tensor) -> Tensor:
    return torch.cat([middles(boxes), torch.ones(len(boxes), 1), scores], 1)[None]


def yolox(boxes: Tensor, scores: Tensor) -> Tensor:
    """Every cell says the first box."""
    places = torch.cat([torch.cartesian_prod(torch.arange(SIZE // s), torch.arange(SIZE // s)).flip(1) for s in STRIDES])
    stride = torch.cat([torch.full(((SIZE // s) ** 2, 1), float(s)) for s in STRIDES])
    middle, sides = middles(boxes[:1]).expand(len(places), 4).split(2, 1)
    # one cell is sure, as after training
    sure = ((middle / stride - places - 0.5).abs() <= 0.5).all(1, keepdim=True) & (stride == 8)
    offsets = torch.where(sure, middle / stride - places, torch.full((1,), -0.3))
    return torch.cat(
        [offsets, torch.where(sure, sides / stride, torch.ones(1)).log(), sure.float(), scores[:1].expand(len(places), -1)], 1
    )[None]


def yolov10(boxes: Tensor, scores: Tensor) -> Tensor:
    best, number = scores.max(1, keepdim=True)
    return torch.cat([boxes, best, number.float()], 1)[None]


def rows(boxes: Tensor, scores: Tensor, score_first: bool) -> Tensor:
    best, number = scores.max(1, keepdim=True)
    last = [best, number.float()] if score_first else [number.float(), best]
    return torch.cat([torch.zeros(len(boxes), 1), boxes, *last], 1)


def counted(boxes: Tensor, scores: Tensor) -> tuple[Tensor, ...]:
    best, number = scores.max(1)
    return torch.full((1, 1), 3, dtype=torch.int32), boxes[None], best[None], number.int()[None]


def torchvision(boxes: Tensor, scores: Tensor) -> tuple[Tensor, ...]:
    best, number = scores.max(1)
    return boxes, number, best


def tensorflow(boxes: Tensor, scores: Tensor) -> tuple[Tensor, ...]:
    best, number = scores.max(1)
    return boxes[None][..., [1, 0, 3, 2]] / SIZE, number.float()[None], best[None], torch.full((1,), 5.0)


def detr(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    """Scores of all classes and of none add up to 1."""
    shares = torch.cat([scores / scores.sum(1, keepdim=True) * 0.9, torch.full((len(scores), 1), 0.1)], 1)
    return (shares.log() + 3)[None], middles(boxes)[None] / SIZE


def rtdetr(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    return scores.logit()[None], middles(boxes)[None] / SIZE


def ultralytics(boxes: Tensor, scores: Tensor) -> Tensor:
    return torch.cat([middles(boxes) / SIZE, scores], 1)[None]


def scored(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    return boxes[None], scores[None]


DENSE = sum((SIZE // stride) ** 2 for stride in STRIDES)
FLOATS = torch.zeros(1, 3, SIZE, SIZE)
LAST = torch.zeros(1, SIZE, SIZE, 3, dtype=torch.uint8)


@dataclass
class Export:
    """A family's export. number: of a person, of so many classes. params: keys that a user must set."""

    form: Callable[..., Any]
    layout: str
    classes: int = 80
    number: int = 0
    boxes: int = 30
    inputs: tuple[Tensor, ...] = (FLOATS,)
    outputs: tuple[str, ...] = ()
    given: Callable[[Tensor], Tensor] = lambda pictures: pictures
    more: dict[str, Any] | None = None
    params: dict[str, Any] | None = None
    metadata: dict[str, str] | None = None

    def write(self, file: Path) -> OnnxParams:
        finder = Finder(self.form, self.classes, self.number, self.boxes, self.given, **(self.more or {}))
        inputs = [f"input_{k}" for k in range(len(self.inputs))]
        inputs[1:] = [name for name in ("orig_target_sizes",) for _ in inputs[1:]]
        names = {"input_names": inputs, "output_names": list(self.outputs)}
        torch.onnx.export(finder.eval(), self.inputs, file, external_data=False, verbose=False, dynamo=False, **names)
        if self.metadata:
            model = onnx.load(file)
            onnx.helper.set_model_props(model, self.metadata)
            onnx.save(model, file)
        return OnnxParams(file=str(file), gamma=1.0, **(self.params or {}))


def normalised(pictures: Tensor) -> Tensor:
    return pictures * 0.25 + 0.5


NAMES = {"names": "{0: 'person', 1: 'car'}"}
PAIR, LIST = ("logits", "pred_boxes"), ("boxes", "labels", "scores")
FAMILIES = {
    "YOLOv8": Export(yolov8, "yolov8", boxes=DENSE),
    "YOLOv8 with masks": Export(segmented, "yolov8", boxes=DENSE),
    "YOLOv8 with points, as Ultralytics names it": Export(posed, "yolov8", 2, boxes=DENSE, metadata=NAMES),
    "YOLOv8 of own names": Export(yolov8, "yolov8", 3, 2, DENSE, metadata={"names": "{0: 'car', 1: 'tree', 2: 'person'}"}),
    "YOLOv5": Export(yolov5, "yolov5", boxes=3 * DENSE),
    "YOLOX, decoded": Export(yolov5, "yolov5", boxes=DENSE, given=lambda given: given / 255, params={"layout": "yolov5", "white": 255}),
    "YOLOX": Export(yolox, "yolox", given=lambda pictures: pictures / 255),
    "YOLOv10": Export(yolov10, "yolov10"),
    "YOLOv7 with suppression": Export(rows, "rows", more={"score_first": False}),
    "YOLO-NAS, rows": Export(rows, "rows", more={"score_first": True}),
    "YOLO-NAS, all boxes": Export(scored, "scored", boxes=DENSE),
    "YOLO-NAS, batch": Export(counted, "listed", outputs=("num", "pred_boxes", "pred_scores", "pred_classes"), params={"classes": "coco"}),
    "SSD of torchvision": Export(
        torchvision, "listed", 91, 1, inputs=(FLOATS[0],), given=lambda given: given[None], outputs=LIST, params={"classes": "coco91"}
    ),
    "SSD of TensorFlow, bytes, channels last": Export(
        tensorflow,
        "listed",
        91,
        1,
        inputs=(LAST,),
        given=lambda pictures: pictures.permute(0, 3, 1, 2).float() / 255,
        outputs=("detection_boxes", "detection_classes", "detection_scores", "num_detections"),
        params={"classes": "coco91"},
    ),
    "DETR": Export(detr, "detr", 91, 1, outputs=PAIR, given=normalised, params={"mean": 0.5, "std": 0.25}),
    "RT-DETR": Export(rtdetr, "rtdetr", outputs=PAIR),
    "RT-DETR of Ultralytics": Export(ultralytics, "rtdetr"),
    "RT-DETR with sizes": Export(
        torchvision,
        "listed",
        inputs=(FLOATS, torch.tensor([[SIZE, SIZE]])),
        outputs=("boxes", "labels", "scores"),
        params={"classes": "coco"},
    ),
    "double precision": Export(yolov8, "yolov8", boxes=DENSE, inputs=(FLOATS.double(),), given=lambda given: given.float()),
    "batch of 4": Export(yolov8, "yolov8", boxes=DENSE, inputs=(FLOATS.repeat(4, 1, 1, 1),)),
    "one channel": Export(yolov8, "yolov8", boxes=DENSE, inputs=(FLOATS[:, :1],)),
}


def frame() -> Tensor:
    given = torch.full((1, 48, 96), 0.1)
    left, top, right, bottom = map(int, BOX)
    given[0, top:bottom, left:right] = 1.0
    return given
