"""The camera: it integrates the light during each row's exposure, and sends frames."""

import math
import queue
import random
import struct
import threading
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from luxloop.loop.rig.arrays import Array, Image
from luxloop.loop.rig.simulated.board import BoardView
from luxloop.loop.rig.simulated.faults import CameraErrorParams, FaultParams, FlickerParams
from luxloop.loop.rig.simulated.lamp import Segment, Timeline
from luxloop.loop.rig.simulated.scene import RigScene
from luxloop.loop.rig.wire.mjpeg import JPEG, PNG, Part
from luxloop.perception.camera import CameraParams, expose
from luxloop.perception.noise import FrameNoise
from luxloop.world.errors import LuxloopError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GREY = 0  # colour type


def png(image: Image) -> bytes:
    """PNG of a picture `[height, width]` of 8 or 16 bits, uncompressed."""
    height, width = image.shape
    rows = np.zeros((height, 1 + width * image.itemsize), np.uint8)  # a row begins with its filter, 0 for none
    rows[:, 1:] = image.astype(image.dtype.newbyteorder(">"), copy=False).view(np.uint8)
    head = struct.pack(">IIBBBBB", width, height, 8 * image.itemsize, GREY, 0, 0, 0)
    return SIGNATURE + _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(rows.data, 0)) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return b"".join((struct.pack(">I", len(data)), kind, data, struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))))


WAIT_S = 0.1  # interval of checks for the end
UNSENT = 128  # most frames waiting to be sent


@dataclass(frozen=True)
class FrameTruth:
    """Truth of a frame; times of `time.monotonic()` in s.

    timecodes: of all light in the frame in the order of its appearance, None for dark. crc32: of the bytes as sent.
    """

    index: int
    exposed_from_s: float
    exposed_to_s: float
    timecodes: tuple[int | None, ...]
    crc32: int
    sent_s: float = math.nan


