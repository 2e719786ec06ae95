"""What networks of each family give: boxes and scores, read from the outputs of an ONNX file."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from luxloop.perception.detection.detector import Layout

Outputs = Mapping[str, Tensor]
Reading = tuple[Tensor, Tensor]  # corners [n, 4] px, scores [n, C]

ROUNDING = 1e-3  # by which a score may leave 0..1
ROUNDING_PX = 1.0  # by which a side may be below 0: corners in half precision are that coarse
SHARES = 2.0  # px; boxes of which half reach no farther are shares of the picture: unlikely ones of SSD may leave it by far
STRIDES = (4, 8, 16, 32, 64)  # px; side of the cells of a network's levels, of which each uses three or more that follow each other
ANCHORS = 3  # boxes a cell of YOLOv5 and YOLOv7; others have one
NEAR = 1 / 8  # of the picture's side; if no box of any cell reaches farther, boxes are offsets from their cells
LARGEST = 5.0  # logarithm of the largest side of an offset's box over its cell
MOST_CLASSES = 10_000  # of a network
NO_OBJECT = 1  # last class of DETR
TENSORFLOW = "detection_boxes"  # top, left, bottom, right


class Implausible(ValueError):
    """Outputs of the form of a layout whose numbers cannot be boxes or scores."""


@dataclass(frozen=True)
class Form:
    """What reading needs beside the outputs: width and height of the picture, and the number of classes that the file names."""

    input_px: tuple[int, int]
    classes: int | None = None


def read(outputs: Outputs, layout: Layout, form: Form) -> Reading:
    """Corners `[n, 4]` in px of the network's picture (left, top, right, bottom) and scores `[n, C]` in 0..1 of all its classes.

    outputs: of one picture, by name. Boxes that are not finite are dropped. Raises ValueError with what was seen if the outputs do not have
    the layout, Implausible if their numbers cannot be boxes and scores.
    """
    flat = {name: each.flatten(1, 2) if each.shape[2:] == (1, 4) else each for name, each in outputs.items()}  # 1 x boxes x 1 x 4: YOLOv4
    boxes, scores = LAYOUTS[layout].read(flat, form)
    finite = boxes.isfinite().all(1) & scores.isfinite().all(1)
    if len(boxes) and not finite.any():
        raise ValueError("no box has finite numbers only")
    boxes, scores = boxes[finite], scores[finite]
    if len(boxes):
        low, high = (float(each) for each in scores.aminmax())
        if low < -ROUNDING or high > 1 + ROUNDING:
            raise Implausible(f"scores reach from {low:.3g} to {high:.3g} and not within 0..1")
        farthest = boxes.amax(1)
        if (some := farthest[farthest > 0]).numel() and float(some.median()) <= SHARES:  # rows of 0 fill up lists
            boxes = boxes * boxes.new_tensor(form.input_px * 2)
        if (thinnest := float((boxes[:, 2:] - boxes[:, :2]).min())) < -ROUNDING_PX:
            raise Implausible(f"boxes have sides down to {thinnest:.3g} px")
    return boxes, scores.clamp(0, 1)


def fitting(outputs: Outputs, form: Form, fits: Callable[[Layout, int], bool]) -> tuple[list[Layout], list[str]]:
    """The layouts as which outputs can be read, with a number of classes that fits; and why others that nearly fit do not."""
    found: list[Layout] = []
    nearly: list[str] = []
    for name, family in LAYOUTS.items():
        across = family.cells
        if across and any(each.ndim == 3 and each.shape[across] < each.shape[3 - across] for each in outputs.values()):
            continue  # a list of the best boxes, since cells outnumber the numbers of a box
        try:
            scores = read(outputs, name, form)[1]
        except Implausible as reason:
            nearly.append(f"{name}: {reason}")
        except ValueError:
            continue
        else:
            if fits(name, scores.shape[1]):
                found.append(name)
    return found, nearly


def cells(input_px: tuple[int, int], count: float) -> list[int] | None:
    """Strides of the levels, at least three in succession, that together have `count` cells; None if there are none."""
    sides = [(input_px[0] // stride) * (input_px[1] // stride) for stride in STRIDES]
    levels = ((first, last) for first in range(len(sides)) for last in range(first + 3, len(sides) + 1))
    return next((list(STRIDES[first:last]) for first, last in levels if sum(sides[first:last]) == count), None)


def _rows(outputs: Outputs, numbers: int, turned: bool = False) -> Tensor:
    """Rows `[n, k]`, one per box, of the only output with three dimensions; k is at least `numbers`."""
    found = [each for each in outputs.values() if each.ndim == 3]
    if len(found) != 1 or len(found[0]) != 1:
        raise ValueError("there must be one output of three dimensions, the first of 1")
    rows = found[0][0].T if turned else found[0][0]
    if rows.shape[1] < numbers:
        raise ValueError(f"each box has {rows.shape[1]} numbers")
    return rows.float()


def _masks(outputs: Outputs) -> int:
    """Numbers of a box for its mask: channels of the output that holds the masks' basis."""
    return next((each.shape[1] for each in outputs.values() if each.ndim == 4 and len(each) == 1), 0)


