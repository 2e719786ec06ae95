"""Cameras of a rig file: V4L2 devices by OpenCV, streams by PyAV, a folder of another program's pictures, or a user's own class."""

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from luxloop.loop.rig.camera import KEY, CameraPicture, CameraSource
from luxloop.loop.rig.http_camera import HttpCamera
from luxloop.loop.rig.params import Cameras, DeviceCameraParams, FolderCameraParams, HttpCameraParams, OwnCameraParams, StreamCameraParams
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.files import content

METHODS = ("read", "close")
WAITED_S = 0.001  # a faster read found its picture in a buffer
RATE_SHARE = 0.02  # accepted relative difference of a driver's rate: 29.97 Hz are requested as 30
LOCKED = 1  # V4L2's code of manual exposure
POLL_S = 0.005
ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
LOST_S = 5.0  # time-out of a stream's server


class DeviceCamera:
    """A webcam. A driver that hangs blocks only the camera's thread."""

    def __init__(self, params: DeviceCameraParams) -> None:
        """Open the device. Raises LuxloopError if it does not exist, or does not accept the requested settings."""
        import cv2

        if not Path(params.device).exists():
            raise LuxloopError(f"camera.device: there is no {params.device}; `ls /dev/video*` lists those there are")
        self._capture = cv2.VideoCapture(params.device, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise LuxloopError(
                f"camera.device: {params.device} cannot be opened; another program may hold it, or you are not in group video"
            )
        wanted = {
            "width_px": (cv2.CAP_PROP_FRAME_WIDTH, params.width_px),
            "height_px": (cv2.CAP_PROP_FRAME_HEIGHT, params.height_px),
            "rate_hz": (cv2.CAP_PROP_FPS, params.rate_hz),
        }
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        code = None if params.fourcc is None else cv2.VideoWriter.fourcc(*params.fourcc)
        if code is not None:
            self._capture.set(cv2.CAP_PROP_FOURCC, code)
        for key, value in wanted.values():  # before any is read: V4L2 sets width and height together
            self._capture.set(key, value)
        for name, (key, value) in wanted.items():
            got = self._capture.get(key)
            if abs(got - value) > (RATE_SHARE * value if name == "rate_hz" else 0):
                self._refuse(name, f"{params.device} gives {got:g} where {value:g} is asked for; `v4l2-ctl --list-formats-ext`")
        if code is not None and self._capture.get(cv2.CAP_PROP_FOURCC) != code:
            self._refuse("fourcc", f"{params.device} does not give {params.fourcc} of this size; `v4l2-ctl --list-formats-ext`")
        if params.exposure is not None:
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, LOCKED)
        for name, key, given in (
            ("exposure", cv2.CAP_PROP_EXPOSURE, params.exposure),
            ("gain", cv2.CAP_PROP_GAIN, params.gain),
        ):
            if given is not None and not self._capture.set(key, given):
                self._refuse(name, f"{params.device} has no such control; leave it out, `v4l2-ctl --list-ctrls` shows those there are")
        self._capture.set(cv2.CAP_PROP_AUTO_WB, 0)

    def _refuse(self, key: str, reason: str) -> None:
        self._capture.release()
        raise LuxloopError(f"camera.{key}: {reason}")

    def read(self, timeout_s: float) -> CameraPicture | None:
        """The next picture, None if it is damaged. Raises LuxloopError if the device gives none."""
        asked_s = time.monotonic()
        if not self._capture.grab():
            raise LuxloopError("camera: the device gives no picture; check its cable")
        arrived_s = time.monotonic()
        done, picture = self._capture.retrieve()
        return CameraPicture(arrived_s, arrived_s - asked_s > WAITED_S, picture) if done else None

    def close(self) -> None:
        self._capture.release()


class StreamCamera:
    """A video stream, decoded frame by frame."""

    def __init__(self, params: StreamCameraParams) -> None:
        """Connect. Raises an OSError of PyAV if no server answers in time, LuxloopError if the stream has no video."""
        import av

        self._container: Any = av.open(params.url, options=dict(params.options), timeout=(LOST_S, LOST_S))
        if not self._container.streams.video:
            self._container.close()
            raise LuxloopError(f"camera.url: {params.url} has no video")
        stream = self._container.streams.video[0]
        stream.thread_type = "SLICE"  # threads per frame would delay frames
        stream.codec_context.flags |= av.codec.context.Flags.low_delay
        stream.codec_context.options = {"err_detect": "explode"}  # damaged pictures are errors
        self._packets, self._damaged = self._container.demux(stream), av.InvalidDataError

    def read(self, timeout_s: float) -> CameraPicture | None:
        """The newest picture of the next packet, None if the packet has none or a damaged one. Raises LuxloopError if the stream ends."""
        asked_s = time.monotonic()
        packet = next(self._packets, None)
        if packet is None or packet.dts is None:
            raise LuxloopError("camera: has ended the stream")
        arrived_s = time.monotonic()
        try:
            frames = packet.decode()
        except self._damaged:
            return None
        if not frames:
            return None
        deep = "16" in frames[-1].format.name or "12" in frames[-1].format.name or "10" in frames[-1].format.name
        picture = frames[-1].to_ndarray(format="gray16le" if deep else "gray")
        return CameraPicture(arrived_s, arrived_s - asked_s > WAITED_S, picture)

    def close(self) -> None:
        self._container.close()


class FolderCamera:
    """Picture files of a folder in ascending order of their names, from the first one added after the start."""

    def __init__(self, params: FolderCameraParams) -> None:
        """Note the newest file. Raises LuxloopError if the folder does not exist."""
        self._folder = params.folder
        if not self._folder.is_dir():
            raise LuxloopError(f"camera.folder: there is no folder {self._folder}; make it, or correct the path")
        self._last = max(self._names(), default="")

    def read(self, timeout_s: float) -> CameraPicture | None:
        """The newest picture, None if none arrives within timeout_s. Raises LuxloopError if a file cannot be read."""
        until_s, waited = time.monotonic() + timeout_s, False
        while not (fresh := sorted(name for name in self._names() if name > self._last)):
            if time.monotonic() > until_s:
                return None
            waited = True
            time.sleep(POLL_S)
        self._last = fresh[-1]
        arrived_s = time.monotonic()
        return CameraPicture(arrived_s, waited and len(fresh) == 1, content(self._folder / fresh[-1]))

    def close(self) -> None:
        return None

    def _names(self) -> list[str]:
        return [name for name in os.listdir(self._folder) if name.lower().endswith(ENDINGS) and not name.startswith(".")]


KINDS: dict[type, Any] = {
    HttpCameraParams: HttpCamera,
    DeviceCameraParams: DeviceCamera,
    StreamCameraParams: StreamCamera,
    FolderCameraParams: FolderCamera,
}


def opener(params: Cameras) -> Callable[[], CameraSource]:
    """Function that connects to the camera of a rig file; it raises LuxloopError or OSError if it cannot connect.

    Raises LuxloopError if a user's own camera class cannot be loaded.
    """
    if (kind := KINDS.get(type(params))) is not None:
        return partial(kind, params)
    assert isinstance(params, OwnCameraParams)
    methods = (*METHODS, "trigger") if params.triggered else METHODS
    plugin.load(params.kind, KEY, methods)
    return partial(plugin.make, params.kind, KEY, {}, params.options, methods)