class RigCamera:
    """Camera that exposes frames of a scene in the caller's thread, and sends them in a thread of its own."""

    def __init__(self, rig_scene: RigScene, timeline: Timeline, faults: FaultParams, send: Callable[[Part, FrameTruth], None]) -> None:
        """send: called with each frame when it leaves the camera. Raises LuxloopError if the encoding has too few bits."""
        self.rig_scene, self.timeline, self.faults = rig_scene, timeline, faults
        gamma = faults.camera.gamma  # the true one
        self.sensor = rig_scene.camera if gamma is None else rig_scene.camera.model_copy(update={"gamma": gamma})
        if faults.camera.encoding == "jpeg" and self.sensor.bits > 8:
            raise LuxloopError(f"camera.encoding: JPEG has 8 bits and the camera {self.sensor.bits}; set camera.bits=8 in the scenario")
        self.board = BoardView.of(faults.board, rig_scene) if faults.board.shown else None
        self.exposures = self.skipped = self.lost = 0
        self.ended = False  # set by signal handlers, which must not wait for a lock
        self._random, self._send, self._open = random.Random(faults.seed + 1), send, True
        self._unsent: queue.Queue[tuple[float, Part, FrameTruth] | None] = queue.Queue(UNSENT)
        self._sender = threading.Thread(target=self._send_due, name="camera", daemon=True)
        self._sender.start()

    @property
    def window_s(self) -> float:
        """Time from the start of the first row's exposure to the end of the last row's."""
        return self.faults.camera.readout_s + self.sensor.exposure_s

    def run(self) -> None:
        """Expose frame after frame until `ended`."""
        params, next_s = self.faults.camera, time.monotonic()
        while not self.ended:
            if params.trigger == "light":
                late_s = time.monotonic() - 1 / params.rate_hz  # older light triggers nothing
                lit_s = self.timeline.newer(max(next_s, late_s), WAIT_S)
                if lit_s is None:
                    continue
                from_s = lit_s + params.trigger_delay_s
                next_s = from_s + self.window_s  # triggers during an exposure are ignored
            else:
                period_s = max(1 / params.rate_hz, self.window_s)
                behind = max(math.floor((time.monotonic() - next_s) / period_s), 0)
                self.skipped += behind
                from_s = next_s + behind * period_s
                next_s = from_s + period_s
            while not self.ended and (left_s := from_s + self.window_s - time.monotonic()) > 0:
                time.sleep(min(left_s, WAIT_S))
            self._queue(self.expose(from_s))

    def expose(self, from_s: float) -> tuple[Part, FrameTruth]:
        """Frame whose first row's exposure starts at a time; all exposures must be over."""
        segments, number = self.timeline.between(from_s, from_s + self.window_s), self.exposures
        self.exposures += 1
        begun_s = self.timeline.begun_s
        drive_s = 0.0 if begun_s is None else max(from_s + self.window_s / 2 - begun_s, 0.0)
        starts_s = from_s + self.faults.camera.readout_s * (np.arange(self.rig_scene.lens.height) / self.rig_scene.lens.height)
        shown = None if self.board is None or any(each.light for each in segments) else self.board.at(from_s, self.timeline.heard_s)
        luminance = self.luminance(segments, starts_s, drive_s) if shown is None else shown
        codes = read_out(luminance, self.sensor, self.faults, number)
        part = encode(codes, self.sensor.bits, self.faults.camera)
        lit = dict.fromkeys(code for each in segments for code in ((None,) if each.light is None else each.light.timecodes))
        return part, FrameTruth(number, from_s, from_s + self.window_s, tuple(lit), zlib.crc32(part.body))

    def luminance(self, segments: Sequence[Segment], starts_s: Array, drive_s: float) -> Image:
        """Mean image over each row's exposure, `[height, width]` in cd/m^2.

        starts_s: `[height]`, start of each row's exposure.
        """
        exposure_s = self.sensor.exposure_s
        lights = [(each.light, share) for each in segments if each.light and (share := shares(each, starts_s, exposure_s)).any()]
        mixed = self.rig_scene.base(drive_s) * flicker(self.faults.flicker, starts_s, exposure_s)[:, None]
        for light, share in lights:
            mixed += self.rig_scene.light(light, drive_s) * share[:, None]
        return mixed

    def close(self) -> None:
        """Stop; frames waiting to be sent are dropped."""
        self._open = False
        self._unsent.put(None)
        self._sender.join()

    def _queue(self, frame: tuple[Part, FrameTruth]) -> None:
        params, (part, exposed) = self.faults.camera, frame
        if params.loss and self._random.random() < params.loss:
            self.lost += 1
            return
        jitter_s = params.jitter_s * self._random.random() if params.jitter_s else 0.0
        self._unsent.put((exposed.exposed_to_s + params.latency_s + jitter_s, part, exposed))

    def _send_due(self) -> None:
        while (due := self._unsent.get()) is not None:
            due_s, part, exposed = due
            while self._open and (left_s := due_s - time.monotonic()) > 0:
                time.sleep(min(left_s, WAIT_S))
            if self._open:
                self._send(part, replace(exposed, sent_s=time.monotonic()))


def shares(segment: Segment, starts_s: Array, exposure_s: float) -> Image:
    """Share `[height]` of each row's exposure during which a segment is lit."""
    overlap_s = np.minimum(segment.to_s, starts_s + exposure_s) - np.maximum(segment.from_s, starts_s)
    return (overlap_s.clip(0) / exposure_s).astype(np.float32)


def flicker(params: FlickerParams, starts_s: Array, exposure_s: float) -> Image:
    """Mean ambient light `[height]` during each row's exposure relative to its mean over time."""
    if not params.depth:
        return np.ones(len(starts_s), np.float32)
    angle = 2 * math.pi * params.rate_hz
    wave = (np.sin(angle * (starts_s + exposure_s)) - np.sin(angle * starts_s)) / (angle * exposure_s)
    return (1 + params.depth * wave).astype(np.float32)


def read_out(luminance: Image, sensor: CameraParams, faults: FaultParams, number: int) -> Image:
    """Digital numbers `[height, width]` of a frame with noise, response and black level."""
    dn = expose(torch.from_numpy(luminance), sensor, FrameNoise.of(faults.seed, number, 0) if sensor.noise else None, quantise=False)
    if black := faults.camera.black_level:
        dn.mul_(1 - black).add_(black * (2**sensor.bits - 1))
    return dn.round_().numpy().astype(np.uint16)


def encode(codes: Image, bits: int, params: CameraErrorParams) -> Part:
    """Encoded frame: uncompressed PNG of 8 or 16 bits, or JPEG."""
    image = codes.astype(np.uint8) if bits == 8 else codes
    if params.encoding == "jpeg":
        return Part(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, params.quality])[1].tobytes(), JPEG)
    return Part(png(image), PNG)
