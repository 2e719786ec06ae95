"""The vehicle's sensors: samples of its drive in real time, as datagrams. The drive begins with the first light."""

import socket
import threading
import time
from collections.abc import Iterable
from typing import Final

import torch

from luxloop.loop.rig.simulated.timeline import Timeline
from luxloop.loop.rig.wire import datagrams
from luxloop.loop.rig.wire.addresses import REFUSED, reason_of
from luxloop.perception.egomotion import Sample
from luxloop.perception.sensors import Sensors
from luxloop.world.errors import LuxloopError

PERIOD_S: Final = 0.002  # in which samples that have become due are sent
STANDING_S: Final = 0.05  # before the drive, the samples of its beginning come again and again


class SensorSender:
    """Sends samples to an address in a thread of its own."""

    def __init__(self, sensors: Sensors, timeline: Timeline, address: tuple[str, int]) -> None:
        """Raises LuxloopError where there is no such address."""
        self._sensors, self._timeline, self._ended = sensors, timeline, threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect(address)
        except REFUSED as error:
            self._socket.close()
            raise LuxloopError(
                f"--ego {address[0]}:{address[1]}: no such address ({reason_of(error)}); give HOST:PORT of the loop"
            ) from error
        self._thread = threading.Thread(target=self._keep_sending, name="sensors", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop sending."""
        self._ended.set()
        self._thread.join()
        self._socket.close()

    def _keep_sending(self) -> None:
        like, sent_s = torch.empty(0), 0.0
        while not self._ended.wait(STANDING_S if self._timeline.begun_s is None else PERIOD_S):
            now_s, begun_s = time.monotonic(), self._timeline.begun_s
            if begun_s is None:
                self._send(self._sensors.newest(0.0, like), now_s)
            elif now_s > begun_s:
                self._send(self._sensors.arriving(sent_s, now_s - begun_s, like), begun_s)
                sent_s = now_s - begun_s

    def _send(self, samples: Iterable[Sample], zero_s: float) -> None:
        for each in samples:
            values = each.values.tolist()
            try:
                self._socket.send(datagrams.encoded(each.sensor, zero_s + each.measured_s, time.monotonic(), values))
            except OSError:
                return  # nobody listens yet
