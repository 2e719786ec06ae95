"""A run as a video: the camera's picture with what the controller saw in it, the road from above, and the beam pattern."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np
import torch
from torch import Tensor

from loop.recording.recorder import loss_name
from loop.symbol.judging import Judge
from loop.symbol.simulation import Simulation, StepResult
from perception.birdseye import rectify
from perception.camera import luminance_of
from world.errors import LuxloopError
from world.files import part_of

Picture = np.ndarray  # [H, W, 3] uint8, RGB

SEEN_RGB, TARGET_RGB, TEXT_RGB, LOST_RGB = (255, 170, 40), (90, 220, 120), (235, 235, 235), (255, 90, 80)
WHITE = 2.0  # luminance that is shown as white, as a multiple of the target symbol's median
FONT_PX = 26  # height of a line of text in a picture of 720 rows
CLOSE = 1.4  # half the extent of the road seen from above, in symbol lengths and widths
ABOVE, BEAM = 0.44, 0.24  # height of the insets, of the picture's


def frame_picture(result: StepResult, simulation: Simulation) -> Picture:
    """A step as a picture `[H, W, 3]` in the camera's size: extracted symbol (orange) and flat-road target (green) in the on frame,
    the noise-free light from above on the left, the first lamp's utilisation on the right."""
    camera = simulation.scenario.camera
    white = WHITE * simulation.brightness
    if result.frames is None:
        picture = np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
    else:
        picture = tone_map(luminance_of(result.frames[0], camera), white)
    if simulation.judge is not None and result.frames is not None:
        _outline_target(picture, simulation.judge, result.taken_s)
    _outline_symbol(picture, result)
    margin = max(camera.height_px // 60, 1)
    if simulation.judge is not None:
        _paste(picture, _from_above(result, simulation.judge, white, round(ABOVE * camera.height_px)), margin, left=True)
    headlight = simulation.projector.modules[0].pixel_controller.headlight
    beam = result.lights[0].u.unflatten(-1, (headlight.pixel_rows, headlight.pixel_cols))
    _paste(picture, _scaled(tone_map(beam, torch.ones(())), round(BEAM * camera.height_px)), margin, left=False)
    _write(picture, _captions(result, simulation), margin)
    return picture


def tone_map(image: Tensor, white: Tensor) -> Picture:
    """A picture `[H, W, 3]` of an image `[H, W]` >= 0, grey, by the square root, which shows dark and bright alike; white saturates."""
    grey = (255 * (image / white.to(image)).clamp(0, 1).sqrt()).round().to(torch.uint8).cpu().numpy()
    return np.repeat(grey[..., None], 3, -1)


class VideoWriter:
    """Writes H.264 through a temporary name, so that a video is there whole or not at all; use it in a `with` statement.

    Pictures are cut to even sizes, which 4:2:0 chroma asks for. Leaving the block closes the file, after Ctrl-C too. A video without
    pictures is no file.
    """

    def __init__(self, path: Path, fps: float, size: tuple[int, int]) -> None:
        """size: width and height in px. Raises LuxloopError where the file cannot be written."""
        self.path = path
        self._part = part_of(path)
        with self._writing():
            self._file = self._part.open("wb")
        self._container = av.open(self._file, "w", format="mp4")
        options = {"crf": "26", "preset": "veryfast"}  # finer would spend megabytes on the camera's noise
        self._stream = self._container.add_stream("h264", Fraction(fps).limit_denominator(1000), options)
        self._stream.width, self._stream.height = (n - n % 2 for n in size)
        self._stream.pix_fmt = "yuv420p"
        self._stream.thread_count = 1  # the file does not depend on the number of cores

    def __enter__(self) -> "VideoWriter":
        return self

    def add(self, picture: Picture) -> None:
        """Append a picture `[H, W, 3]` uint8, RGB, of the video's size. Raises LuxloopError where it cannot be written."""
        even = np.ascontiguousarray(picture[: self._stream.height, : self._stream.width])
        with self._writing():
            self._container.mux(self._stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")))

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            with self._writing():
                self._container.mux(self._stream.encode(None))
                self._container.close()
                self._file.close()
                if self._part.stat().st_size:
                    os.replace(self._part, self.path)
        except LuxloopError:
            if not isinstance(error, Exception):  # else that one is raised
                raise
        finally:
            self._part.unlink(missing_ok=True)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, av.FFmpegError) as error:
            raise LuxloopError(f"{self.path}: cannot be written ({error.strerror or error}); name another file or directory") from error


def _from_above(result: StepResult, judge: Judge, white: Tensor, height: int) -> Picture:
    """The road about the target, far end on top, with the target outlined; height: px."""
    symbol, axes = judge.symbol, judge.plane.axes
    light = judge.world.lit(result.time_s).luminance(result.lights)
    rows = (axes.v + symbol.x_m).abs() <= CLOSE * symbol.length_m
    cols = (axes.u + symbol.y_m).abs() <= CLOSE * symbol.width_m
    plane = rectify(judge.plane_at(result.time_s), light)
    picture = _scaled(tone_map(plane[rows.to(light.device)][:, cols.to(light.device)], white), height)
    px_per_m = height / (float(axes.v[1] - axes.v[0]) * int(rows.sum()))
    centre = (-symbol.y_m - float(axes.u[cols][0]), -symbol.x_m - float(axes.v[rows][0]))
    half = (symbol.width_m / 2, symbol.length_m / 2)
    low, high = ([round(px_per_m * (c + sign * h)) for c, h in zip(centre, half, strict=True)] for sign in (-1, 1))
    cv2.rectangle(picture, low, high, TARGET_RGB, 1)
    return picture


def _outline_target(picture: Picture, judge: Judge, time_s: float) -> None:
    symbol, view = judge.symbol, judge.world.view_from_ground(time_s)
    x, y = symbol.length_m / 2, symbol.width_m / 2
    corners = torch.tensor([[-x, -x, x, x], [-y, y, y, -y], [0, 0, 0, 0]], dtype=torch.float64)
    corners += torch.tensor([[symbol.x_m], [symbol.y_m], [0.0]], dtype=torch.float64)
    uv, depth = view.project(corners)
    if (depth > 0).all():
        points = (16 * (uv.T.numpy() - 0.5)).round().astype(np.int32)  # OpenCV: pixel centres at integers, 4 bits of fraction
        cv2.polylines(picture, [points], True, TARGET_RGB, 1, cv2.LINE_AA, 4)


def _outline_symbol(picture: Picture, result: StepResult) -> None:
    mask = (result.seen.symbol > 0.5).to(torch.uint8).cpu().numpy()
    if mask.size:
        offset = (result.seen.crop.u_start, result.seen.crop.v_start)
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE, offset=offset)
        cv2.drawContours(picture, contours, -1, SEEN_RGB, 1)


