"""Parts of a rig one by one: its file, order of pixels, limits, frames that count, mark, pictures as they come, files of light."""

import hashlib
import io
import json
import re
import socket
import threading
import time
import zipfile
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from urllib.request import parse_http_list, parse_keqv_list

import cv2
import numpy as np
import pytest
import torch

from luxloop.loop.rig import http_camera, mark
from luxloop.loop.rig.camera import Camera, CameraPicture, opener
from luxloop.loop.rig.ego import UdpEgo
from luxloop.loop.rig.files import FilesLight
from luxloop.loop.rig.http_camera import HttpCamera
from luxloop.loop.rig.light import Shine, open_light, places
from luxloop.loop.rig.limits import limited
from luxloop.loop.rig.matching import Regularity, shows
from luxloop.loop.rig.params import (
    FilesLightParams,
    HttpCameraParams,
    LimitParams,
    MarkParams,
    RigParams,
    ScanParams,
    StreamCameraParams,
    TimingParams,
    UdpEgoParams,
    load_rig,
)
from luxloop.loop.rig.rectified import Rectifier, WrongPicture, grey
from luxloop.loop.rig.video_camera import StreamCamera
from luxloop.loop.rig.wire.datagrams import encoded
from luxloop.perception.camera import CameraParams
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import ModuleCommand
from luxloop.world.validation import validate_model
from tests.loop.rig.conftest import eventually, free_port

WHOLE = """
[light]
kind = "ddp"
host = "192.168.1.20"

[camera]
kind = "http"
url = "http://192.168.1.21:8080/camera"
"""


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    file = tmp_path / "rig.toml"
    file.write_text(WHOLE)
    return file


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('kind = "ddp"', 'kind = "dpp"', "light.kind: there is no 'dpp'; did you mean 'ddp'?"),
        ('host = "192.168.1.20"', "", "light.host: is missing; write host ="),
        ("http://192", "https://192", "camera.url:"),
        ("[camera]", "[limits]\npower_w = 20.0\n[camera]", "power_w needs full_w"),
        ("[camera]", "[timing]\nlatency_s = 2.0\n[camera]", "no frame would ever count"),
        ("[camera]", "[light.scan]\nserpentin = true\n[camera]", "light.scan.serpentin: unknown key; did you mean 'serpentine'?"),
        ('host = "192.168.1.20"', 'host = "a"\nkeep_alive_s = 0.09', "the lamp would flicker"),
        ('kind = "ddp"\nhost = "192.168.1.20"', 'kind = "mine:Lamp"', "give --allow-code"),
    ],
)
def test_a_wrong_rig_file_is_a_sentence(rig_file: Path, old: str, new: str, words: str) -> None:
    rig_file.write_text(WHOLE.replace(old, new))
    with pytest.raises(LuxloopError) as caught:
        load_rig(rig_file)
    assert str(rig_file) in str(caught.value) and words in str(caught.value)


def test_files_and_modules_of_a_rig_file_lie_beside_it(rig_file: Path) -> None:
    (rig_file.parent / "mine.py").write_text("class Lamp:\n    pass\n")
    text = WHOLE.replace('kind = "ddp"\nhost = "192.168.1.20"', 'kind = "mine:Lamp"') + '[calibration]\nfile = "rig.npz"\n'
    rig_file.write_text(text)
    rig = load_rig(rig_file, allow_code=True)
    assert rig.calibration is not None and rig.calibration.file == rig_file.parent / "rig.npz"
    with pytest.raises(LuxloopError, match=r"light.kind: .*mine:Lamp: has no method show"):
        open_light(rig.light, ((2, 2),))


def test_pixels_go_out_in_the_order_of_the_device() -> None:
    # rows of the picture: 0 1 2 / 3 4 5
    assert places(ScanParams(), 2, 3).tolist() == [0, 1, 2, 3, 4, 5]
    assert places(ScanParams(columns_first=True), 2, 3).tolist() == [0, 3, 1, 4, 2, 5]
    assert places(ScanParams(from_bottom=True, from_right=True), 2, 3).tolist() == [5, 4, 3, 2, 1, 0]
    assert places(ScanParams(serpentine=True), 2, 3).tolist() == [0, 1, 2, 5, 4, 3]


