"""A user's ONNX file: checked before a library that does not check it opens it, and run by onnxruntime, or by OpenCV without it."""

import ast
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from luxloop.perception.detection.detector import MOST_PX, OnnxParams
from luxloop.world.errors import LuxloopError
from luxloop.world.files import afford

if TYPE_CHECKING:
    import onnx

Array = NDArray[Any]
Run = Callable[[Mapping[str, Array]], Mapping[str, Array]]
ONNXRUNTIME, OPENCV = "onnxruntime", "OpenCV"
BYTES_A_NUMBER = 4  # of most networks
FROM_1 = {
    "strides",
    "dilations",
    "kernel_shape",
    "group",
    "blocksize",
}  # attributes by which OpenCV and onnx divide, which ends the process
INTEGERS = (2, 3, 4, 5, 6, 7, 12, 13)  # of onnx.TensorProto.DataType: of 8 to 64 bits
BYTES_A_BYTE = 4  # of a file while it is read: the bytes, onnx's copy, two in OpenCV
NUMBERS = {"float32": np.float32, "float16": np.float16, "float64": np.float64, "uint8": np.uint8}
USUAL_PX = (640, 640)  # of a file that leaves the size open
NAMES = "names"  # Ultralytics' metadata: a dictionary of class names by number
LONGEST_NAMES = 100_000  # characters


@dataclass(frozen=True)
class Picture:
    """The picture that a network takes. axes: NCHW, NHWC, CHW or HWC. numbers: NumPy's name of their type."""

    name: str
    axes: str
    numbers: str
    channels: int
    input_px: tuple[int, int]
    batch: int = 1

    def __str__(self) -> str:
        width, height = self.input_px
        sizes = {"N": self.batch, "C": self.channels, "H": height, "W": width}
        return f"{self.numbers} {size_text(tuple(sizes[each] for each in self.axes))} ({self.axes})"

    def blob(self, picture: NDArray[np.float32]) -> Array:
        """The input for a picture `[channels, rows, columns]`; a batch repeats it."""
        turned = np.moveaxis(picture, 0, -1) if self.axes.endswith("C") else picture
        kind = np.dtype(NUMBERS[self.numbers])
        cast = (turned.round().clip(0, 255) if kind.kind == "u" else turned).astype(kind)
        return np.ascontiguousarray(np.repeat(cast[None], self.batch, 0) if self.axes[0] == "N" else cast)


@dataclass(frozen=True)
class Network:
    """A network of a file. names: its classes by number, if the file names them. extra: further inputs.

    run: gives outputs by name for inputs by name, by the library.
    """

    picture: Picture
    names: Mapping[int, str]
    extra: Mapping[str, Array]
    library: str
    run: Run

    def outputs(self, picture: NDArray[np.float32]) -> dict[str, Tensor]:
        """Outputs by name for a picture `[channels, rows, columns]`; those of a batch are of the first."""
        found = self.run({self.picture.name: self.picture.blob(picture), **self.extra})
        batch = self.picture.batch
        of_first = {name: each[:1] if batch > 1 and each.shape[:1] == (batch,) else each for name, each in found.items()}
        return {name: torch.from_numpy(np.array(each)) for name, each in of_first.items()}


def open_network(params: OnnxParams) -> Network:
    """The network of a file.

    Raises LuxloopError where the file is missing, damaged or unreadable, where no input is a picture of 1 or 3 channels, or where it has
    inputs that luxloop cannot fill.
    """
    if not os.path.isfile(params.file):
        raise LuxloopError(f"detector.file: {params.file}: there is no such file; check the path")
    model = _checked_model(params.file)
    picture, extra = _inputs(model, params)
    return Network(picture, _names(model), extra, *_runner(model, params.file, picture))


def _runner(model: "onnx.ModelProto", file: str, picture: Picture) -> tuple[str, Run]:
    """Library and function from inputs to outputs; onnxruntime where it is installed."""
    outputs = [each.name for each in model.graph.output]
    try:
        import onnxruntime
    except ImportError:
        return OPENCV, _opencv(file, picture, outputs)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its errors have no class of their own
        raise LuxloopError(f"detector.file: {file}: onnxruntime cannot read it ({error_text(error)}); export it again") from error

    def run(given: Mapping[str, Array]) -> Mapping[str, Array]:
        try:
            return dict(zip(outputs, map(np.asarray, session.run(outputs, dict(given))), strict=True))
        except Exception as error:
            raise _cannot_run(file, ONNXRUNTIME, picture, error) from error

    return ONNXRUNTIME, run


def _opencv(file: str, picture: Picture, outputs: Sequence[str]) -> Run:
    if picture.numbers not in ("float32", "float16"):
        raise LuxloopError(
            f"detector.file: {file}: takes {picture}, which OpenCV cannot run; install onnxruntime: pip install 'luxloop[onnx]'"
        )
    try:
        # the classic engine gives outputs in another order
        net = cv2.dnn.readNetFromONNX(file, cv2.dnn.ENGINE_NEW)
    except cv2.error as error:
        remedy = "install onnxruntime, which reads more files: pip install 'luxloop[onnx]'"
        raise LuxloopError(f"detector.file: {file}: OpenCV cannot read it ({error_text(error)}); {remedy}") from error

    def run(given: Mapping[str, Array]) -> Mapping[str, Array]:
        try:
            for name, each in given.items():
                net.setInput(each.astype(np.float32) if each.dtype == np.float16 else each, name)
            return dict(zip(outputs, map(np.asarray, net.forward(list(outputs))), strict=True))
        except cv2.error as error:
            raise _cannot_run(file, OPENCV, picture, error) from error

    return run


