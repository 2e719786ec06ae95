"""Light arrives as it was sent, whole or not at all, and what is no light does no harm."""

import random
import socket
from collections.abc import Iterable

import numpy as np
import pytest

from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.lights import DdpLight
from luxloop.loop.rig.params import DdpLightParams
from luxloop.loop.rig.wire import ddp
from luxloop.loop.rig.wire.ddp import Assembler, LightFrame, packets
from luxloop.world.headlight.lamp import ModuleCommand
from tests.refusal import refusal

N = 4000  # pixels, three packets of 8 bits


def frame(seed: int, dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, N, dtype, endpoint=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_frame_comes_as_it_was_sent_in_any_order_of_packets(dtype):
    sent, assembler = frame(0, dtype), Assembler(N)
    order = list(packets(sent, 7, (ModuleCommand(1.5, -0.25, 0.5),)))
    assert len(order) == 1 + -(-sent.nbytes // 1440)
    random.Random(0).shuffle(order)
    *none, came = [assembler.take(packet) for packet in order]
    assert none == [None] * len(none)
    assert came.codes.dtype == dtype and (came.codes == sent).all()
    assert came.timecodes == (7,) and came.commands == (ModuleCommand(1.5, -0.25, 0.5),)


def lit(assembler: Assembler, sent: Iterable[bytes]) -> list[LightFrame]:
    return [each for packet in sent if (each := assembler.take(packet))]


def test_the_header_is_that_of_the_protocol():
    *_, last = packets(np.arange(2000).astype(np.uint16), 2**32 + 3)
    assert last[:14] == bytes([0x51, 3, 0x24, 1, 0, 0, 0x0B, 0x40, 0x04, 0x60, 0, 0, 0, 3])
    assert last[14:16] == (2880 // 2).to_bytes(2, "big")


def test_utilisations_survive_their_codes():
    u = np.linspace(-0.1, 1.1, 50, dtype=np.float32)
    for bits, gamma in ((8, 1.0), (16, 2.2)):
        back = ddp.utilisations_of(ddp.codes_of(u, bits, gamma), gamma)
        assert abs(back - u.clip(0, 1)).max() < 0.51 * gamma / (2**bits - 1)  # half a level


def test_an_incomplete_frame_is_not_lit_and_repaired_by_the_next_sending():
    assembler, first = Assembler(N), list(packets(frame(1), 1))
    assert [assembler.take(packet) for packet in (first[0], first[2])] == [None, None]
    again = [assembler.take(packet) for packet in first]
    assert (again[1].codes == frame(1)).all() and again[0] is None
    assert again[2] is not None, "and comes again with its last packet, as word of life"
    second = list(packets(frame(2), 2))
    assert assembler.take(second[0]) is None
    (come,) = lit(assembler, packets(frame(3), 3))
    assert (come.codes == frame(3)).all() and assembler.incomplete == 1
    assert assembler.take(second[1]) is None and assembler.take(second[2]) is None, "late packets disturb nothing"
    assembler.forget()
    assert lit(assembler, packets(frame(0), 0)), "after a time-out numbers may begin anew"


def test_a_mixing_lamp_lights_what_came_and_says_so():
    assembler = Assembler(N, mixed=True)
    for packet in packets(frame(1), 1):
        assembler.take(packet)
    second = list(packets(frame(2), 2))
    assembler.take(second[0])
    mixed = assembler.take(second[2])
    assert mixed.timecodes == (2, 1)
    assert (mixed.codes[:1440] == frame(2)[:1440]).all() and (mixed.codes[1440:2880] == frame(1)[1440:2880]).all()


def test_a_frame_without_its_commands_is_incomplete_where_modules_are_commanded():
    assembler, command = Assembler(N), (ModuleCommand(intensity=0.2),)
    assert lit(assembler, packets(frame(1), 1))[0].commands is None
    assert lit(assembler, packets(frame(2), 2, command))[0].commands == command
    assert not lit(assembler, packets(frame(3), 3))


def test_anything_else_is_refused():
    good, noise = next(packets(frame(0), 1)), random.Random(1)
    bad = [b"", good[:13], good[:-1], good + b"x", good[:4] + b"\xff\xff\xff\xf0" + good[8:], good[:2] + b"\x01" + good[3:]]
    bad += [good[:4] + b"\0\0\0\1" + good[8:], *(noise.randbytes(noise.randrange(1500)) for _ in range(2000))]
    commanding = bytearray(next(packets(frame(0), 1, (ModuleCommand(),))))
    bad += [bytes(commanding).replace(b"1.0", text) for text in (b"NaN", b"2.5", b"[[]", b'"a"')]
    assembler = Assembler(N)
    assert not any(assembler.take(packet) for packet in bad)
    assert assembler.refused == len(bad)
    with refusal("99 modules take"):
        list(packets(frame(0), 1, (ModuleCommand(),) * 99))


class Receiver:
    """Stores what packets hold, and lights it at the push. last: number of the packet before the next push."""

    def __init__(self, pixels: int) -> None:
        self.lit, self._data, self.last = bytes(pixels), bytearray(pixels), 0

    def take(self, packet: bytes) -> None:
        offset, length = int.from_bytes(packet[4:8], "big"), int.from_bytes(packet[8:10], "big")
        self._data[offset : offset + length] = packet[14 if packet[0] & 0x10 else 10 :]
        if packet[0] & 0x01:
            self.lit = bytes(self._data)


class Wled(Receiver):
    """How WLED's receiver takes packets: by its source, it drops those that seem to belong to a frame before the last push."""

    def take(self, packet: bytes) -> None:
        number, last = packet[1] & 0xF, self.last
        if last and number and (last - 5 < number < last if last > 5 else number > 10 + last or number < last):
            return
        super().take(packet)
        self.last = number if packet[0] & 0x01 else last


class Strict(Receiver):
    """A receiver that wants every number in its turn, as the specification counts them."""

    def take(self, packet: bytes) -> None:
        assert packet[1] == self.last % 15 + 1, "numbers count packets, over frames"
        assert not packet[0] & 0x10, "some know the header of 10 bytes only"
        super().take(packet)
        self.last = packet[1]


@pytest.mark.parametrize("kind", [Wled, Strict])
def test_receivers_of_others_light_every_frame_and_go_dark_at_the_end(kind):
    receiver = kind(N)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        there.settimeout(5)
        keys = {"kind": "ddp", "host": "localhost", "port": there.getsockname()[1], "commands": False}
        light = DdpLight(DdpLightParams.model_validate(keys), [(40, 100)])

        def lit(packets: int) -> bytes:
            for _ in range(packets):
                receiver.take(there.recv(2000))
            return receiver.lit

        for number in range(20):
            u = np.random.default_rng(number).random((40, 100), np.float32)
            assert light.show(Shine(number, (u,))) is None
            assert lit(3) == ddp.codes_of(u.ravel(), 8).tobytes()
        light.dark()
        assert lit(9) == bytes(N)
        light.close()


@pytest.mark.parametrize("lost", [0, 2])
def test_without_time_codes_a_frame_ends_where_the_next_begins(lost):
    assembler, second = Assembler(N), list(packets(frame(2)))
    (first,) = lit(assembler, packets(frame(1)))
    assert (first.codes == frame(1)).all()
    assert not lit(assembler, (each for k, each in enumerate(second) if k != lost)), "it lacks a packet"
    (third,) = lit(assembler, packets(frame(3)))
    assert (third.codes == frame(3)).all()
