"""Cameras of a rig file: network cameras, V4L2 devices by OpenCV, streams by PyAV, a folder of pictures, or a user's own class.

A network camera gives an endless HTTP response with one JPEG or PNG per part, whose sizes and times are bounded.
"""

import base64
import os
import select
import socket
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urljoin, urlsplit
from urllib.request import AbstractDigestAuthHandler, HTTPPasswordMgrWithDefaultRealm, Request, parse_http_list, parse_keqv_list

from luxloop.loop.rig.camera import KEY, CameraPicture, CameraSource
from luxloop.loop.rig.params import Cameras, DeviceCameraParams, FolderCameraParams, HttpCameraParams, OwnCameraParams, StreamCameraParams
from luxloop.loop.rig.wire.mjpeg import LONGEST_LINE, parts
from luxloop.loop.rig.wire.sockets import reaching
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.files import content

MOST_HEAD = 16_384  # bytes of the answer's head
MOST_ANSWERS = 4  # redirects, login and pictures
MOVED = ("301", "302", "303", "307", "308")
CHUNK = 65_536
EXAMPLE = "write it as http://192.168.1.21:8080/camera"
SLOW_S = 2.0  # time-out of a whole head or picture, or camera.timeout_s if longer
NO_PICTURES = ("audio/", "text/")


class HttpCamera:
    """A connection to a network camera."""

    def __init__(self, params: HttpCameraParams) -> None:
        """Connect. Raises LuxloopError if the address is invalid, or the server does not send pictures."""
        self._url, self._whole_s = params.url, max(SLOW_S, params.timeout_s)
        url, login = params.url, ""
        for _ in range(MOST_ANSWERS):
            self._stream = _Stream(self._connection(url), self._whole_s)
            try:
                status, answer = self._ask(url, login)
                if status in MOVED and "location" in answer:
                    url = urljoin(url, answer["location"])
                elif status == "401" and not login and _host(url) == _host(params.url) and urlsplit(params.url).username:
                    login = _login(params.url, url, answer.get("www-authenticate", ""))
                else:
                    self._refuse_others(status, answer)
                    break
            except TimeoutError as error:
                self.close()
                raise LuxloopError(
                    f"camera.url: {self._url} does not answer within {self._whole_s:g} s; check it, and the network"
                ) from error
            except BaseException:
                self.close()
                raise
            self.close()
        else:
            raise LuxloopError(f"camera.url: {self._url} leads from one address to another; give the one that sends pictures")
        self._parts = parts(self._stream, params.largest_bytes)

    def read(self, timeout_s: float) -> CameraPicture | None:
        """The next picture, None if none arrives within timeout_s.

        Raises OSError if a picture does not come whole in time, LuxloopError if the response ends or is invalid.
        """
        if not self._stream.await_part(timeout_s):
            return None
        arrived_s, awaited = self._stream.arrived_s, self._stream.awaited
        part = next(self._parts, None)
        if part is None:
            raise LuxloopError("camera: has ended the stream")
        if not part.body or part.kind.startswith(NO_PICTURES):
            return None
        if self._stream.boundary and self._stream.boundary in part.body:
            raise LuxloopError('camera: its Content-Length is longer than its pictures; give kind = "stream", which needs none')
        return CameraPicture(arrived_s, awaited, part.body)

    def close(self) -> None:
        self._stream.socket.close()

    def _connection(self, address: str) -> socket.socket:
        try:
            url = urlsplit(address)
            host, port = url.hostname, url.port or 80
        except ValueError as error:
            raise LuxloopError(f"camera.url: {address} is no address; {EXAMPLE}, and #, / and @ in a login as %23, %2F and %40") from error
        if url.scheme != "http":
            raise LuxloopError(f'camera.url: {self._url} leads to {url.scheme}://, which kind = "http" cannot read; give kind = "stream"')
        if not host:
            raise LuxloopError(f"camera.url: {address} names no host; {EXAMPLE}")
        with reaching("camera.url", address):
            return socket.create_connection((host, port), SLOW_S)

    def _ask(self, address: str, login: str) -> tuple[str, Mapping[str, str]]:
        """Status and head of the server's answer, names in lower case."""
        url = urlsplit(address)
        lines = [f"GET {url.path or '/'}{f'?{url.query}' if url.query else ''} HTTP/1.0", f"Host: {url.hostname}"]
        lines += ["Accept: multipart/x-mixed-replace, image/*", *([f"Authorization: {login}"] if login else [])]
        self._stream.socket.sendall("\r\n".join([*lines, "", ""]).encode())
        first = self._stream.readline(MOST_HEAD).decode("latin-1").split(None, 2)
        head, left = dict[str, str](), MOST_HEAD
        if len(first) < 2 or not first[0].startswith("HTTP/"):
            return "no HTTP", head
        while (line := self._stream.readline(left)).strip():
            left -= len(line)
            if left <= 0:
                raise LuxloopError("camera: the head of its answer does not end; check the address")
            name, _, value = line.decode("latin-1").partition(":")
            head[name.lower()] = value.strip()
        return first[1], head

    def _refuse_others(self, status: str, head: Mapping[str, str]) -> None:
        if status != "200":
            raise LuxloopError(f"camera.url: {self._url} answers with {status}, not with pictures; check the path, and the login")
        if "chunked" in head.get("transfer-encoding", "").lower():
            raise LuxloopError(f'camera.url: {self._url} answers in chunks, which kind = "http" cannot read; give kind = "stream"')
        kind = head.get("content-type", "").lower()
        if not kind.startswith("multipart/"):
            said = kind or "no type"
            raise LuxloopError(f"camera.url: {self._url} answers with {said}, not with multipart pictures; give the MJPEG stream's path")