def _cannot_run(file: str, library: str, picture: Picture, error: Exception) -> LuxloopError:
    return LuxloopError(
        f"detector.file: {file}: {library} cannot run it on {picture} ({error_text(error)}); correct detector.input_px, or export it again"
    )


def _names(model: "onnx.ModelProto") -> dict[int, str]:
    """Names of classes by number from Ultralytics' metadata; empty without."""
    texts = {each.key: each.value for each in model.metadata_props}
    with suppress(ValueError, SyntaxError, MemoryError, RecursionError):
        found = ast.literal_eval(texts.get(NAMES, "")[:LONGEST_NAMES])
        named = dict(enumerate(found)) if isinstance(found, list) else found
        if isinstance(named, dict) and all(isinstance(key, int) and isinstance(name, str) for key, name in named.items()):
            return named
    return {}


def _inputs(model: "onnx.ModelProto", params: OnnxParams) -> tuple[Picture, dict[str, Array]]:
    """The picture and the values of all other inputs; their open sizes are fixed in the model, which is refused if it takes too much."""
    where, weights = f"detector.file: {params.file}", {tensor.name for tensor in model.graph.initializer}
    inputs = [each for each in model.graph.input if each.name not in weights]
    if not inputs:
        raise LuxloopError(f"{where}: has no input; export it with one, the picture")
    first = next((each for each in inputs if len(_sizes(each)) in (3, 4)), inputs[0])
    picture = _picture(first, params)
    sizes = {"N": picture.batch, "C": picture.channels, "H": picture.input_px[1], "W": picture.input_px[0]}
    for dimension, axis in zip(first.type.tensor_type.shape.dim, picture.axes, strict=True):
        dimension.dim_value = sizes[axis]
    extra = {each.name: _extra(each, picture, where) for each in inputs if each is not first}
    afford(
        f"{where}: the numbers between two of its layers for pictures of {size_text(picture.input_px)} px",
        BYTES_A_NUMBER * _most_numbers(model, where),
        "export a smaller network, or one for smaller pictures",
    )
    return picture, extra


def _picture(given: "onnx.ValueInfoProto", params: OnnxParams) -> Picture:
    where, found, sizes, numbers = f"detector.file: {params.file}", _describe(given), _sizes(given), _number_type(given)
    channels = (1, 3)
    last = len(sizes) in (3, 4) and sizes[-1] in channels and sizes[-3] not in channels
    axes = ("N" if len(sizes) == 4 else "") + ("HWC" if last else "CHW")
    if numbers not in NUMBERS or len(sizes) not in (3, 4):
        raise LuxloopError(
            f"{where}: takes {found}; export it for one picture of {', '.join(NUMBERS)}, such as 1 x channels x height x width"
        )
    of = dict(zip(axes, sizes, strict=True))
    usual = params.input_px or USUAL_PX
    width, height = (_or(of[axis], px) if params.input_px is None else px for axis, px in zip("WH", usual, strict=True))
    batch, depth = _or(of.get("N", 1), 1), _or(of["C"], channels[-1])
    if depth not in channels:
        raise LuxloopError(f"{where}: takes pictures of {depth} channels, {found}; export it for 1 or 3")
    if max(width, height) > MOST_PX:
        raise LuxloopError(f"{where}: takes pictures of {width} x {height} px; export it for {MOST_PX} x {MOST_PX} px at most")
    for size, given_size in ((of["W"], width), (of["H"], height)):
        if size != given_size and not isinstance(size, str):
            raise LuxloopError(f"{where}: takes {found} and not pictures of {width} x {height} px; leave detector.input_px out")
    return Picture(given.name, axes, numbers, depth, (width, height), batch)


def _or(size: int | str, usual: int) -> int:
    """A size, or the usual one if it is open."""
    return usual if isinstance(size, str) else size


def _extra(given: "onnx.ValueInfoProto", picture: Picture, where: str) -> Array:
    """The value of a further input: the size of the picture, or a mask of its valid pixels."""
    import onnx

    width, height = picture.input_px
    sizes, numbers = _sizes(given), onnx.helper.tensor_dtype_to_np_dtype(given.type.tensor_type.elem_type)
    values = {"orig_target_sizes": (width, height), "im_shape": (height, width), "scale_factor": (1, 1)}
    if given.name in values and len(sizes) == 2:
        return np.array([values[given.name]] * picture.batch, numbers)
    if "mask" in given.name and len(sizes) == 3:
        return np.ones([_or(size, usual) for size, usual in zip(sizes, (picture.batch, height, width), strict=True)], numbers)
    raise LuxloopError(
        f"{where}: has a further input {_describe(given)}; only {', '.join(values)} and pixel masks are known; export it with the picture "
        "alone, or write a detector of your own"
    )


def error_text(error: Exception) -> str:
    """The text of a library's error in one line."""
    return " ".join(str(getattr(error, "err", None) or error).split())[:200]


def size_text(sizes: tuple[int | str, ...]) -> str:
    """Sizes in words; a number without any is 1."""
    return " x ".join(map(str, sizes)) or "1"


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
    return {"float": "float32", "double": "float64"}.get(name := names.get(kind, f"type {kind}"), name)