def _scaled(picture: Picture, height: int) -> Picture:
    return cv2.resize(picture, (round(picture.shape[1] * height / picture.shape[0]), height), interpolation=cv2.INTER_AREA)


def _paste(picture: Picture, inset: Picture, margin: int, left: bool) -> None:
    """Lay a framed inset into the upper left or right corner; what is too wide is cut."""
    inset = inset[:, : picture.shape[1] - 2 * margin]
    height, width = inset.shape[:2]
    u = margin if left else picture.shape[1] - margin - width
    picture[margin : margin + height, u : u + width] = inset
    cv2.rectangle(picture, (u - 1, margin - 1), (u + width, margin + height), TEXT_RGB, 1)


def _captions(result: StepResult, simulation: Simulation) -> list[tuple[str, tuple[int, int, int]]]:
    loss, lies = loss_name(int(result.seen.code)), "not judged"
    if result.verdict is not None:
        x, y = result.verdict.centroid_percent.tolist()
        lies = f"centroid error {x:+.1f} %, {y:+.1f} %; IoU {float(result.verdict.iou):.2f}"
    return [
        (f"{simulation.scenario.name}, {simulation.scenario.controller.name}", TEXT_RGB),
        (f"step {result.step}, {result.time_s:.2f} s", TEXT_RGB),
        (lies, TEXT_RGB),
        (f"lost: {loss.replace('_', ' ')}", LOST_RGB) if loss else ("seen", SEEN_RGB),
    ]


def _write(picture: Picture, captions: list[tuple[str, tuple[int, int, int]]], margin: int) -> None:
    """Lines of text in the lower left corner."""
    line = FONT_PX * picture.shape[0] / 720
    for i, (text, colour) in enumerate(captions):
        at = (margin, round(picture.shape[0] - margin - line * (len(captions) - 1 - i)))
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, line / 38, colour, 1, cv2.LINE_AA)
