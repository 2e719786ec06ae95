"""The studio's messages: their bytes, and what is refused."""

import json
import zlib

import numpy as np
import pytest

from loop.studio.messages import LENGTH, Set, Speed, coded, grey, packed, read
from tests.loop.studio.clients import message, unpacked
from world.errors import LuxloopError


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.float16, np.float32])
def test_arrays_come_back_bit_for_bit(dtype: type) -> None:
    rng = np.random.default_rng(0)
    sent = {"noise": (100 * rng.random((5, 7))).astype(dtype), "zeros": np.zeros((40, 30), dtype)}
    head, got = unpacked(packed({"type": "test"}, {name: coded(each) for name, each in sent.items()}))
    assert head["type"] == "test" and head["arrays"]["zeros"]["coding"] == "deflate"
    for name, each in sent.items():
        assert got[name].dtype == each.dtype and np.array_equal(got[name], each)


def test_pictures_come_back_bit_for_bit() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (9, 13)).astype(np.uint8)
    _, got = unpacked(packed({}, {"picture": grey(picture)}))
    assert np.array_equal(got["picture"], picture)


def test_numbers_that_are_not_finite_are_null() -> None:
    text = packed({"values": [float("nan"), {"deep": float("inf")}, 1.5]})[LENGTH.size :]
    assert json.loads(text) == {"values": [None, {"deep": None}, 1.5]}


def test_messages_are_read() -> None:
    assert read(message(type="set", overrides=["camera.bits=8"])) == Set(type="set", overrides=("camera.bits=8",))
    assert read(message(type="speed", factor=None)) == Speed(type="speed", factor=None)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "not understood"),
        (b"\x05\0\0\0{}", "5 bytes"),
        (b"\x02\0\0\0{}more", "2 bytes"),
        ("{}", "messages are binary"),
        (message(type="shout"), "shout"),
        (message(type="speed", factor=-1), "factor"),
        (message(type="speed", factor=float("nan")), "factor"),
        (message(type="play", loudly=True), "loudly"),
        (message(type="set", overrides=["x" * 5000]), "overrides"),
        (LENGTH.pack(10) + zlib.compress(b"{}" * 9)[:10], "message"),
    ],
)
def test_what_is_no_message_is_refused_in_a_sentence(data: bytes | str, told: str) -> None:
    with pytest.raises(LuxloopError, match=told) as error:
        read(data)
    assert "\n" not in str(error.value) and str(error.value).startswith("message: ")
