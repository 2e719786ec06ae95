"""Detectors by name; a scenario names one."""

from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from luxloop.perception.detection.yolo import Layout
from luxloop.world import plugin
from luxloop.world.params import Params
from luxloop.world.plugin import OWN, known_or_own
from luxloop.world.traffic.tracked import Category

# What COCO's numbers of classes, which most networks of others know, are here; all else that they find is left out.
COCO: dict[int, Category] = {
    0: "pedestrian",
    1: "cyclist",
    2: "car",
    3: "motorcycle",
    5: "truck",
    7: "truck",
    **dict.fromkeys(range(14, 24), "animal"),
}
COCO_CLASSES = 80
MOST_PX = 8192
Side = Annotated[int, Field(ge=1, le=MOST_PX)]  # px


class FoundParams(Params):
    """Common parameters of the detectors that luxloop runs itself."""

    threshold: float = Field(0.1, gt=0, lt=1, description="least score of reported detections")
    overlap: float = Field(0.5, gt=0, le=1, description="IoU above which the box of lower score is suppressed")


class NetworkParams(FoundParams):
    """luxloop's own network, trained on well-lit scenes."""

    kind: Literal["network"] = "network"
    weights: str | None = Field(None, min_length=1, description="weights file from `luxloop train-detector`; left out: the shipped weights")


class CodedParams(FoundParams):
    """Common parameters of detectors that take 8-bit gamma-coded images."""

    gamma: float = Field(2.2, ge=1, le=3, description="frames are raised to the power 1/gamma before detection; 1: unchanged")


class HogParams(CodedParams):
    """OpenCV's detector of upright people, by histograms of gradients."""

    kind: Literal["hog"] = "hog"
    magnify: float = Field(2.0, ge=0.5, le=8, description="enlargement of frames; HOG finds people of at least 96 px in the enlarged frame")
    slope: float = Field(
        2.0, gt=0, le=20, description="slope of the logistic curve from the SVM's margin to a score; the margin is 0 at the detection limit"
    )


class OnnxParams(CodedParams):
    """A user-provided network as an ONNX file, run by OpenCV."""

    kind: Literal["onnx"] = "onnx"
    file: str = Field(min_length=1, examples=["detector.onnx"], description="ONNX file of the network")
    layout: Layout = Field("yolov8", description="layout of its output, named after a network family")
    input_px: tuple[Side, Side] = Field((640, 640), description="width and height of its input; frames are fitted in")
    channels: Literal[1, 3] = Field(3, description="channels of its input, all with the same grey")
    white: Literal[1, 255] | None = Field(None, description="number of white in its input, 255 for YOLOX; left out: 1")
    classes: dict[Annotated[int, Field(ge=0, le=1_000_000)], Category] | None = Field(
        None, min_length=1, description="luxloop's class for each of its class numbers; others are ignored; left out: COCO's"
    )


class OwnDetector(Params):
    """`Name(**options)` of a user's module makes the detector."""

    kind: plugin.OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name, in addition to the device")


class TruthParams(Params):
    """Ground truth: every object of the scene, however dark. Classes are those of the objects, parked cars included."""

    kind: Literal["truth"] = "truth"
    least_height_px: float = Field(12.0, ge=0, le=1e6, description="least height of a detected object")
    least_visible: float = Field(0.3, ge=0, le=1, description="least visible share of a detected object")


RunParams = NetworkParams | HogParams | OnnxParams | OwnDetector
AnyParams = RunParams | TruthParams
DetectorParams = Annotated[
    Annotated[NetworkParams, Tag("network")]
    | Annotated[HogParams, Tag("hog")]
    | Annotated[OnnxParams, Tag("onnx")]
    | Annotated[TruthParams, Tag("truth")]
    | Annotated[OwnDetector, Tag(OWN)],
    known_or_own("kind"),
]
