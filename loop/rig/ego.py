"""Samples of the vehicle's sensors."""

import socket
import threading
import time
from collections import deque
from typing import Any, Final, Protocol, cast

from torch import Tensor

from luxloop.loop.rig.params import Egos, NoEgoParams, UdpEgoParams
from luxloop.loop.rig.wire.addresses import REFUSED, reason_of
from luxloop.loop.rig.wire.datagrams import LARGEST as LARGEST_DATAGRAM
from luxloop.loop.rig.wire.datagrams import SensorDatagram, decoded
from luxloop.perception.egomotion import LARGEST, VALUES, Sample
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError

KEY: Final = "ego.kind"
METHODS: Final = ("samples", "close")
MOST: Final = 1000  # samples that nobody has taken yet
OLDEST_S: Final = 10.0  # age of a sample; an older one has another clock


class Ego(Protocol):
    """A vehicle's sensors."""

    def samples(self, like: Tensor) -> tuple[Sample, ...]:
        """Samples since the last call, with times of `time.monotonic`; tensors have the dtype and device of `like`."""
        ...

    def close(self) -> None: ...


class NoEgo:
    """A standing vehicle, without sensors."""

    def samples(self, like: Tensor) -> tuple[Sample, ...]:
        return ()

    def close(self) -> None:
        return None


class UdpEgo:
    """Samples from UDP datagrams of JSON, received in a thread of its own. refused: number of invalid datagrams."""

    def __init__(self, params: UdpEgoParams) -> None:
        """Raises LuxloopError if the port cannot be opened."""
        self._params, self.refused = params, 0
        self._come = deque[tuple[float, SensorDatagram]](maxlen=MOST)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((params.host, params.port))
        except REFUSED as error:
            self._socket.close()
            raise LuxloopError(
                f"ego.port: cannot listen on {params.host}:{params.port} ({reason_of(error)}); give another port, or end what holds it"
            ) from error
        self._socket.settimeout(0.1)
        self._open = True
        self._thread = threading.Thread(target=self._run, name="ego", daemon=True)
        self._thread.start()

    def samples(self, like: Tensor) -> tuple[Sample, ...]:
        found = []
        while self._come:
            arrived_s, told = self._come.popleft()
            measured_s = arrived_s - self._params.latency_s - told.age_s
            found.append(Sample(cast(Any, told.sensor), measured_s, arrived_s, like.new_tensor(told.values)))
        return tuple(found)

    def close(self) -> None:
        self._open = False
        self._thread.join(1)
        self._socket.close()

    def _run(self) -> None:
        while self._open:
            try:
                datagram = self._socket.recv(LARGEST_DATAGRAM + 1)
            except TimeoutError:
                continue
            except OSError:
                return
            told = decoded(datagram)
            if told is not None and _possible(told):
                self._come.append((time.monotonic(), told))
            else:
                self.refused += 1


def _possible(told: SensorDatagram) -> bool:
    """Whether a vehicle's sensor may have told this, a short time ago."""
    if told.sensor not in VALUES or not 0 <= told.age_s <= OLDEST_S:
        return False
    sensor = cast(Any, told.sensor)
    return VALUES[sensor] in (None, len(told.values)) and max(map(abs, told.values)) <= LARGEST[sensor]


def open_ego(params: Egos) -> Ego:
    """The sensors of a rig file. Raises LuxloopError if they cannot be opened."""
    match params:
        case NoEgoParams():
            return NoEgo()
        case UdpEgoParams():
            return UdpEgo(params)
    return cast(Ego, plugin.make(params.kind, KEY, {}, params.options, METHODS))
