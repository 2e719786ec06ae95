"""Pictures arrive as they were sent, by our reader and by OpenCV; a slow or hostile peer does no harm."""

import io
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.wire.mjpeg import JPEG, PNG, Part, PictureServer, parts
from tests.refusal import refusal

DEEP = np.random.default_rng(0).integers(0, 4096, (48, 64), np.uint16)


@pytest.fixture
def server() -> Iterator[PictureServer]:
    server = PictureServer("127.0.0.1", 0)
    yield server
    server.close()


def watched(server: PictureServer, path: str = "/camera"):
    answer = urllib.request.urlopen(f"http://127.0.0.1:{server.port}{path}", timeout=5)
    deadline = time.monotonic() + 5
    while not server.clients and time.monotonic() < deadline:
        time.sleep(0.001)
    return answer


def test_pictures_come_as_they_were_sent(server):
    deep = cv2.imencode(".png", DEEP)[1].tobytes()
    plain = cv2.imencode(".jpg", (DEEP >> 4).astype(np.uint8))[1].tobytes()
    with watched(server) as answer:
        assert answer.headers["Content-Type"] == "multipart/x-mixed-replace; boundary=frame"
        came = parts(answer, 2**20)
        for sent in (Part(deep, PNG), Part(plain, JPEG)):
            server.publish(sent)
            got = next(came)
            assert (got.body, got.kind) == (sent.body, sent.kind)
        assert (cv2.imdecode(np.frombuffer(deep, np.uint8), cv2.IMREAD_UNCHANGED) == DEEP).all()
        server.close()
        assert list(came) == []


def test_a_slow_client_holds_nobody_up(server):
    with socket.create_connection(("127.0.0.1", server.port)) as slow, watched(server) as fast:
        slow.sendall(b"GET /camera HTTP/1.0\r\n\r\n")
        came, large = parts(fast, 2**22), bytes(2**21)
        for k in range(10):
            server.publish(Part(bytes([k]) + large, JPEG))
            assert next(came).body[0] == k


def test_no_more_clients_than_a_camera_serves(server):
    answers = [watched(server) for _ in range(8)]
    with pytest.raises(urllib.error.HTTPError, match="503"):
        watched(server)
    for answer in answers:
        answer.close()
    with pytest.raises(urllib.error.HTTPError, match="404"):
        watched(server, "/else")


@pytest.mark.parametrize(
    "answer",
    [b"<html>\r\n" * 50, b"--frame\r\nContent-Type: image/png\r\n\r\n", b"--frame\r\nContent-Length: 99999999999\r\n\r\n", b"a" * 10**6],
)
def test_what_is_no_stream_of_pictures_is_refused(answer):
    with refusal(r"MJPEG stream|99999999999 bytes"):
        list(parts(io.BytesIO(answer), 10**6))
