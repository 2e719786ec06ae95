"""Checks of a user's ONNX file before OpenCV, which does not check it, opens it."""

import math
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import cv2

from luxloop.perception.detection.detector import MOST_PX, OnnxParams
from luxloop.world.errors import LuxloopError
from luxloop.world.files import afford

if TYPE_CHECKING:
    import onnx

BYTES_A_NUMBER = 4  # OpenCV computes in single precision
FROM_1 = {
    "strides",
    "dilations",
    "kernel_shape",
    "group",
    "blocksize",
}  # attributes by which OpenCV and onnx divide, which ends the process
INTEGERS = (2, 3, 4, 5, 6, 7, 12, 13)  # of onnx.TensorProto.DataType: of 8 to 64 bits
BYTES_A_BYTE = 4  # of a file while it is read: the bytes, onnx's copy, two in OpenCV
FLOATS = ("float32", "float16")  # OpenCV converts to the second itself


def open_network(params: OnnxParams) -> cv2.dnn.Net:
    """The network of a file.

    Raises LuxloopError where the file is missing, damaged or unreadable for OpenCV, where it has other than one input and one output, and
    where the input is not floating-point, 1 x channels x height x width, as in the parameters.
    """
    if not os.path.isfile(params.file):
        raise LuxloopError(f"detector.file: {params.file}: there is no such file; check the path")
    _check(_checked_model(params.file), params)
    try:
        # the classic engine gives outputs in another order
        return cv2.dnn.readNetFromONNX(params.file, cv2.dnn.ENGINE_NEW)
    except cv2.error as error:
        raise LuxloopError(f"detector.file: {params.file}: OpenCV cannot read it ({error_text(error)}); export it again") from error


def error_text(error: Exception) -> str:
    """The text of a library's error in one line."""
    return " ".join(str(getattr(error, "err", None) or error).split())[:200]


def size_text(sizes: tuple[int | str, ...]) -> str:
    """Sizes in words."""
    return " x ".join(map(str, sizes))


def _checked_model(file: str) -> "onnx.ModelProto":
    """The model of a file, checked since OpenCV crashes on damaged tensors."""
    import onnx
    from google.protobuf.message import DecodeError

    afford(f"detector.file: {file}: reading it", BYTES_A_BYTE * os.path.getsize(file), "export a smaller network")
    try:
        model = onnx.load(file, load_external_data=False)
        if model.functions:  # functions may call each other, so that a check might never end
            raise LuxloopError(f"detector.file: {file}: holds functions, {model.functions[0].name} the first; export it with these inlined")
        onnx.checker.check_model(file)
    except (OSError, DecodeError, UnicodeDecodeError, onnx.checker.ValidationError) as error:
        raise LuxloopError(f"detector.file: {file}: is not a valid ONNX file ({error_text(error)}); export it again") from error
    zeros = {each.name for each in model.graph.initializer if _has_zero(each)}
    for node in _nodes(model.graph):
        values = {each.name: each for each in node.attribute}
        if node.op_type == "Constant" and "value" in values and _has_zero(values["value"].t):
            zeros.update(node.output)
        low = [name for name in FROM_1 & values.keys() if min(values[name].ints or [values[name].i]) < 1]
        if low or (node.op_type in ("Div", "Mod") and not zeros.isdisjoint(node.input[1:])):
            raise LuxloopError(
                f"detector.file: {file}: a {node.op_type} divides by 0 or less ({', '.join(low) or 'a constant'}); export it again"
            )
    return model


def _has_zero(tensor: "onnx.TensorProto") -> bool:
    """Whether an integer tensor contains 0."""
    from onnx import numpy_helper

    return tensor.data_type in INTEGERS and not tensor.external_data and not numpy_helper.to_array(tensor).all()


def _nodes(graph: "onnx.GraphProto") -> Iterator["onnx.NodeProto"]:
    """Nodes of a graph and of its subgraphs."""
    for node in graph.node:
        yield node
        for attribute in node.attribute:
            for inner in (attribute.g, *attribute.graphs):
                yield from _nodes(inner)


