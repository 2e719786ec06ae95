"""Networks from ONNX files, exported for real and run by OpenCV."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import helper, numpy_helper
from torch import Tensor, nn

from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import NetworkParams, OnnxParams, overlaps
from luxloop.perception.detection.network import CODE, Network, NetworkDetector, boxes_of
from luxloop.perception.detection.onnx import OnnxDetector
from tests.refusal import refusal

CPU, FLOAT = torch.device("cpu"), onnx.TensorProto.FLOAT


def export(module: nn.Module, size: tuple[int, int, int], file: Path) -> Path:
    """Write a module that takes `[1, channels, height, width]` as ONNX."""
    torch.onnx.export(
        module.eval(), (torch.rand(1, *size),), file, external_data=False, verbose=False, dynamo=False
    )  # the other takes 50 times as long
    return file


class AsYolo(nn.Module):
    """luxloop's own network in the clothes of YOLOv8, for frames that are coded with the power that it codes them with itself."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, frames: Tensor) -> Tensor:
        logits, sides = self.network(frames)
        low, high = boxes_of(sides).split(2, 1)
        return torch.cat([(low + high) / 2, high - low, logits.sigmoid()], 1).flatten(2)


def says(numbers: Any, size: tuple[int, int], file: Path) -> str:
    """Write a network that gives the same numbers whatever it sees, 3 channels of a size; what it sees takes part by zero times its sum."""
    nodes = [
        helper.make_node("Flatten", ["frames"], ["flat"]),
        helper.make_node("MatMul", ["flat", "zeros"], ["nothing"]),
        helper.make_node("ReduceSum", ["nothing"], ["sum"], keepdims=0),
        helper.make_node("Add", ["sum", "numbers"], ["found"]),
    ]
    constants = {"zeros": np.zeros((3 * size[0] * size[1], 1), np.float32), "numbers": np.float32(numbers)[None]}
    initial = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    tensors = [
        helper.make_tensor_value_info(*each) for each in (("frames", FLOAT, (1, 3, *size)), ("found", FLOAT, (1, *np.shape(numbers))))
    ]
    graph = helper.make_graph(nodes, "says", tensors[:1], tensors[1:], initial)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), file)
    return str(file)


def test_our_own_network_exported_finds_what_it_finds_here(lit, tmp_path):
    ours = detector(NetworkParams(threshold=0.3), CPU)
    assert isinstance(ours, NetworkDetector)
    file = export(AsYolo(ours.network), (1, 360, 640), tmp_path / "ours.onnx")
    theirs = detector(
        OnnxParams(file=str(file), gamma=1 / CODE, input_px=(640, 360), threshold=0.3, classes=dict(enumerate(ours.classes))),
        CPU,
    )
    frame = lit.frame(10.0)
    (here,), (there,) = ours.detect(frame), theirs.detect(frame)
    assert theirs.classes == ours.classes
    sure = here.scores.amax(1) > 0.4
    best = overlaps(here.boxes[sure], there.boxes).max(1)
    assert sure.sum() >= 3
    # its frames have 8 bits, and all cells of a peak count in place of the highest: up to 0.11 in two frames
    assert (best.values > 0.8).all()
    torch.testing.assert_close(there.scores[best.indices], here.scores[sure], atol=0.15, rtol=0.0)


