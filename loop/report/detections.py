"""What an ONNX network finds in pictures, and how luxloop reads it."""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from luxloop.loop.report.picture import Mark, draw_marks
from luxloop.loop.scenario.model import load
from luxloop.perception.detection.detector import Detections, OnnxParams
from luxloop.perception.detection.onnx import OnnxDetector
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write
from luxloop.world.images import decode


def draw_detections(file: Path, pictures: Sequence[Path], keys: Sequence[str], out: Path) -> str:
    """Write each picture with the boxes of an ONNX network into a folder; gives layout, input, classes and times in words.

    keys: `detector.KEY=VALUE`. Raises LuxloopError for a file or a picture that cannot be read, before anything is written.
    """
    params = load("flat", [f"detector={{ kind = 'onnx', file = {json.dumps(str(file))} }}", *keys]).detector
    if not isinstance(params, OnnxParams):
        raise LuxloopError(f"detector.kind: {file} is read as an ONNX file; leave detector.kind out")
    if len(written := {picture: out / f"{picture.stem}-found.png" for picture in pictures}) > len(set(written.values())):
        raise LuxloopError(f"{out}: pictures of equal names would replace each other; rename them, or detect each by itself")
    greys = [_read(picture) for picture in pictures]
    detector = OnnxDetector(params)
    told = [f"{file}: {detector}"]
    some = False
    for picture, grey in zip(pictures, greys, strict=True):
        frame = torch.from_numpy(grey).float()[None] / 255
        begin = time.perf_counter()
        (found,) = detector.detect(frame**params.gamma)
        took_ms = 1000 * (time.perf_counter() - begin)
        drawn = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
        draw_marks(drawn, _marks(found, detector.classes))
        out.mkdir(parents=True, exist_ok=True)
        atomic_write(written[picture], cv2.imencode(".png", cv2.cvtColor(drawn, cv2.COLOR_RGB2BGR))[1].tobytes())
        named = ", ".join(f"{detector.classes[int(each.argmax())]} {float(each.max()):.2f}" for each in found.scores) or "nothing"
        told.append(f"{picture}: {named} in {took_ms:.0f} ms; {written[picture]}")
        some |= len(found) > 0
    if pictures and not some:
        told.append("Nothing is found where detector.white, detector.mean or detector.std is wrong, or detector.threshold too high.")
    return "\n".join(told)


def _read(picture: Path) -> np.ndarray:
    try:
        grey = decode(picture.read_bytes(), str(picture), cv2.IMREAD_GRAYSCALE)
    except OSError as error:
        raise LuxloopError(f"{picture}: cannot be read ({error.strerror}); check the path") from error
    if grey is None:
        raise LuxloopError(f"{picture}: is damaged or no picture; give a PNG or JPEG file")
    return grey


def _marks(found: Detections, classes: Sequence[str]) -> Iterator[Mark]:
    for box, scores in zip(found.boxes.round().int().tolist(), found.scores, strict=True):
        left, top, right, bottom = box
        corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
        lines = tuple(zip(corners, corners[1:] + corners[:1], strict=True))
        yield Mark(lines, text=f"{classes[int(scores.argmax())]} {100 * float(scores.max()):.0f} %", at=(left, top))