def _dense(outputs: Outputs, form: Form, before: int, turned: bool = False) -> Tensor:
    """Rows `[n, before + classes]` of the boxes of all cells; what follows the scores, for masks or points, is dropped."""
    rows = _rows(outputs, before + 1, turned)
    last = before + form.classes if form.classes else rows.shape[1] - _masks(outputs)
    if not before < last <= rows.shape[1]:
        raise ValueError(f"each box has {rows.shape[1]} numbers")
    if rows.shape[1] == last + 1:
        raise Implausible("each box has one number more than its classes, as an angle, which is not read")
    return rows[:, :last]


def _yolov8(outputs: Outputs, form: Form) -> Reading:
    rows = _dense(outputs, form, 4, turned=True)
    corners = _corners(rows[:, :4])
    _refuse_offsets(corners, form)
    return corners, rows[:, 4:]


def _yolov5(outputs: Outputs, form: Form) -> Reading:
    rows = _dense(outputs, form, 5)
    boxes, rest = rows[:, :4], rows[:, 5:]
    in_order = bool((boxes[:, 2:] >= boxes[:, :2]).all())  # as corners are, but not middles and sides
    if rest.shape[1] == 1 and len(rest) and _whole(rest) and in_order:
        raise ValueError("the sixth number of each box is whole, as the classes of yolov10 are")
    corners = _corners(boxes)
    _refuse_offsets(corners, form)
    return corners, rest * rows[:, 4:5]