LAYOUTS = {
    "yolov8": [[100.0, 300], [90, 200], [40, 20], [80, 20], [0.9, 0.2], [0.05, 0.7]],
    "yolov5": [[100.0, 90, 40, 80, 0.9, 1.0, 0.05], [300, 200, 20, 20, 0.7, 0.2, 1.0]],
    "yolov10": [[80.0, 50, 120, 130, 0.9, 0], [290, 190, 310, 210, 0.7, 1], [0, 0, 9, 9, 0.8, 2]],
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_are_understood_and_frames_fitted_in(layout, tmp_path):
    """320 x 160 px are fitted into 640 x 640: doubled, with 160 rows of grey above."""
    file = says(LAYOUTS[layout], (640, 640), tmp_path / "says.onnx")
    found = OnnxDetector(OnnxParams(file=file, layout=layout, classes={0: "pedestrian", 1: "animal"}))
    first, second = found.detect(torch.rand(2, 160, 320))
    expected = torch.tensor([[40.0, 0, 60, 0], [145, 15, 155, 25]])
    assert found.classes == ("pedestrian", "animal")
    for each in (first, second):
        assert torch.allclose(each.boxes, expected)
        assert torch.allclose(each.scores.amax(1), torch.tensor([0.9, 0.7]))
        assert each.scores.argmax(1).tolist() == [0, 1]


DENSE = np.random.default_rng(0).random((3549, 85))  # one box a cell of 52 x 52, 26 x 26 and 13 x 13
DECODED = DENSE * np.array([416.0, 416, 60, 60, *[1] * 81])


@pytest.mark.parametrize("layout", ["yolov5", "yolov8"])
def test_offsets_that_are_not_decoded_are_refused(layout, tmp_path):
    for offset in (0.0, -0.9):
        raw = DENSE * np.array([1.0, 1, 4, 4, *[1] * 81]) + np.array([0, 0, offset, offset, *[0] * 81])
        file = says(raw if layout == "yolov5" else raw[:, :84].T, (416, 416), tmp_path / "says.onnx")
        with refusal(r"detector\.layout: .*not decoded"):
            OnnxDetector(OnnxParams(file=file, layout=layout, input_px=(416, 416)))


def test_a_network_like_yolox_is_told_its_white(tmp_path):
    file = says(DECODED, (416, 416), tmp_path / "says.onnx")
    with refusal(r"detector\.white: .*255 for YOLOX"):
        OnnxDetector(OnnxParams(file=file, layout="yolov5", input_px=(416, 416)))
    nodes = [helper.make_node("ReduceMax", ["x"], ["m"], keepdims=0), helper.make_node("Mul", ["m", "box"], ["y"])]
    box = numpy_helper.from_array(np.float32([[[20, 20, 8, 8, 1, 0.9]]]) / np.float32(255), "box")  # as sure as its picture is bright
    ends = [[helper.make_tensor_value_info(*each)] for each in (("x", FLOAT, (1, 3, 64, 64)), ("y", FLOAT, (1, 1, 6)))]
    graph = helper.make_graph(nodes, "g", *ends, [box])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), tmp_path / "white.onnx")
    found = OnnxDetector(OnnxParams(file=str(tmp_path / "white.onnx"), layout="yolov5", input_px=(64, 64), white=255, classes={0: "car"}))
    assert found.detect(torch.ones(1, 64, 64))[0].scores.tolist() == [[pytest.approx(0.9)]]


def test_one_class_that_is_always_sure_is_no_class_number(tmp_path):
    """Training with one class leaves its score at 1; centres beside sides are not in the order of corners."""
    file = says([[320.0, 320, 100, 200, 0.9, 1], [100, 200, 60, 40, 0.001, 1]], (640, 640), tmp_path / "says.onnx")
    (found,) = OnnxDetector(OnnxParams(file=file, layout="yolov5", classes={0: "car"})).detect(torch.rand(1, 640, 640))
    assert found.boxes.tolist() == [[270, 220, 370, 420]] and found.scores.tolist() == [[pytest.approx(0.9)]]


def test_what_is_not_finite_is_left_out(tmp_path):
    for wrong in (np.nan, np.inf):
        for number in (0, 2, 4):  # of what it says: the middle, the width, a score
            numbers = np.array(LAYOUTS["yolov8"])
            numbers[number, 0] = wrong
            file = says(numbers, (640, 640), tmp_path / "says.onnx")
            (found,) = OnnxDetector(OnnxParams(file=file, layout="yolov8", classes={0: "pedestrian", 1: "animal"})).detect(
                torch.rand(1, 160, 320)
            )
            assert found.boxes.tolist() == [pytest.approx([145, 15, 155, 25])] and found.scores[0].tolist() == pytest.approx([0.2, 0.7])


def test_what_is_no_network_is_said_in_a_sentence(tmp_path):
    (tmp_path / "broken.onnx").write_bytes(b"no network")
    told = {"none.onnx": "detector.file: .*none.onnx: there is no such file", "broken.onnx": "broken.onnx: is not a valid ONNX file"}
    for name, words in told.items():
        with refusal(words):
            OnnxDetector(OnnxParams(file=str(tmp_path / name)))
