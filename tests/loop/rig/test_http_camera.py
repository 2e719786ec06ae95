"""Pictures of a network camera: what cameras send, logins and redirects, and servers that are none."""

import hashlib
import re
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from urllib.request import parse_http_list, parse_keqv_list

import pytest

from luxloop.loop.rig.camera import Camera
from luxloop.loop.rig.cameras import HttpCamera
from luxloop.loop.rig.params import HttpCameraParams
from tests.loop.rig.conftest import eventually
from tests.refusal import refusal

HEAD = b"HTTP/1.0 200 OK\r\nServer stupid\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"
PART = b"Content-Type: image/jpeg\r\nContent-Length: %s3\r\n\r\nabc\r\n--frame\r\n"
MOVED = b"HTTP/1.0 302 Found\r\nLocation: http://127.0.0.1:%(port)s/there?x=1\r\n\r\n"
CHALLENGE = b'HTTP/1.0 401 No\r\nWWW-Authenticate: Digest realm="cam", nonce="n1", qop="auth", algorithm=MD5\r\n\r\n'


def answering(*answers: bytes, then: Callable[[socket.socket], None] = lambda connection: time.sleep(20)) -> tuple[str, list[bytes]]:
    """Host and port of a server that closes each connection after one of some answers, the last one excepted, and what it was asked."""
    server, requests = socket.create_server(("127.0.0.1", 0)), list[bytes]()
    host = f"127.0.0.1:{server.getsockname()[1]}"

    def serve() -> None:
        for k, answer in enumerate(answers):
            connection, _ = server.accept()
            requests.append(connection.recv(4096))
            connection.sendall(answer.replace(b"127.0.0.1:%(port)s", host.encode()))
            if k < len(answers) - 1:
                connection.close()
        with suppress(OSError):
            then(connection)

    threading.Thread(target=serve, daemon=True).start()
    return host, requests


def camera_of(host: str, login: str = "") -> HttpCamera:
    return HttpCamera(HttpCameraParams(kind="http", url=f"http://{login}{host}/camera", timeout_s=0.3))


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"HTTP/1.0 404 Not Found\r\n\r\n", "answers with 404"),
        (b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n", "not with multipart pictures"),
        (b"SSH-2.0-OpenSSH\r\n", "no HTTP"),
        (HEAD[:-2] + b"Transfer-Encoding: chunked\r\n\r\n", "answers in chunks"),
        (4 * (MOVED,), "from one address to another"),
    ],
)
def test_a_server_that_is_no_camera_is_told(answer, words):
    host, _ = answering(*(answer if isinstance(answer, tuple) else (answer,)))
    with refusal(words):
        camera_of(host)


def test_a_camera_that_sends_nothing_is_not_alive():
    host, _ = answering(HEAD)
    camera = Camera(lambda: camera_of(host), 0.3)
    try:
        assert eventually(lambda: "no picture for 0.3 s" in camera.reason, 5) and not camera.alive
    finally:
        camera.close()


@pytest.mark.parametrize(
    "body",
    [
        b"--frame\r\n" + PART % b"000000000",
        b"This is a stream for old readers.\r\n\r\n--frame\r\n" + PART % (10 * b" "),
        b"--frame\r\nContent-Type: audio/basic\r\nContent-Length: 2\r\n\r\nxy\r\n--frame\r\n" + PART % b"",
        b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: 0\r\n\r\n\r\n--frame\r\n" + PART % b"",
    ],
    ids=["zeros", "preamble and blanks", "audio", "empty"],
)
def test_pictures_are_found_among_what_cameras_send(body):
    source = camera_of(answering(HEAD + body)[0])
    assert [picture.data for _ in range(3) if (picture := source.read(0.2))] == [b"abc"]
    source.close()


def test_a_camera_asks_for_a_login_and_leads_elsewhere():
    host, requests = answering(MOVED, CHALLENGE, HEAD)
    camera_of(host, "me:s%20cret@").close()
    assert requests[1].startswith(b"GET /there?x=1 ") and b"Authorization" not in requests[1]
    given = parse_keqv_list(parse_http_list(re.search(r"Authorization: Digest (.*)\r", requests[2].decode())[1]))  # type: ignore[index]

    def md5(text: str) -> str:
        return hashlib.md5(text.encode()).hexdigest()

    middle = f"n1:{given['nc']}:{given['cnonce']}:auth"  # RFC 2617
    assert given["response"] == md5(f"{md5('me:cam:s cret')}:{middle}:{md5('GET:/there?x=1')}")
    host, requests = answering(b'HTTP/1.0 401 No\r\nWWW-Authenticate: Basic realm="cam"\r\n\r\n', HEAD)
    camera_of(host, "me:pw@").close()
    assert b"Authorization: Basic bWU6cHc=" in requests[1]


def test_a_camera_that_is_silent_or_drips_is_given_up(monkeypatch):
    monkeypatch.setattr("luxloop.loop.rig.cameras.SLOW_S", 0.5)
    with refusal(r"does not answer within 0\.5 s"):
        camera_of(answering(b"")[0])

    def drip(connection: socket.socket) -> None:
        for _ in range(100):
            time.sleep(0.05)
            connection.sendall(b"x")

    source = camera_of(answering(HEAD + b"--frame\r\nContent-Length: 1000\r\n\r\n", then=drip)[0])
    with pytest.raises(TimeoutError):
        source.read(1.0)
    source.close()


def test_pictures_from_a_queue_are_told_from_those_that_were_awaited():
    """Also where the boundary of the next picture follows at once, as many cameras send it."""
    sent_s = list[float]()

    def send(connection: socket.socket) -> None:
        time.sleep(0.4)
        for _ in range(2):
            sent_s.append(time.monotonic())
            connection.sendall(PART % b"")
            time.sleep(0.1)
        time.sleep(20)

    source = camera_of(answering(HEAD + b"--frame\r\n" + 2 * (PART % b""), then=send)[0])
    time.sleep(0.2)
    pictures = [source.read(1.0) for _ in range(4)]
    assert [each and (each.data, each.awaited) for each in pictures] == [(b"abc", False)] * 2 + [(b"abc", True)] * 2
    assert all(each and 0 <= each.arrived_s - at_s < 0.05 for each, at_s in zip(pictures[2:], sent_s, strict=True))
    assert source.read(0.05) is None
    source.close()
