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

    def forward(self, *inputs: Tensor) -> Any:
        grey = self.given(next(each for each in inputs if each.ndim > 2))[0, 0]
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


def masked(boxes: Tensor, scores: Tensor, rows: Callable[..., Tensor]) -> tuple[Tensor, Tensor]:
    return torch.cat([rows(boxes, scores), torch.full((1, len(boxes), 8), 7.0)], 2), torch.zeros(1, 8, 16, 16)


def suppressed_pose(boxes: Tensor, scores: Tensor) -> Tensor:
    """Rows of 0 fill up the list, so that a picture of nothing gives nothing but 0."""
    found = torch.cat([yolov10(boxes, scores), torch.full((1, len(boxes), 51), 7.0)], 2)
    return found * (found[..., 4:5] > 0.5)


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


def paddle(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    best, number = scores.max(1, keepdim=True)
    return torch.cat([number.float(), best, boxes], 1), torch.tensor(len(boxes), dtype=torch.int32)


def mmdetection(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    """Rows of 0 and the class -1 fill up the lists."""
    best, number = scores.max(1, keepdim=True)
    sure = best > 0.5
    return (torch.cat([boxes, best], 1) * sure)[None], torch.where(sure, number, -1)[None, :, 0]


def counted(boxes: Tensor, scores: Tensor) -> tuple[Tensor, ...]:
    best, number = scores.max(1)
    return torch.full((1, 1), 3, dtype=torch.int32), boxes[None], best[None], number.int()[None]


def torchvision(boxes: Tensor, scores: Tensor) -> tuple[Tensor, ...]:
    best, number = scores.max(1)
    return boxes, number, best


def tensorflow(boxes: Tensor, scores: Tensor) -> tuple[Tensor, ...]:
    best, number = scores.max(1)
    return boxes[None][..., [1, 0, 3, 2]] / SIZE, number.float()[None], best[None], torch.full((1,), 5.0)


def tensorflow_whole(boxes: Tensor, scores: Tensor) -> tuple[Tensor, ...]:
    """The anchors' indices, and the scores of all classes, too."""
    return torch.arange(float(len(boxes)))[None], *tensorflow(boxes, scores), scores[None]


def detr(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    """Scores of all classes and of none add up to 1."""
    shares = torch.cat([scores / scores.sum(1, keepdim=True) * 0.9, torch.full((len(scores), 1), 0.1)], 1)
    return (shares.log() + 3)[None], middles(boxes)[None] / SIZE


def rtdetr(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    return scores.logit()[None], middles(boxes)[None] / SIZE


def rfdetr(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    logits, shares = rtdetr(boxes, scores)
    return shares, logits


def ultralytics(boxes: Tensor, scores: Tensor) -> Tensor:
    return torch.cat([middles(boxes) / SIZE, scores], 1)[None]


def scored(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    return boxes[None], scores[None]


def ssd(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    """An unlikely box leaves the picture."""
    return torch.cat([boxes[:-1] / SIZE, torch.tensor([[-1.5, -1.5, 2.5, 2.5]])])[None], scores[None]


def yolov4(boxes: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    return boxes[None, :, None] / SIZE, scores[None]


DENSE = sum((SIZE // stride) ** 2 for stride in STRIDES)
FLOATS = torch.zeros(1, 3, SIZE, SIZE)
SIZES = torch.ones(1, 2)
LAST = torch.zeros(1, SIZE, SIZE, 3, dtype=torch.uint8)


@dataclass
class Export:
    """A family's export with a number of classes. number: class number of a person. params: keys that a user must set."""

    form: Callable[..., Any]
    layout: str
    classes: int = 80
    number: int = 0
    boxes: int = 30
    inputs: tuple[Tensor, ...] = (FLOATS,)
    names: tuple[str, ...] = ("input",)
    outputs: tuple[str, ...] = ()
    given: Callable[[Tensor], Tensor] = lambda pictures: pictures
    more: dict[str, Any] | None = None
    params: dict[str, Any] | None = None
    metadata: dict[str, str] | None = None

    def write(self, file: Path) -> OnnxParams:
        finder = Finder(self.form, self.classes, self.number, self.boxes, self.given, **(self.more or {}))
        names = {"input_names": list(self.names), "output_names": list(self.outputs)}
        torch.onnx.export(finder.eval(), self.inputs, file, external_data=False, verbose=False, dynamo=False, **names)
        if self.metadata:
            model = onnx.load(file)
            onnx.helper.set_model_props(model, self.metadata)
            onnx.save(model, file)
        return OnnxParams(file=str(file), gamma=1.0, **(self.params or {}))


def normalised(pictures: Tensor) -> Tensor:
    return pictures * 0.25 + 0.5


def bytes_last(pictures: Tensor) -> Tensor:
    return pictures.permute(0, 3, 1, 2).float() / 255


NAMES = {"names": "{0: 'person', 1: 'car'}"}
PAIR, LIST = ("logits", "pred_boxes"), ("boxes", "labels", "scores")
TENSORFLOW = ("detection_boxes", "detection_classes", "detection_scores", "num_detections")
COCO = {"classes": "coco"}
NORMAL = {"mean": 0.5, "std": 0.25}
FAMILIES = {
    "YOLOv8": Export(yolov8, "yolov8", boxes=DENSE),
    "YOLOv8 with masks": Export(segmented, "yolov8", boxes=DENSE),
    "YOLOv8 with points, as Ultralytics names it": Export(posed, "yolov8", 2, boxes=DENSE, metadata=NAMES),
    "YOLOv8 of own names": Export(yolov8, "yolov8", 3, 2, DENSE, metadata={"names": "{0: 'car', 1: 'tree', 2: 'person'}"}),
    "YOLOv5": Export(yolov5, "yolov5", boxes=3 * DENSE),
    "YOLOv5 with masks": Export(masked, "yolov5", boxes=3 * DENSE, more={"rows": yolov5}),
    "YOLOX, decoded": Export(yolov5, "yolov5", boxes=DENSE, given=lambda given: given / 255, params={"layout": "yolov5", "white": 255}),
    "YOLOX": Export(yolox, "yolox", given=lambda pictures: pictures / 255),
    "YOLOv10": Export(yolov10, "yolov10", params=COCO),
    "YOLO26 with masks": Export(masked, "yolov10", more={"rows": yolov10}, params=COCO),
    "YOLOv8 with points and suppression": Export(suppressed_pose, "yolov10", 2, boxes=300, metadata=NAMES),
    "YOLOv7 with suppression": Export(rows, "rows", more={"score_first": False}, params=COCO),
    "YOLO-NAS, rows": Export(rows, "rows", more={"score_first": True}, params=COCO),
    "PP-YOLOE": Export(paddle, "rows", inputs=(SIZES, FLOATS, SIZES), names=("im_shape", "image", "scale_factor"), params=COCO),
    "SSD of PyTorch": Export(ssd, "scored"),
    "YOLOv4 of PyTorch": Export(yolov4, "scored"),
    "MMDetection": Export(mmdetection, "listed", outputs=("dets", "labels"), given=normalised, params={**NORMAL, **COCO}),
    "YOLO-NAS, all boxes": Export(scored, "scored", boxes=DENSE),
    "YOLO-NAS, batch": Export(counted, "listed", outputs=("num", "pred_boxes", "pred_scores", "pred_classes"), params=COCO),
    "SSD of torchvision": Export(
        torchvision, "listed", 91, 1, inputs=(FLOATS[0],), given=lambda given: given[None], outputs=LIST, params={"classes": "coco91"}
    ),
    "SSD of TensorFlow, bytes, channels last": Export(
        tensorflow,
        "listed",
        91,
        1,
        inputs=(LAST,),
        given=bytes_last,
        outputs=TENSORFLOW,
        params={"classes": "coco91"},
    ),
    "SSD of TensorFlow, all outputs": Export(
        tensorflow_whole,
        "listed",
        91,
        1,
        inputs=(LAST,),
        given=bytes_last,
        outputs=("detection_anchor_indices", *TENSORFLOW, "detection_multiclass_scores"),
        params={"classes": "coco91"},
    ),
    "DETR": Export(detr, "detr", 91, 1, outputs=PAIR, given=normalised, params=NORMAL),
    "DETR with a mask of a size": Export(
        detr,
        "detr",
        91,
        1,
        inputs=(FLOATS, torch.ones(1, 8, 8, dtype=torch.int64)),
        names=("pixel_values", "pixel_mask"),
        outputs=PAIR,
        given=normalised,
        params=NORMAL,
    ),
    "RF-DETR": Export(rfdetr, "rtdetr", 91, 1, outputs=("dets", "labels"), given=normalised, params=NORMAL),
    "RT-DETR": Export(rtdetr, "rtdetr", outputs=PAIR),
    "RT-DETR of Ultralytics": Export(ultralytics, "rtdetr"),
    "RT-DETR with sizes": Export(
        torchvision,
        "listed",
        inputs=(FLOATS, torch.tensor([[SIZE, SIZE]])),
        names=("input", "orig_target_sizes"),
        outputs=LIST,
        params=COCO,
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
