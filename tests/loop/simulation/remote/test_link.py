"""The socket of a simulator: what is refused in a sentence, and bounded."""

import json
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest
from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.uri import parse_uri

from luxloop import prepare, validate
from luxloop.loop.simulation.remote import Link
from luxloop.world.messages import raw
from tests.loop.conftest import SMALL
from tests.loop.simulation.remote.test_remote import free_port
from tests.loop.studio.clients import message, unpacked
from tests.refusal import refusal

SIZE = (4, 6)
FRAME = np.arange(24, dtype=np.uint16).reshape(SIZE)
HELLO = message(type="hello", protocol=1, name="mine")
START = {"type": "start", "number": None}
CAME = {"type": "arrivals", "number": None, "time_s": 1.5}


@contextmanager
def talking(play: Callable[[ClientConnection], Any], link: Link, **how: Any) -> Iterator[list[Any]]:
    """A simulator in a thread, which connects as soon as it can. Gives what it has returned, or what it raised."""
    gave: list[Any] = []

    def run() -> None:
        while True:
            try:
                with connect(f"ws://{link.address}", proxy=None, **how) as there:
                    gave.append(play(there))
                return
            except ConnectionRefusedError:
                time.sleep(0.01)
            except Exception as error:
                gave.append(error)
                return

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield gave
    finally:
        link.close()
        thread.join(10)


def link_of(timeout_s: float = 10.0) -> Link:
    return Link(f"127.0.0.1:{free_port()}", timeout_s, SIZE)


def answering(*answers: bytes | str) -> Callable[[ClientConnection], list[Any]]:
    """Says hello, answers each message once it has come, and gives what has come to the end."""

    def play(there: ClientConnection) -> list[Any]:
        there.send(HELLO)
        got = [unpacked(there.recv())[0]]
        for each in answers:
            got.append(unpacked(there.recv())[0])
            there.send(each)
        return got + [unpacked(each)[0] for each in there]

    return play


def test_messages_come_and_go():
    link = link_of()
    answer = message({"frame.7": FRAME}, "deflate", **CAME | {"number": 7, "frames": [{"number": 7}, {"number": 6, "lost": True}]})
    with talking(answering(message(**CAME), answer), link) as gave:
        link.meet({"name": "a run"})
        first, none = link.ask(START)
        second, frames = link.ask({"type": "show", "number": 7}, {"light.0": raw(np.ones((2, 3), np.float32))})
    assert (first.time_s, first.objects, dict(none)) == (1.5, None, {})
    assert [each.lost for each in second.frames] == [False, True] and np.array_equal(frames["frame.7"], FRAME)
    (got,) = gave
    assert [each["type"] for each in got] == ["welcome", "start", "show", "end"]
    assert got[0] == {"type": "welcome", "protocol": 1, "name": "a run"} and got[2]["arrays"]["light.0"]["shape"] == [2, 3]


FRAME_1 = CAME | {"frames": [{"number": 1}]}
BOMB = message({"frame.1": np.zeros((4000, 4000), np.uint16)}, "deflate", **FRAME_1)


SAMPLE = {"sensor": "wheels", "measured_s": 0, "arrived_s": 0}
OBJECT = {"name": "a", "category": "car", "T_ground_object": np.eye(4).ravel().tolist(), "size_m": [1, 1, 1]}
POSES = (
    ("zeros", [0.0] * 16, "is no pose"),
    ("1e300 m", [1, 0, 0, 1e300, *np.eye(4)[1:].ravel().tolist()], "lies farther away"),
    ("a mirror", np.diag([1.0, -1, 1, 1]).ravel().tolist(), "is no pose"),
    ("another scale", np.diag([1.01, 1.01, 1.01, 1]).ravel().tolist(), "is no pose"),
    ("columns", [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 5, 0, 1], "is no pose"),
)


WRONG: dict[str, tuple[bytes | str, str]] = {
    "another number": (message(**CAME | {"number": 3}), "gives arrivals of exposure 3, but was asked for arrivals with number None"),
    "no head": (b"\xff\xff\xff\xff", "its head has"),
    "no frame": (message(**FRAME_1), "its arrays are none, but it has frame.1"),
    "another size": (
        message({"frame.1": FRAME[:2]}, **FRAME_1),
        r"has the shape \[2, 6\], but frames have \[4, 6\]",
    ),
    "floats": (message({"frame.1": FRAME.astype(np.float32)}, **FRAME_1), "is f4; it may be u1 or u2"),
    "a bomb": (BOMB, r"has the shape \[4000, 4000\]"),
    "no time": (message(**CAME | {"time_s": "soon"}), "time_s"),
    "strange keys": (message(**CAME | {"weather": "fair"}), "weather"),
    "a speed beyond all cars": (message(**CAME | {"samples": [SAMPLE | {"values": [1e300]}]}), "samples.0.values.0"),
    **{f"a pose of {name}": (message(**CAME | {"objects": [OBJECT | {"T_ground_object": pose}]}), words) for name, pose, words in POSES},
}


@pytest.mark.parametrize("name", WRONG)
def test_an_answer_that_is_none_is_refused_here_and_there(name):
    (answer, words), link = WRONG[name], link_of()
    with talking(answering(answer), link) as gave:
        link.meet({})
        with refusal(words) as caught:
            link.ask(START)
        assert str(caught.value).startswith("mine: ") and "\n" not in str(caught.value)
        with refusal("no simulator is connected any more"):
            link.ask(START)
    (error,) = gave
    assert isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code == 4400


def test_a_message_beyond_what_frames_can_take_is_not_read():
    link = link_of()
    with talking(answering(bytes(2**21)), link):
        link.meet({})
        with refusal(r"mine: has gone \(.*1009 \(message too big\)"):
            link.ask(START)