def _yolox(outputs: Outputs, form: Form) -> Reading:
    """YOLOX as it is exported by default: offsets from cells and logarithms of sides, in px of the cells (Ge et al. 2021)."""
    rows = _rows(outputs, 6)
    strides = cells(form.input_px, len(rows))
    if strides is None or float(rows[:, :2].max()) > NEAR * min(form.input_px) or float(rows[:, 2:4].max()) > LARGEST:
        raise ValueError("the boxes are not offsets from one cell each")
    if float(rows[:, :4].min()) >= 0 and float(rows[:, :4].max()) <= 1:
        raise ValueError("the boxes are shares of the picture")
    sides = [(form.input_px[1] // stride, form.input_px[0] // stride) for stride in strides]
    places = torch.cat([torch.cartesian_prod(torch.arange(h), torch.arange(w)).flip(1) for h, w in sides])
    stride = torch.cat([torch.full((h * w, 1), float(each)) for (h, w), each in zip(sides, strides, strict=True)])
    boxes = torch.cat([rows[:, :2] + places, rows[:, 2:4].exp()], 1) * stride
    return _corners(boxes), rows[:, 5:] * rows[:, 4:5]


def _yolov10(outputs: Outputs, form: Form) -> Reading:
    rows = _rows(outputs, 6)
    more = rows.shape[1] - 6
    if more not in (0, _masks(outputs)) and not (form.classes and more > 1):  # masks; points; not an angle
        raise ValueError(f"each box has {rows.shape[1]} numbers")
    return rows[:, :4], _by_class(rows[:, 4], rows[:, 5])


def _rows_of_class_and_score(outputs: Outputs, form: Form) -> Reading:
    """Rows of picture, corners, class and score (YOLOv7 with suppression), of picture, corners, score and class (YOLO-NAS), or of class,
    score and corners, with their count (PaddleDetection).
    """
    tables = [each.float() for each in outputs.values() if each.ndim > 1]
    if [each.shape[1:] for each in tables] not in ([(6,)], [(7,)]) or not _whole(tables[0][:, 0]):
        raise ValueError("there must be one output of boxes x 6 or 7, of which the first is whole")
    (given,) = tables
    if given.shape[1] == 6:
        return given[:, 2:], _by_class(given[:, 1], given[:, 0])
    rows = given[given[:, 0] == 0]  # of the first picture
    fifth, sixth = rows[:, 5], rows[:, 6]
    if len(rows) and _whole(fifth) == _whole(sixth):
        raise ValueError("one of the last two numbers of each box must be a whole class number, and the other a score")
    return rows[:, 1:5], _by_class(sixth, fifth) if _whole(fifth) else _by_class(fifth, sixth)


def _rtdetr(outputs: Outputs, form: Form) -> Reading:
    """RT-DETR: middles and sides, with scores beside them, or with logits of all classes in another output."""
    if sum(each.ndim == 3 for each in outputs.values()) == 1:
        rows = _rows(outputs, 5)
        if any(cells(form.input_px, len(rows) / each) for each in (1, ANCHORS)):
            raise ValueError("there is one box a cell")
        return _corners(_not_px(rows[:, :4])), rows[:, 4:]
    boxes, logits = _pair(outputs)
    return _corners(_not_px(boxes)), _logits(logits).sigmoid()


def _detr(outputs: Outputs, form: Form) -> Reading:
    """DETR: middles and sides, and logits of all classes and of no object, the last (Carion et al. 2020)."""
    boxes, logits = _pair(outputs)
    return _corners(_not_px(boxes)), _logits(logits).softmax(1)[:, :-NO_OBJECT]


def _scored(outputs: Outputs, form: Form) -> Reading:
    if any(name.startswith(TENSORFLOW) for name in outputs):
        raise ValueError("TensorFlow gives top and left first, and lists classes and scores")
    return _pair(outputs)


def _listed(outputs: Outputs, form: Form) -> Reading:
    """Corners, class numbers and scores, one output each, or scores beside the corners (MMDetection); and often the number of boxes."""
    wide = [name for name, each in outputs.items() if each.ndim in (2, 3) and each.shape[-1] in (4, 5)]
    if not wide:
        raise ValueError("there must be an output of four numbers a box, or five with its score")
    box = next((name for name in wide if name.startswith(TENSORFLOW)), max(wide, key=lambda name: outputs[name].ndim))
    boxes = outputs[box]
    same = {name: each for name, each in outputs.items() if name != box and each.shape == boxes.shape[:-1]}
    numbers = [name for name in same if re.search("class|label|idx", name)] or [
        name for name, each in same.items() if not each.is_floating_point()
    ]
    best = [each for name, each in same.items() if name not in numbers]
    if boxes.shape[-1] == 5:
        best = [boxes[..., 4]]
    elif len(best) > 1:
        best = [same[name] for name in same if "score" in name]
    if len(numbers) != 1 or len(best) != 1:
        raise ValueError("there must be outputs of corners, class numbers and scores, one of each a box")
    counts = [int(each.flatten()[0]) for each in outputs.values() if each.numel() == 1 and each.shape != boxes.shape[:-1]]
    found = [each[0] if boxes.ndim == 3 else each for each in (boxes[..., :4], same[numbers[0]], best[0])]
    corners, classes, scores = (each[: counts[0] if counts else None].float() for each in found)
    return corners[:, [1, 0, 3, 2]] if box.startswith(TENSORFLOW) else corners, _by_class(scores, classes)


@dataclass(frozen=True)
class Family:
    """How a layout is read, and its form in words. counted: whether it shows the number of classes. cells: axis of a box for each cell."""

    read: Callable[[Outputs, Form], Reading]
    form: str
    counted: bool = True
    cells: int | None = None


LAYOUTS: Mapping[Layout, Family] = {
    "yolov5": Family(_yolov5, "1 x boxes x (5 + classes)", cells=1),
    "yolov8": Family(_yolov8, "1 x (4 + classes) x boxes", cells=2),
    "yolov10": Family(_yolov10, "1 x boxes x (6 + masks)", False),
    "yolox": Family(_yolox, "as yolov5, not decoded"),
    "rows": Family(_rows_of_class_and_score, "boxes x 7, or x 6, class and score first", False),
    "rtdetr": Family(_rtdetr, "1 x boxes x (4 + classes), or boxes and logits"),
    "detr": Family(_detr, "boxes and logits, no object last"),
    "scored": Family(_scored, "corners and scores of all classes"),
    "listed": Family(_listed, "corners, class numbers and scores", False),
}


def _corners(boxes: Tensor) -> Tensor:
    """Corners `[n, 4]` of middles and sides."""
    middle, half = boxes[:, :2], boxes[:, 2:] / 2
    return torch.cat([middle - half, middle + half], 1)


def _refuse_offsets(corners: Tensor, form: Form) -> None:
    dense = any(cells(form.input_px, len(corners) / each) for each in (1, ANCHORS))
    if dense and SHARES < (farthest := float(corners.nan_to_num(0, 0, 0).max())) <= NEAR * min(form.input_px):
        raise ValueError(f"the boxes of all cells reach to {farthest:.3g} px at most, so they seem to be offsets that are not decoded")


def _pair(outputs: Outputs) -> Reading:
    """Boxes `[n, 4]` and `[n, C]` scores or logits from two outputs of a row a box; other outputs may hold masks."""
    rows = {name: each for name, each in outputs.items() if (each.ndim == 3 and len(each) == 1) or each.ndim == 2}
    boxes = [name for name, each in rows.items() if each.shape[-1] == 4]
    box = boxes[0] if len(boxes) == 1 else next((name for name in boxes if "box" in name), None)
    others = [name for name, each in rows.items() if box is not None and name != box and each.shape[:-1] == rows[box].shape[:-1]]
    if box is None or len(others) != 1:
        raise ValueError("there must be two outputs of a row a box, one of them of four numbers")
    found, rest = (each.reshape(-1, each.shape[-1]).float() for each in (rows[box], rows[others[0]]))
    return found, rest


def _not_px(boxes: Tensor) -> Tensor:
    if len(boxes) and (farthest := float(boxes.max())) > SHARES:
        raise ValueError(f"boxes reach to {farthest:.3g} and are no shares of the picture")
    return boxes


def _logits(logits: Tensor) -> Tensor:
    if len(logits) and float(logits.min()) >= 0 and float(logits.max()) <= 1:
        raise ValueError("scores are within 0..1, as logits are not")
    return logits


def _by_class(scores: Tensor, numbers: Tensor) -> Tensor:
    """Scores `[n, C]` of boxes of one class each, from the scores `[n]` and the class numbers `[n]`, of which -1 fills up lists."""
    if len(numbers) and not (_whole(numbers) and numbers.min() >= -1 and numbers.max() < MOST_CLASSES):
        raise ValueError("a box has no class number")
    some = numbers.clamp(min=0).long()
    return (scores * (numbers >= 0))[:, None] * one_hot(some, int(max(some.tolist(), default=0)) + 1)


def _whole(numbers: Tensor) -> bool:
    return bool((numbers == numbers.round()).all())