def test_power_in_watts_dims_and_module_intensity_counts() -> None:
    shine = Shine(0, (np.ones((2, 4), np.float32), np.ones((2, 4), np.float32)), (ModuleCommand(), ModuleCommand(intensity=0.5)))
    assert shine.share == 0.75
    given = limited(shine, None, 1.0, LimitParams(power_w=30.0, full_w=80.0))
    assert given.dimmed == pytest.approx(0.5) and given.shine.share == pytest.approx(0.375)


def test_a_fast_change_is_made_in_part_and_arrives() -> None:
    limits, stands = LimitParams(change_per_s=1.0), None
    shares = []
    for number in range(5):
        given = limited(Shine(number, (np.full((4, 4), 0.9, np.float32),)), stands, 0.25, limits)
        stands = given.shine.dimmed
        shares.append(given.shine.share)
    assert shares == pytest.approx([0.25, 0.5, 0.75, 0.9, 0.9])


def test_a_frame_counts_when_all_earlier_light_must_be_gone() -> None:
    timing = TimingParams(latency_s=0.05, jitter_s=0.02, rolling_s=0.03)
    assert [shows(lag_s, timing) for lag_s in (-0.1, 0.0199, 0.021, 0.0699, 0.0701)] == ["old", "old", "mixed", "mixed", "clear"]
    # The rhythm by which a picture is 0.1 s late may itself be late by half of the jitter.
    assert [shows(lag_s, timing, 0.1) for lag_s in (0.0199, 0.1599, 0.1601)] == ["old", "mixed", "clear"]


def test_a_picture_that_is_stuck_is_late_and_so_are_those_behind_it() -> None:
    regularity = Regularity()
    drawn = np.random.default_rng(0)
    late = [regularity.late(k / 30 + 0.01 * drawn.random()) for k in range(200)]
    assert max(late[8:]) < 0.015 and late[7] == float("inf")  # the jitter, and a little
    stuck = [regularity.late(max(k / 30, 201 / 30 + 0.1)) for k in range(200, 206)]  # 200 to 204 come together
    assert stuck[0] == pytest.approx(0.1 + 1 / 30, abs=0.02)
    assert stuck[1] == pytest.approx(0.1, abs=0.02) and stuck[-1] < 0.02
    assert shows(0.15, TimingParams(latency_s=0.05, jitter_s=0.02), stuck[0]) == "mixed"
    lost = [regularity.late(k / 30) for k in range(207, 240)]  # one is missing
    assert lost[0] == pytest.approx(1 / 30, abs=0.02) and lost[-1] < 0.003
    jam_s = 250 / 30
    jammed = [(regularity.late(max(k / 30, jam_s)), jam_s - k / 30) for k in range(240, 251)]  # in a third of a second none comes
    assert all(late_s == pytest.approx(true_s, abs=0.01) for late_s, true_s in jammed)


def test_a_mark_names_the_exposure_modulo_four_or_none() -> None:
    where = MarkParams(row=2, column=4, rows=4, columns=16, u_px=40, v_px=20, width_px=160, height_px=40)
    dark = (np.zeros((20, 30), np.float32),)
    images = []
    for number in range(9):
        light = mark.drawn(dark, where, number)[0]
        images.append(40 + 150 * cv2.resize(light, None, fx=10, fy=10, interpolation=cv2.INTER_AREA))  # ten camera pixels a lamp pixel
        assert mark.shown(images[-1], where) == number % 4
    assert mark.shown(images[0] * 0 + 40, where) is None
    for before, after in pairwise(images):  # half of each
        assert mark.shown((before + after) / 2, where) is None