def _check(model: "onnx.ModelProto", params: OnnxParams) -> None:
    where, weights = f"detector.file: {params.file}", {tensor.name for tensor in model.graph.initializer}
    inputs = [each for each in model.graph.input if each.name not in weights]
    found = ", ".join(map(_describe, inputs))
    if len(inputs) != 1:
        raise LuxloopError(f"{where}: has {len(inputs)} inputs: {found}; export it with one, the picture")
    if len(model.graph.output) != 1:
        outputs = ", ".join(map(_describe, model.graph.output))
        raise LuxloopError(f"{where}: has {len(model.graph.output)} outputs: {outputs}; export it with one that holds boxes and scores")
    shape = inputs[0].type.tensor_type.shape
    sizes = _sizes(inputs[0])
    pictures_last = sizes[3:] in ((1,), (3,)) and sizes[1] not in (1, 3)
    if _number_type(inputs[0]) not in FLOATS or len(sizes) != 4 or pictures_last:
        raise LuxloopError(f"{where}: takes {found}; export it for float32 numbers of 0..1, 1 x channels x height x width (NCHW)")
    wanted = (1, params.channels, *reversed(params.input_px))
    batch, channels, height, width = (given if isinstance(size, str) else size for size, given in zip(sizes, wanted, strict=True))
    if batch != 1:
        raise LuxloopError(f"{where}: takes {batch} pictures at once, {found}; export it for a batch of 1")
    if channels != params.channels:
        remedy = f"set detector.channels = {channels}" if channels in (1, 3) else "export it for 1 or 3"
        raise LuxloopError(f"{where}: takes pictures of {channels} channels and not {params.channels}, {found}; {remedy}")
    if (width, height) != params.input_px:
        fits = max(width, height) <= MOST_PX
        remedy = f"set detector.input_px = [{width}, {height}]" if fits else f"export it for {MOST_PX} x {MOST_PX} px at most"
        raise LuxloopError(f"{where}: takes pictures of {width} x {height} px and not {size_text(params.input_px)}; {remedy}")
    for dimension, size in zip(shape.dim, wanted, strict=True):
        dimension.dim_value = size
    afford(
        f"{where}: the numbers between two of its layers for pictures of {size_text(params.input_px)} px",
        BYTES_A_NUMBER * _most_numbers(model, where),
        "export a smaller network, or one for smaller pictures",
    )


def _most_numbers(model: "onnx.ModelProto", where: str) -> int:
    """Largest number of values in a layer's output, as far as shapes follow from the input; open sizes count as 0."""
    from onnx.shape_inference import InferenceError, infer_shapes

    try:
        graph = infer_shapes(model, data_prop=True).graph
    except (InferenceError, UnicodeDecodeError) as error:
        raise LuxloopError(f"{where}: its layers do not fit each other ({error_text(error)}); export it again") from error
    shapes = (each.type.tensor_type.shape.dim for each in (*graph.value_info, *graph.output))
    return max((math.prod(size.dim_value for size in shape) for shape in shapes), default=0)


def _describe(value: "onnx.ValueInfoProto") -> str:
    return f"{value.name} ({_number_type(value)} {size_text(_sizes(value))})"


def _sizes(value: "onnx.ValueInfoProto") -> tuple[int | str, ...]:
    """Sizes of a value; open ones are texts."""
    dimensions = value.type.tensor_type.shape.dim
    return tuple(each.dim_value if each.HasField("dim_value") else each.dim_param or "?" for each in dimensions)


def _number_type(value: "onnx.ValueInfoProto") -> str:
    import onnx

    names: dict[int, str] = {number: name.lower() for name, number in onnx.TensorProto.DataType.items()}
    kind = value.type.tensor_type.elem_type
    return {"float": "float32"}.get(name := names.get(kind, f"type {kind}"), name)