def _host(address: str) -> tuple[str | None, int | None]:
    url = urlsplit(address)
    return url.hostname, url.port


def _login(camera_url: str, address: str, challenge: str) -> str:
    """Authorization header for a basic or digest challenge, with the user in the address."""
    user, password = (unquote(each or "") for each in (urlsplit(camera_url).username, urlsplit(camera_url).password))
    kind, _, values = challenge.partition(" ")
    if kind.lower() != "digest":
        return f"Basic {base64.b64encode(f'{user}:{password}'.encode()).decode()}"
    url = urlsplit(address)
    plain = url._replace(netloc=url.netloc.rpartition("@")[2]).geturl()
    passwords = HTTPPasswordMgrWithDefaultRealm()
    passwords.add_password(None, plain, user, password)
    try:
        answer = AbstractDigestAuthHandler(passwords).get_authorization(Request(plain), parse_keqv_list(parse_http_list(values)))
    except ValueError as error:
        raise LuxloopError(f"camera.url: its login cannot be answered ({error}); set the camera to basic or MD5 digest") from error
    return f"Digest {answer}"


class _Stream:
    """A buffered socket that notes the arrival time of a part's first byte.

    boundary: the line between two parts, empty before the first.
    """

    def __init__(self, sock: socket.socket, whole_s: float) -> None:
        """whole_s: time-out of a whole head or part."""
        self.socket, self._buffer, self._whole_s = sock, bytearray(), whole_s
        self._until_s = time.monotonic() + whole_s
        self.arrived_s, self.awaited, self.boundary = 0.0, False, b""

    def await_part(self, timeout_s: float) -> bool:
        """Wait for the first byte of the next part; returns whether it has arrived."""
        self._strip()
        self.awaited = False
        until_s = time.monotonic() + timeout_s
        while not self._buffer:
            if not self._ready(0):
                self.awaited = True
                if not self._ready(max(until_s - time.monotonic(), 0)):
                    return False
            self._arrive()
            self._fill()
            self._strip()
        if not self.awaited:
            self._arrive()
        return True

    def _arrive(self) -> None:
        self.arrived_s = time.monotonic()
        self._until_s = self.arrived_s + self._whole_s

    def readline(self, limit: int = MOST_HEAD) -> bytes:
        while (end := self._buffer.find(b"\n", 0, limit)) < 0 and len(self._buffer) < limit:
            self._fill()
        return self._consume(limit if end < 0 else end + 1)

    def read(self, size: int) -> bytes:
        while len(self._buffer) < size:
            self._fill()
        return self._consume(size)

    def _strip(self) -> None:
        """Drop bytes between two parts: line ends, the boundary, which many cameras send at once, and a preamble before the first part."""
        while size := 1 if self._buffer[:1] in (b"\r", b"\n") else self._boundary():
            del self._buffer[:size]

    def _boundary(self) -> int:
        """Length of the next boundary, or of a line before the first; 0 if there is none, the last boundary or an incomplete one."""
        size = self._buffer.find(b"\n", 0, LONGEST_LINE) + 1
        line = bytes(self._buffer[:size].rstrip())
        if line.startswith(b"--") and not line.endswith(b"--"):
            self.boundary = line
            return size
        return 0 if self.boundary else size

    def _ready(self, timeout_s: float) -> bool:
        return bool(select.select([self.socket], [], [], timeout_s)[0])

    def _fill(self) -> None:
        self.socket.settimeout(max(self._until_s - time.monotonic(), 1e-3))
        if not (came := self.socket.recv(CHUNK)):
            raise LuxloopError("camera: has closed the connection")
        self._buffer += came

    def _consume(self, size: int) -> bytes:
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken


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