def test_a_mark_is_within_the_limit_of_power() -> None:
    where = MarkParams(row=2, column=4, rows=4, columns=16, u_px=40, v_px=20, width_px=160, height_px=40)
    limits = mark.spared(LimitParams(power_w=20.0, full_w=80.0), where, ((20, 30),))
    given = limited(Shine(1, (np.ones((20, 30), np.float32),)), None, 1.0, limits)
    assert 0.2 < Shine(1, mark.drawn(given.shine.pictures, where, 1)).share < 0.25
    bare = limited(Shine(1, (np.pad(np.ones((4, 30), np.float32), ((16, 0), (0, 0))),)), None, 1.0, limits)  # beside the mark alone
    assert Shine(1, mark.drawn(bare.shine.pictures, where, 1)).share == pytest.approx(0.25)
    with pytest.raises(LuxloopError, match=r"mark: takes 5.3% of the lamp's power, where limits allow 1.0%; make it smaller"):
        mark.spared(LimitParams(power=0.01), where, ((20, 30),))


def test_pictures_are_cut_scaled_and_straightened(rig_file: Path, tmp_path: Path) -> None:
    camera = CameraParams(width_px=64, height_px=48, bits=12, hfov_deg=40.0)
    rig_file.write_text(WHOLE + "crop = { u_px = 3, v_px = 2, width_px = 64, height_px = 48 }\n")
    picture = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
    image = Rectifier.of(load_rig(rig_file), camera).image(cv2.imencode(".png", picture)[1].tobytes())
    assert np.array_equal(image, np.rint(picture[2:50, 3:67] / 255 * 4095))

    focal_px = 32 / np.tan(np.deg2rad(20))
    bent = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
    matrix = np.array([[2 * focal_px, 0, 80.0], [0, 2 * focal_px, 60.0], [0, 0, 1]])
    response = (np.arange(256) / 255) ** 2.0  # a code is the root of the light
    np.savez(tmp_path / "rig.npz", size_px=[160, 120], camera_matrix=matrix, distortion=bent, response=response)
    rig_file.write_text(WHOLE + '[calibration]\nfile = "rig.npz"\n')
    rectifier = Rectifier.of(load_rig(rig_file), camera)
    at = np.array([[[0.2, -0.1, 1.0]]])  # a point ahead of the camera
    seen = cv2.projectPoints(at, np.zeros(3), np.zeros(3), matrix, bent)[0].ravel()
    v, u = np.indices((120, 160))
    spot = np.exp(-((u - seen[0]) ** 2 + (v - seen[1]) ** 2) / 18)
    image = rectifier.image(np.rint(255 * np.sqrt(spot)).astype(np.uint8))
    weight = np.where(image > 0.1 * image.max(), image, 0)
    rows, columns = np.indices(image.shape) + 0.5
    centre = (columns * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum()
    assert centre == pytest.approx((32 + focal_px * 0.2, 24 - focal_px * 0.1), abs=0.1)  # of a straight pinhole camera


def test_a_calibration_of_another_depth_or_beyond_all_memory_is_refused(rig_file: Path, tmp_path: Path) -> None:
    rig_file.write_text(WHOLE + '[calibration]\nfile = "rig.npz"\n')
    camera, matrix = CameraParams(width_px=64, height_px=48), np.array([[90.0, 0, 32], [0, 90, 24], [0, 0, 1]])
    good = {"size_px": [64, 48], "camera_matrix": matrix, "distortion": np.zeros(5)}
    np.savez(tmp_path / "rig.npz", **good, response=np.linspace(0, 1, 4096))
    with pytest.raises(WrongPicture, match="pictures of 8 bits, where the calibration's response has 4096 numbers"):
        Rectifier.of(load_rig(rig_file), camera).image(np.zeros((48, 64), np.uint8))
    huge = io.BytesIO()
    np.lib.format.write_array_header_1_0(huge, {"descr": "|u1", "fortran_order": False, "shape": (10**13,)})
    np.savez(tmp_path / "rig.npz", **good)
    with zipfile.ZipFile(tmp_path / "rig.npz", "a") as archive:
        archive.writestr("response.npy", huge.getvalue())
    with pytest.raises(LuxloopError, match="longer than its file"):
        Rectifier.of(load_rig(rig_file), camera)


@pytest.mark.parametrize(("data", "words"), [(b"no picture", "damaged"), (np.zeros((10, 10), np.uint8), "10 x 10 px, where the scenario")])
def test_a_picture_that_is_none_is_refused(rig_file: Path, data: bytes | np.ndarray, words: str) -> None:
    with pytest.raises(WrongPicture, match=words):
        Rectifier.of(load_rig(rig_file), CameraParams(width_px=64, height_px=48)).image(data)


@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_half_a_picture_is_refused(ending: str) -> None:
    whole = cv2.imencode(ending, np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8))[1].tobytes()
    assert grey(whole).shape == (48, 64)
    for cut in (len(whole) // 2, len(whole) - 30):
        with pytest.raises(WrongPicture, match="damaged"):
            grey(whole[:cut])


def test_damaged_pictures_of_a_stream_are_left_out(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 20, (48, 64), np.uint8)
    pictures = [cv2.imencode(".jpg", noise + np.uint8(40 * k))[1].tobytes() for k in range(6)]
    pictures[2] = pictures[2][: len(pictures[2]) * 2 // 3]
    (tmp_path / "stream.mjpeg").write_bytes(b"".join(pictures))
    source = StreamCamera(StreamCameraParams(kind="stream", url=str(tmp_path / "stream.mjpeg"), options={}))
    found = [source.read(1.0) for _ in range(5)]
    levels = {int(np.mean(each.data)) // 40 for each in found if each is not None and isinstance(each.data, np.ndarray)}
    assert 2 not in levels and {0, 1, 3} <= levels
    source.close()


def answering(*answers: bytes) -> int:
    """The port of a server that gives each connection the next of some answers, and keeps it open."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        kept = []
        for answer in answers:
            connection, _ = server.accept()
            kept.append(connection)
            connection.recv(4096)
            connection.sendall(answer)
        time.sleep(20)

    threading.Thread(target=serve, daemon=True).start()
    return int(server.getsockname()[1])


HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"HTTP/1.0 404 Not Found\r\n\r\n", "answers with 404"),
        (b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n", "not with multipart pictures"),
        (b"SSH-2.0-OpenSSH\r\n", "no HTTP"),
        (HEAD + b"--frame\r\nContent-Length: 9999999999\r\n\r\n", "a picture of 9999999999 bytes"),
        (HEAD + b"--frame\r\nContent-Type: image/jpeg\r\n\r\n", "no parts with Content-Length"),
        (HEAD[:-2] + b"Transfer-Encoding: chunked\r\n\r\n", "answers in chunks"),
        (HEAD, "no picture for 0.3 s"),
    ],
)
def test_a_camera_that_answers_with_something_else_says_so(answer: bytes, words: str) -> None:
    port = answering(answer)
    rig = validate_model(
        RigParams, {"light": {"kind": "ddp", "host": "a"}, "camera": {"kind": "http", "url": f"http://127.0.0.1:{port}/camera"}}, ""
    )
    camera = Camera(opener(rig.camera), 0.3)
    try:
        assert eventually(lambda: words in camera.reason, 5) and not camera.alive
    finally:
        camera.close()


PART = b"Content-Type: image/jpeg\r\nContent-Length: %s3\r\n\r\nabc\r\n--frame\r\n"


@pytest.mark.parametrize(
    "body",
    [
        b"--frame\r\n" + PART % b"000000000",
        b"--frame\r\n" + PART % (10 * b" "),
        b"This is a stream for old readers.\r\n\r\n--frame\r\n" + PART % b"",
        b"--frame\r\nContent-Type: audio/basic\r\nContent-Length: 2\r\n\r\nxy\r\n--frame\r\n" + PART % b"",
        b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: 0\r\n\r\n\r\n--frame\r\n" + PART % b"",
    ],
    ids=["zeros", "blanks", "preamble", "audio", "empty"],
)
def test_pictures_are_found_among_what_cameras_send(body: bytes) -> None:
    source = HttpCamera(HttpCameraParams(kind="http", url=f"http://127.0.0.1:{answering(HEAD + body)}/"))
    pictures = [picture.data for _ in range(3) if (picture := source.read(0.2))]
    assert pictures == [b"abc"]
    source.close()


def asked(*answers: bytes) -> tuple[int, list[bytes]]:
    """The port of a server that closes each connection after one of some answers, the last one excepted, and what it was asked."""
    server, requests = socket.create_server(("127.0.0.1", 0)), list[bytes]()

    def serve() -> None:
        for k, answer in enumerate(answers):
            connection, _ = server.accept()
            requests.append(connection.recv(4096))
            connection.sendall(answer % {b"port": str(server.getsockname()[1]).encode()} if b"%(port)" in answer else answer)
            if k < len(answers) - 1:
                connection.close()
        time.sleep(20)

    threading.Thread(target=serve, daemon=True).start()
    return int(server.getsockname()[1]), requests


def test_a_camera_asks_for_a_login_and_leads_elsewhere() -> None:
    moved = b"HTTP/1.0 302 Found\r\nLocation: http://127.0.0.1:%(port)s/there?x=1\r\n\r\n"
    challenge = b'HTTP/1.0 401 No\r\nWWW-Authenticate: Digest realm="cam", nonce="n1", qop="auth", algorithm=MD5\r\n\r\n'
    port, requests = asked(moved, challenge, HEAD)
    HttpCamera(HttpCameraParams(kind="http", url=f"http://me:s%20cret@127.0.0.1:{port}/camera")).close()
    assert requests[1].startswith(b"GET /there?x=1 ") and b"Authorization" not in requests[1]
    given = parse_keqv_list(parse_http_list(re.search(r"Authorization: Digest (.*)\r", requests[2].decode())[1]))  # type: ignore[index]

    def md5(text: str) -> str:
        return hashlib.md5(text.encode()).hexdigest()

    middle = f"n1:{given['nc']}:{given['cnonce']}:auth"  # RFC 2617
    assert given["response"] == md5(f"{md5('me:cam:s cret')}:{middle}:{md5('GET:/there?x=1')}")
    port, requests = asked(b'HTTP/1.0 401 No\r\nWWW-Authenticate: Basic realm="cam"\r\n\r\n', HEAD)
    HttpCamera(HttpCameraParams(kind="http", url=f"http://me:pw@127.0.0.1:{port}/")).close()
    assert b"Authorization: Basic bWU6cHc=" in requests[1]
    port, _ = asked(*4 * [moved])
    with pytest.raises(LuxloopError, match="from one address to another"):
        HttpCamera(HttpCameraParams(kind="http", url=f"http://127.0.0.1:{port}/"))


def test_a_camera_that_is_silent_or_drips_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_camera, "SLOW_S", 0.5)
    with pytest.raises(LuxloopError, match=r"does not answer within 0\.5 s"):
        HttpCamera(HttpCameraParams(kind="http", url=f"http://127.0.0.1:{answering(b'')}/", timeout_s=0.3))
    server = socket.create_server(("127.0.0.1", 0))

    def drip() -> None:
        connection, _ = server.accept()
        connection.sendall(HEAD + b"--frame\r\nContent-Length: 1000\r\n\r\n")
        with suppress(OSError):
            for _ in range(100):
                time.sleep(0.05)
                connection.sendall(b"x")

    threading.Thread(target=drip, daemon=True).start()
    url = f"http://127.0.0.1:{server.getsockname()[1]}/"
    source = HttpCamera(HttpCameraParams(kind="http", url=url, timeout_s=0.3))
    with pytest.raises(TimeoutError):
        source.read(1.0)
    source.close()


def test_pictures_from_a_queue_are_told_from_those_that_were_awaited() -> None:
    part = b"--frame\r\nContent-Type: image/png\r\nContent-Length: 3\r\n\r\nabc\r\n"
    port = answering(HEAD + 3 * part)
    rig = validate_model(
        RigParams, {"light": {"kind": "ddp", "host": "a"}, "camera": {"kind": "http", "url": f"http://127.0.0.1:{port}/camera"}}, ""
    )
    source = opener(rig.camera)()
    time.sleep(0.2)
    pictures = [source.read(0.2) for _ in range(4)]
    assert [each and (each.data, each.awaited) for each in pictures] == [(b"abc", False)] * 3 + [None]
    source.close()


def test_a_boundary_that_follows_the_picture_before_is_not_the_next_one(tmp_path: Path) -> None:
    head, body = b"Content-Type: image/png\r\nContent-Length: 3\r\n\r\n", b"abc\r\n--boundary\r\n"
    server = socket.create_server(("127.0.0.1", 0))
    sent_s = list[float]()

    def serve() -> None:
        connection, _ = server.accept()
        connection.recv(4096)
        connection.sendall(HEAD + b"--boundary\r\n")
        for _ in range(3):
            time.sleep(0.1)
            sent_s.append(time.monotonic())
            connection.sendall(head + body)
        time.sleep(20)

    threading.Thread(target=serve, daemon=True).start()
    url = f"http://127.0.0.1:{server.getsockname()[1]}/"
    source = opener(validate_model(RigParams, {"light": {"kind": "ddp", "host": "a"}, "camera": {"kind": "http", "url": url}}, "").camera)()
    for k in range(3):
        picture = source.read(1.0)
        assert picture is not None and picture.data == b"abc" and picture.awaited
        assert 0 <= picture.arrived_s - sent_s[k] < 0.05
    assert source.read(0.05) is None
    source.close()


OWN = """
import time
from itertools import pairwise
import numpy as np
from luxloop.loop.rig.camera import CameraPicture

class Cam:
    def __init__(self, wrong=False):
        self.wrong = wrong
    def read(self, timeout_s):
        time.sleep(0.01)
        return "picture" if self.wrong else CameraPicture(time.monotonic(), True, np.zeros((48, 64), np.uint8))
    def close(self):
        pass
"""


def test_a_camera_of_ones_own_is_read_and_looked_at(tmp_path: Path) -> None:
    (tmp_path / "owncam.py").write_text(OWN)

    def camera(wrong: bool) -> Camera:
        given = {"kind": f"{tmp_path}/owncam:Cam", "options": {"wrong": wrong}}
        rig = validate_model(RigParams, {"light": {"kind": "ddp", "host": "a"}, "camera": given}, "")
        return Camera(opener(rig.camera), 0.3)

    good, bad = camera(False), camera(True)
    try:
        assert isinstance(good.next(time.monotonic() + 2), CameraPicture)
        assert eventually(lambda: "read gives a str; return a luxloop.CameraPicture" in bad.reason, 3)
    finally:
        good.close()
        bad.close()


def test_light_goes_into_files_whole_with_commands_and_dark(tmp_path: Path) -> None:
    light = FilesLight(FilesLightParams(kind="files", folder=tmp_path, bits=16))
    pictures = (np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4), np.ones((1, 2), np.float32))
    assert light.show(Shine(7, pictures, (ModuleCommand(swivel_deg=3.0), ModuleCommand()))) is None
    codes = cv2.imread(str(tmp_path / "light.png"), cv2.IMREAD_UNCHANGED)
    assert codes.dtype == np.uint16 and codes.shape == (4, 4) and codes[3].tolist() == [65535, 65535, 0, 0]
    about = json.loads((tmp_path / "light.json").read_text())
    assert about["number"] == 7 and about["modules"][0]["swivel_deg"] == 3.0
    light.dark()
    assert not cv2.imread(str(tmp_path / "light.png"), cv2.IMREAD_UNCHANGED).any()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["light.json", "light.png"]
    with pytest.raises(LuxloopError, match="make it"):
        FilesLight(FilesLightParams(kind="files", folder=tmp_path / "none"))


def test_samples_come_with_the_plants_time_and_others_are_refused() -> None:
    port = free_port(socket.SOCK_DGRAM)
    ego = UdpEgo(UdpEgoParams(kind="udp", port=port, latency_s=0.01))
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for datagram in (
        encoded("gyro", 5.0, 5.02, [0.0, 0.1, 0.2]),
        encoded("gyro", 5.0, 5.02, [0.0]),
        b"{}",
        encoded("radar", 1.0, 1.0, [1.0]),
        encoded("wheels", 5.0, 5.02, [1e300]),
        encoded("attitude", 5.0, 5.02, [0.0] * 7 + [-1e9]),
    ):
        sender.sendto(datagram, ("127.0.0.1", port))
    assert eventually(lambda: ego.refused == 5, 3)
    (sample,) = ego.samples(torch.empty(0))
    assert sample.sensor == "gyro" and sample.values.tolist() == pytest.approx([0.0, 0.1, 0.2])
    assert sample.arrived_s - sample.measured_s == pytest.approx(0.03)
    ego.close()
