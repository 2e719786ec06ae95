"""The studio's messages: their bytes, and what is refused."""

import importlib.util
import json
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from luxloop.loop.studio.messages import Paint, Set, Speed, read
from luxloop.world.messages import LENGTH, encode, pack, raw
from tests.loop.studio.clients import message, unpacked
from tests.refusal import refusal


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.float16, np.float32])
def test_arrays_and_pictures_come_back_bit_for_bit(dtype):
    rng = np.random.default_rng(0)
    sent = {"noise": (100 * rng.random((5, 7))).astype(dtype), "zeros": np.zeros((40, 30), dtype)}
    picture = rng.integers(0, 256, (9, 13)).astype(np.uint8)
    head, got = unpacked(pack({"type": "test"}, {name: encode(each) for name, each in sent.items()} | {"picture": raw(picture)}))
    assert head["type"] == "test" and head["arrays"]["zeros"]["coding"] == "deflate"
    for name, each in (sent | {"picture": picture}).items():
        assert got[name].dtype == each.dtype and np.array_equal(got[name], each)


def test_numbers_that_are_not_finite_are_null():
    text = pack({"values": [float("nan"), {"deep": float("inf")}, 1.5]})[LENGTH.size :]
    assert json.loads(text) == {"values": [None, {"deep": None}, 1.5]}


def test_types_of_the_page_are_those_of_the_messages():
    spec = importlib.util.spec_from_file_location("protocol", Path(__file__).parents[3] / "scripts/protocol.py")
    assert spec is not None and spec.loader is not None
    protocol = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(protocol)
    assert protocol.FILE.read_text("utf-8") == protocol.typescript(), "run scripts/protocol.py"


def test_messages_are_read():
    assert read(message(type="set", overrides=["camera.bits=8"])) == (Set(type="set", overrides=("camera.bits=8",)), {})
    assert read(message(type="speed", factor=None)) == (Speed(type="speed", factor=None), {})


PAINT: dict[str, Any] = {"type": "paint", "module": 0, "box": [0, 5, 0, 7]}


@pytest.mark.parametrize("coding", ["raw", "deflate", "png"])
def test_a_body_is_read_bit_for_bit(coding):
    rng = np.random.default_rng(0)
    sent = {name: rng.integers(0, 256, (5, 7)).astype(np.uint8) for name in ("value", "painted")}
    head, got = read(message(sent, coding, **PAINT))
    assert head == Paint(type="paint", module=0, box=(0, 5, 0, 7), over=True)
    assert got.keys() == sent.keys() and all(np.array_equal(got[name], each) for name, each in sent.items())


def bodied(data: bytes, **changes: Any) -> bytes:
    """A message to paint whose second array is this, said to be so."""
    first = {"dtype": "u1", "shape": [5, 7], "start": 0, "bytes": 35, "coding": "raw"}
    second = {"dtype": "u1", "shape": [5, 7], "start": 35, "bytes": len(data), "coding": "raw"} | changes
    text = json.dumps({**PAINT, "arrays": {"value": first, "painted": second}}).encode()
    return LENGTH.pack(len(text)) + text + bytes(35) + data


BOMB = zlib.compress(bytes(50_000_000), 9)
GOOD_PNG = cv2.imencode(".png", np.zeros((5, 7), np.uint8))[1].tobytes()
LARGE_PNG = cv2.imencode(".png", np.zeros((4000, 4000), np.uint8))[1].tobytes()


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (message({}, **PAINT), "arrays are none"),
        (message({"value": np.zeros((5, 7), np.uint8)}, **PAINT), "arrays are value"),
        (message({"painted": np.zeros(3, np.uint8)}, type="play"), "it has none"),
        (message({name: np.zeros((5, 7), np.float32) for name in ("value", "painted")}, **PAINT), "is f4"),
        (bodied(bytes(34)), "35 bytes"),
        (bodied(bytes(36)), "35 bytes"),
        (bodied(bytes(35), start=36), "end at 71"),
        (bodied(bytes(35), start=-1), "start"),
        (bodied(bytes(35), shape=[-5, -7]), "shape"),
        (bodied(bytes(35), shape=[2**30, 2**30]), "at most"),
        (bodied(bytes(35), dtype="O"), "dtype"),
        (bodied(BOMB, coding="deflate"), "35 bytes"),
        (bodied(BOMB, coding="deflate", shape=[5000, 10_000]), "at most"),
        (bodied(BOMB[:100], coding="deflate", shape=[1000, 1000]), "1000000 bytes"),
        (bodied(b"no stream at all", coding="deflate"), "no zlib stream"),
        (bodied(LARGE_PNG, coding="png"), "grey PNG"),
        (bodied(GOOD_PNG[:40], coding="png"), "grey PNG"),
        (bodied(b"GIF89a" + bytes(40), coding="png"), "grey PNG"),
        (b"\xff\xff\x0f\x00" + b"[" * 0xFFFFF, "nested too deep"),
        (b"", "not understood"),
        (b"\x05\0\0\0{}", "5 bytes"),
        (b"\x02\0\0\0{}more", "type"),
        (b"\x02\0\0\0[]", "no object"),
        ("{}", "messages are binary"),
        (message(type="shout"), "shout"),
        (message(type="play") + b"more", "4 bytes"),
        (message(type="speed", factor=-1), "factor"),
        (message(type="speed", factor=float("nan")), "factor"),
        (message(type="play", loudly=True), "loudly"),
        (message(type="set", overrides=["x" * 200_000]), "overrides"),
        (LENGTH.pack(10) + zlib.compress(b"{}" * 9)[:10], "message"),
    ],
)
def test_what_is_no_message_and_a_body_that_is_not_as_it_is_said_to_be_are_refused(data, told):
    with refusal(told) as error:
        read(data)
    assert "\n" not in str(error.value) and str(error.value).startswith("message: ")
