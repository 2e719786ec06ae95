"""A sample arrives as it was sent; anything else is none."""

import pytest

from luxloop.loop.rig.wire.datagrams import decoded, encoded


def test_a_sample_comes_as_it_was_sent() -> None:
    came = decoded(encoded("gyro", 12.25, 12.5, (0.0, -0.125, 1e-9)))
    assert came is not None
    assert (came.sensor, came.measured_s, came.values) == ("gyro", 12.25, (0.0, -0.125, 1e-9))
    assert came.age_s == 0.25


@pytest.mark.parametrize(
    "datagram",
    [
        b"",
        b"\xff",
        b"[]",
        b'"values"',
        b'{"sensor": "gyro"}',
        encoded("gyro", float("nan"), 0, (1,)),
        encoded("gyro", 0, 0, ()),
        encoded("gyro", 0, 0, (1,) * 65),
        b"[" * 4000,
        b" " * 5000 + encoded("gyro", 0, 0, (1,)),
        b'{"sensor": "gyro", "measured_s": 0, "sent_s": 0, "values": [1e999]}',
        b'{"sensor": "gyro", "measured_s": 0, "sent_s": 0, "values": {}}',
    ],
)
def test_anything_else_is_none(datagram: bytes) -> None:
    assert decoded(datagram) is None
