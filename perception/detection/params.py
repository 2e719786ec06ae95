"""Detectors by name; a scenario names one."""

from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from perception.detection.yolo import Layout
from world import plugin
from world.params import Params
from world.plugin import OWN, known_or_own
from world.traffic.tracked import Category

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
    """What all detectors have that luxloop runs itself."""

    threshold: float = Field(0.1, gt=0, lt=1, description="least score of what is reported")
    overlap: float = Field(0.5, gt=0, le=1, description="of two boxes whose IoU is larger, the less sure one is left out")


class NetworkParams(FoundParams):
    """luxloop's own network, trained on well-lit scenes."""

    kind: Literal["network"] = "network"
    weights: str | None = Field(None, min_length=1, description="file that `luxloop train-detector` wrote; left out: those shipped")


class CodedParams(FoundParams):
    """Detectors that want pictures as 8-bit cameras take them."""

    gamma: float = Field(2.2, ge=1, le=3, description="frames are coded with its inverse as a power; 1: as they are")


class HogParams(CodedParams):
    """OpenCV's detector of upright people, by histograms of gradients."""

    kind: Literal["hog"] = "hog"
    magnify: float = Field(2.0, ge=0.5, le=8, description="by which frames are enlarged: it finds people of at least 96 px there")
    slope: float = Field(2.0, gt=0, le=20, description="of the logistic curve from the margin, 0 on the edge of what is found, to a score")


class OnnxParams(CodedParams):
    """A network of the user's own as an ONNX file, run by OpenCV."""

    kind: Literal["onnx"] = "onnx"
    file: str = Field(min_length=1, description="the ONNX file")
    layout: Layout = Field("yolov8", description="what it gives, as the networks of that name do")
    input_px: tuple[Side, Side] = Field((640, 640), description="width and height that it takes; frames are fitted in")
    channels: Literal[1, 3] = Field(3, description="that it takes; all are the same grey")
    classes: dict[Annotated[int, Field(ge=0, le=1_000_000)], Category] | None = Field(
        None, min_length=1, description="what its classes are here, by their numbers, others count as nothing; left out: those of COCO"
    )


class OwnDetector(Params):
    """`Name(**options)` of a module of the user's own makes the detector."""

    kind: plugin.OwnName
    options: dict[str, Any] = Field({}, description="keyword arguments of Name, beside the device")


class TruthParams(Params):
    """Every object that the scene holds, however dark it is. The classes are those of the objects, and parked cars are cars."""

    kind: Literal["truth"] = "truth"
    least_height_px: float = Field(12.0, ge=0, le=1e6, description="of what is found")
    least_visible: float = Field(0.3, ge=0, le=1, description="share of an object that nothing hides, of what is found")


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
