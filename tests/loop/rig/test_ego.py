"""Samples of the sensors arrive as they were sent, with the plant's time; anything else is refused."""

import socket

import pytest
import torch

from luxloop.loop.rig.ego import UdpEgo, decode, encode
from luxloop.loop.rig.params import UdpEgoParams
from tests.loop.rig.conftest import eventually, free_port


def test_samples_come_with_the_plants_time_and_others_are_refused():
    port = free_port(socket.SOCK_DGRAM)
    ego = UdpEgo(UdpEgoParams(kind="udp", port=port, latency_s=0.01))
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for datagram in (
        encode("gyro", 5.0, 5.02, [0.0, 0.1, 0.2]),
        encode("wheels", 5.0, 5.0201, [3.0]),
        encode("gyro", 5.0, 5.02, [0.0]),
        b"{}",
        encode("radar", 1.0, 1.0, [1.0]),
        encode("wheels", 5.0, 5.02, [1e300]),
        encode("attitude", 5.0, 5.02, [0.0] * 7 + [-1e9]),
    ):
        sender.sendto(datagram, ("127.0.0.1", port))
    assert eventually(lambda: ego.refused == 5, 3)
    sample, other = ego.samples(torch.empty(0))
    assert sample.sensor == "gyro" and sample.values.tolist() == pytest.approx([0.0, 0.1, 0.2])
    assert sample.arrived_s - sample.measured_s == pytest.approx(0.03, abs=1e-3)  # of a tick
    ticks = (other.measured_s - sample.measured_s) * 1000
    assert ticks == pytest.approx(round(ticks), abs=1e-4)
    ego.close()


@pytest.mark.parametrize(
    "datagram",
    [b"\xff", b'"values"', b"[" * 4000, encode("gyro", float("nan"), 0, (1,)), encode("gyro", 0, 0, ()), encode("gyro", 0, 0, (1,) * 65),
     b" " * 5000 + encode("gyro", 0, 0, (1,)), b'{"sensor": "gyro", "measured_s": 0, "sent_s": 0, "values": [1e999]}'],
)  # fmt: skip
def test_a_datagram_without_a_sample_is_none(datagram):
    assert decode(datagram) is None
