"""ONNX files that luxloop does not read as they are: exported for real, refused with what was found and what to do."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

from luxloop.perception.detection.detector import OnnxParams
from luxloop.perception.detection.onnx import OnnxDetector
from tests.refusal import refusal

SIZE = 64  # px, of which a stride of 4 makes 256 boxes


class Tiny(nn.Module):
    """A convolution that gives what a YOLO gives: `[B, numbers, boxes]`, boxes of up to 64 px first."""

    def __init__(self, numbers: int, logits: bool = False, channels: int = 3) -> None:
        super().__init__()
        self.patches = nn.Conv2d(channels, numbers, 4, 4)
        self.logits = logits

    def forward(self, pictures: Tensor) -> Tensor:
        raw = self.patches(pictures).flatten(2)
        boxes, scores = raw[:, :4].sigmoid() * SIZE, raw[:, 4:]
        return torch.cat([boxes, scores if self.logits else scores.sigmoid()], 1)


class YoloV5(Tiny):
    def forward(self, pictures: Tensor) -> Tensor:
        return super().forward(pictures).transpose(1, 2)


class YoloV10(Tiny):
    def forward(self, pictures: Tensor) -> Tensor:
        found = super().forward(pictures).transpose(1, 2)
        numbers = (found[..., 5:] * 80).floor()
        return torch.cat([found[..., :2], found[..., :4].sum(-1, keepdim=True).expand(-1, -1, 2), found[..., 4:5], numbers], -1)


class Grid(Tiny):
    def forward(self, pictures: Tensor) -> Tensor:
        return self.patches(pictures)


class TwoInputs(Tiny):
    def forward(self, pictures: Tensor, scale: Tensor) -> Tensor:
        return super().forward(pictures) * scale


class TwoOutputs(Tiny):
    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        return super().forward(pictures).split((4, 80), 1)


PICTURE = torch.zeros(1, 3, SIZE, SIZE)
OURS = {0: "pedestrian", 1: "car"}


def wrong(module: nn.Module, words: str, *inputs: Tensor, **params: Any) -> tuple:
    return module, words, inputs or (PICTURE,), params


ONE = {0: "pedestrian"}
REFUSED = {
    "yolov8 as yolov5": wrong(Tiny(84), r'layout: .*1 x 84 x 256 .* not within 0..1; set detector.layout = "yolov8"$', layout="yolov5"),
    "yolov5 as yolov8": wrong(YoloV5(85), r'layout: .* scores .*; set detector.layout = "yolov5"$', layout="yolov8"),
    "yolov8 turned, as yolov5, of COCO": wrong(YoloV5(84), r"classes: .* 79 classes .* 80 or 91 of COCO; .* export it", layout="yolov5"),
    "yolov8 turned, as yolov5, all classes": wrong(YoloV5(6), "classes: .* there is no 1; .* 1 x 6 x 256", layout="yolov5", classes=OURS),
    "yolov8 turned, as yolov8": wrong(
        YoloV5(7), 'layout: .* scores .*"yolov5", or export it as 1 x 7 x 256', layout="yolov8", classes=OURS
    ),
    "yolov8 as yolov10": wrong(Tiny(84), r'layout: .* each box has 256 numbers; .* "yolov8"$', layout="yolov10"),
    "yolov10 as yolov8": wrong(YoloV10(6), r'layout: .* scores .*; set detector.layout = "yolov10"$', layout="yolov8"),
    "yolov10 as yolov5": wrong(YoloV10(6), r'layout: .* the sixth number .*"yolov10"$', layout="yolov5", classes=ONE),
    "yolov5 of one class as yolov10": wrong(YoloV5(6), 'layout: .* no.* class number; .* "yolov5"', layout="yolov10", classes=ONE),
    "before the sigmoid": wrong(Tiny(84, logits=True), "layout: .*yolov8: scores reach from -.*; export it"),
    "before the boxes are made": wrong(Grid(255), r"layout: .* 1 x 255 x 16 x 16 numbers, .* known forms .*; export it"),
    "own classes": wrong(Tiny(6), "classes: .* 2 classes as yolov8, and not the 80 or 91 of COCO; set detector.classes$"),
    "classes that it lacks": wrong(Tiny(6), "classes: .* 2 classes .* there is no 2; correct detector.classes$", classes={2: "car"}),
    "two inputs": wrong(TwoInputs(84), "file: .* has a further input .*; export it with the picture alone", PICTURE, torch.ones(1)),
    "two outputs": wrong(TwoOutputs(84), "layout: .* 1 x 4 x 256, .* 1 x 80 x 256 numbers, .* known forms"),
    "four channels": wrong(Tiny(84, channels=4), "file: .* 4 channels, .*; export it for 1 or 3$", PICTURE[:, [0, 1, 2, 0]]),
    "another size": wrong(Tiny(84), r"file: .* 1 x 3 x 32 x 96.*; leave detector.input_px out$", torch.zeros(1, 3, 32, 96)),
}


def opened(file: str | Path, **params: Any) -> OnnxDetector:
    return OnnxDetector(OnnxParams(file=str(file), **{"input_px": (SIZE, SIZE), **params}))


def export(module: nn.Module, inputs: tuple[Tensor, ...], file: Path, **options: Any) -> str:
    torch.manual_seed(0)
    dynamo = bool(options)  # the older exporter is 50 times as fast, and leaves no sizes open
    torch.onnx.export(module.eval(), inputs, file, external_data=False, verbose=False, dynamo=dynamo, **options)
    return str(file)


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_read_wrongly_is_refused_when_it_is_loaded(case, tmp_path):
    module, message, inputs, params = REFUSED[case]
    file = export(module, inputs, tmp_path / "network.onnx")
    with refusal(r"^detector\." + message):
        opened(file, **params)


def test_batches_and_sizes_left_open_and_half_precision_are_taken(tmp_path):
    auto = torch.export.Dim.AUTO
    shapes = ({0: auto, 2: auto, 3: auto},)
    left_open = export(Tiny(84), (torch.zeros(2, 3, 64, 96),), tmp_path / "open.onnx", dynamic_shapes=shapes)
    half = export(Tiny(84).half(), (PICTURE.half(),), tmp_path / "half.onnx")
    for file, size in ((left_open, (64, 32)), (left_open, (128, 64)), (half, (SIZE, SIZE))):
        assert opened(file, input_px=size).detect(torch.rand(1, 48, 64))[0].scores.shape[1] == 6


def test_scores_that_leave_their_range_in_a_later_frame_are_refused(tmp_path):
    """Logits of a network that says no to what it was loaded with."""

    class Late(nn.Module):
        def forward(self, pictures: Tensor) -> Tensor:
            return torch.cat([pictures.new_full((1, 4, 5), 20.0), pictures.amin((1, 2, 3)).mul(5).view(1, 1, 1).expand(1, 1, 5)], 1)

    late = opened(export(Late(), (PICTURE,), tmp_path / "late.onnx"), classes={0: "car"})
    assert len(late.detect(torch.zeros(1, 32, 32))[0]) == 0
    with refusal(r"scores reach from 5 to 5 and not within 0..1"):
        late.detect(torch.ones(1, 32, 32))


def written(nodes: list[onnx.NodeProto], tensors: list[TensorProto], file: Path) -> str:
    """A network from x, a picture, to y."""
    ends = [[helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, 3, SIZE, SIZE))] for name in "xy"]
    graph = helper.make_graph(nodes, "g", *ends, tensors)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), file)
    return str(file)


def test_sizes_that_are_only_declared_fill_no_memory(tmp_path):
    """OpenCV crashes at weights that are not there, and takes 40 GB for numbers that a layer makes of nothing."""
    weights = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=(30_000, 30_000), raw_data=b"0000")
    add = helper.make_node("Add", ["x", "w"], ["y"])
    with refusal(r"is not a valid ONNX file \(.*size \(4 bytes\) is too small.*\); export it again"):
        opened(written([add], [weights], tmp_path / "weights.onnx"))
    nodes = [helper.make_node("ReduceSum", ["x"], ["d"], keepdims=0), helper.make_node("Expand", ["d", "sides"], ["w"]), add]
    sides = numpy_helper.from_array(np.array([100_000, 100_000]), "sides")
    with refusal(r"numbers between two of its layers .* at least 40 GB of memory, more than the budget"):
        opened(written(nodes, [sides], tmp_path / "made.onnx"))


CONV, ZERO = numpy_helper.from_array(np.zeros((3, 3, 1, 1), np.float32), "w"), numpy_helper.from_array(np.zeros(1, np.int32), "w")
INTEGERS = [helper.make_node("Cast", ["x"], ["i"], to=TensorProto.INT32), helper.make_node("Cast", ["j"], ["y"], to=TensorProto.FLOAT)]


@pytest.mark.parametrize(
    ("nodes", "tensors", "words"),
    [
        ([helper.make_node("Conv", ["x", "w"], ["y"], strides=[0, 0])], [CONV], "Conv divides by 0 or less .strides"),
        ([helper.make_node("MaxPool", ["x"], ["y"], strides=[1, 0], kernel_shape=[2, 2])], [], "MaxPool divides by 0 or less .strides"),
        ([helper.make_node("SpaceToDepth", ["x"], ["y"], blocksize=0)], [], "SpaceToDepth divides by 0 or less .blocksize"),
        ([INTEGERS[0], helper.make_node("Mod", ["i", "w"], ["j"]), INTEGERS[1]], [ZERO], "Mod divides by 0 or less .a constant"),
    ],
)
def test_divisions_by_zero_which_would_end_the_process_are_refused(nodes, tensors, words, tmp_path):
    with refusal(rf"^detector\.file: .*{words}"):
        opened(written(nodes, tensors, tmp_path / "a.onnx"))


def test_functions_and_unknown_types_are_refused(tmp_path):
    """Functions that call the one before twice take onnx 2^k checks."""
    file = tmp_path / "a.onnx"
    model = onnx.load(written([helper.make_node("Identity", ["x"], ["y"])], [], file))
    model.graph.input[0].type.tensor_type.elem_type = 99
    onnx.save(model, file)
    with refusal(r"^detector\.file: .*type 99"):
        opened(file)
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("own", 1)]
    for k in range(40):
        called = ("Identity", "") if k == 0 else (f"f{k - 1}", "own")
        body = [helper.make_node(called[0], [a], [b], domain=called[1]) for a, b in ("at", "tb")]
        model.functions.append(helper.make_function("own", f"f{k}", ["a"], ["b"], body, opsets))
    onnx.save(model, file)
    with refusal(r"^detector\.file: .*holds functions"):
        opened(file)