def test_a_simulator_says_why_it_fails():
    link = link_of()
    with talking(answering(message(type="error", text="out of roads")), link) as gave:
        link.meet({})
        with refusal(r"^mine: fails \(out of roads\)$"):
            link.ask(START)
    assert gave[0][-1] == {"type": "end"}


def test_who_is_silent_or_goes_away_ends_the_wait():
    link, begun_s = link_of(0.5), time.monotonic()
    with talking(answering(), link):
        link.meet({})
        with refusal(r"mine: does not answer within 0.5 s; raise plant.timeout_s"):
            link.ask(START)
    link = link_of()
    with talking(lambda there: there.send(HELLO), link), refusal("mine: has gone"):
        link.meet({})
        link.ask(START)
    assert time.monotonic() - begun_s < 5


def test_who_does_not_read_ends_the_wait():
    """The light is larger than what sockets keep of a program that reads nothing."""
    link, there = link_of(0.5), ClientProtocol(parse_uri("ws://127.0.0.1/"))
    with ExitStack() as stack:

        def greet() -> None:
            while True:
                try:
                    mine = stack.enter_context(socket.create_connection(("127.0.0.1", int(link.address.rpartition(":")[2])), 10))
                    break
                except ConnectionRefusedError:
                    time.sleep(0.01)
            there.send_request(there.connect())
            mine.sendall(b"".join(there.data_to_send()))
            there.receive_data(mine.recv(4096))
            there.send_binary(HELLO)
            mine.sendall(b"".join(there.data_to_send()))

        thread = threading.Thread(target=greet)
        thread.start()
        link.meet({})
        thread.join()
        begun_s = time.monotonic()
        with refusal(r"mine: has gone, or does not read within 0.5 s"):
            link.ask({"type": "show", "number": 0}, {"light.0": raw(np.zeros(2**24, np.float32))})
        assert time.monotonic() - begun_s < 5


def test_nobody_comes_and_others_are_refused():
    link = link_of(0.3)
    with refusal(rf"^no simulator has connected to ws://{link.address} within 0.3 s; start one, or raise"):
        link.meet({})
    link = link_of(1.0)
    with (
        talking(lambda there: [there.send(message(type="hello", protocol=9)), [*there]], link) as gave,
        refusal("refused: a program must first say hello, with protocol 1"),
    ):
        link.meet({})
    assert isinstance(gave[0], ConnectionClosed)
    for origin in ("https://elsewhere.example", "null"):  # which frames of any site can have
        link = link_of(1.0)
        with talking(lambda there: None, link, origin=origin) as gave, refusal("no simulator has connected"):
            link.meet({})
        assert isinstance(gave[0], InvalidStatus) and gave[0].response.status_code == 403


def test_one_simulator_is_the_plant_and_another_is_told_so():
    link = link_of()
    with talking(answering(message(**CAME)), link):
        link.meet({})
        with connect(f"ws://{link.address}", proxy=None, origin="http://localhost:8000") as second:
            second.send(HELLO)
            assert unpacked(second.recv())[0] == {"type": "error", "text": "another simulator is the plant of this run"}
        assert link.ask(START)[0].time_s == 1.5
        other = Link(link.address, 1.0, SIZE)
        with refusal(r"cannot listen on 127.0.0.1:99999 \(.*\); set plant.address to another port"):
            Link("127.0.0.1:99999", 1.0, SIZE).meet({})
        with refusal(rf"cannot listen on {link.address} \(.*\); set plant.address to another port"):
            other.meet({})


def test_nothing_is_opened_before_the_start_and_light_comes_as_texture():
    """Its window has all of the light, in cd."""
    address = f"127.0.0.1:{free_port()}"
    simulation = prepare(validate({**SMALL, "plant": {"kind": "remote", "address": address, "sends": "texture"}}, "remote"), "cpu")
    socket.create_server(("127.0.0.1", int(address.rpartition(":")[2]))).close()
    got: list[tuple[dict[str, Any], dict[str, np.ndarray]]] = []

    def play(there: ClientConnection) -> None:
        there.send(HELLO)
        for data in there:
            head, arrays = unpacked(data)
            got.append((head, arrays))
            if head["type"] in ("start", "show"):
                late = head.get("start_s", 99.0) + 0.1
                there.send(message(**CAME | {"number": head["number"], "time_s": late}))

    link = simulation.plant.plant.link  # type: ignore[attr-defined]
    with talking(play, link):
        state = simulation.start()
        assert state.arrivals.time_s == 0.0, "its clock began at 99.1 s"
        state, result = simulation.step(state)
        with refusal("exposure 0 does not follow exposure 1; a simulator goes on from its own state alone"):
            simulation.plant.show(state.plant, result.exposures[0])
    welcome, (head, arrays) = got[0][0], got[2]
    (module,), (top, bottom, left, right) = welcome["modules"], head["windows"][0]
    texture = np.zeros((module["rows"], module["cols"]), np.float32)
    texture[top:bottom, left:right] = arrays["light.0"]
    light = simulation.modules[0].headlight.light_texture(result.exposures[0].lights[0].u)
    assert np.array_equal(texture, light.numpy()) and 0 < texture.max() <= module["peak_cd"]
    assert head["start_s"] == pytest.approx(99.1) and head["commands"] == [{"swivel_deg": 0.0, "level_deg": 0.0, "intensity": 1.0}]
    assert welcome["camera"]["fx"] == simulation.view.fx and welcome["model"]["name"] == "small"
    (length,) = struct.unpack_from("<I", HELLO)
    assert json.loads(HELLO[4 : 4 + length])["protocol"] == welcome["protocol"]
