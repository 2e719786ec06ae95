"""Samples of the vehicle's sensors, received as UDP datagrams of JSON, one sample a datagram:

    {"sensor": "gyro", "measured_s": 12.34, "sent_s": 12.35, "values": [0.0, 0.01, 0.2]}

Both times are of the sender's clock; their difference gives the age of a sample without a common clock.
"""

import json
import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, cast

from pydantic import Field, FiniteFloat, TypeAdapter, ValidationError
from torch import Tensor

from luxloop.loop.rig.params import Egos, NoEgoParams, UdpEgoParams
from luxloop.loop.rig.wire.sockets import udp_listener
from luxloop.perception.egomotion import LARGEST, VALUES, Sample, Sensor
from luxloop.world import plugin

LARGEST_DATAGRAM = 4096  # bytes of a datagram
OLDEST_S = 10.0  # age of a sample; an older one has another clock


@dataclass(frozen=True)
class SensorDatagram:
    """A sample on the network.

    values: as in `luxloop.perception.egomotion.Sample`. measured_s, sent_s: s of the sender's clock.
    """

    sensor: Sensor
    measured_s: FiniteFloat
    sent_s: FiniteFloat
    values: Annotated[tuple[FiniteFloat, ...], Field(min_length=1, max_length=64)]

    @property
    def age_s(self) -> float:
        """Time from measurement to sending in s."""
        return self.sent_s - self.measured_s


_DATAGRAM = TypeAdapter(SensorDatagram)


def encode(sensor: str, measured_s: float, sent_s: float, values: Sequence[float]) -> bytes:
    """Datagram of a sample."""
    return json.dumps({"sensor": sensor, "measured_s": measured_s, "sent_s": sent_s, "values": list(values)}).encode()


def decode(datagram: bytes) -> SensorDatagram | None:
    """Sample of a datagram, None if the datagram is invalid, or its values or age are impossible."""
    if len(datagram) > LARGEST_DATAGRAM:
        return None
    try:
        sample = _DATAGRAM.validate_json(datagram)
    except ValidationError:
        return None
    fits = VALUES[sample.sensor] in (None, len(sample.values)) and max(map(abs, sample.values)) <= LARGEST[sample.sensor]
    return sample if fits and 0 <= sample.age_s <= OLDEST_S else None


KEY = "ego.kind"
METHODS = ("samples", "close")
MOST = 1000  # newest samples in the queue
TICK_S = 1e-3  # of times of measurement, which a network makes no surer, so that samples of one moment are taken together


class Ego:
    """A vehicle's sensors; this one has none, as on a standing vehicle."""

    def samples(self, like: Tensor) -> tuple[Sample, ...]:
        """Samples since the last call, with times of `time.monotonic`; tensors have the dtype and device of `like`."""
        return ()

    def close(self) -> None:
        """Release the port or device."""


class UdpEgo(Ego):
    """Samples from UDP datagrams of JSON, received in a thread. refused: number of invalid datagrams."""

    def __init__(self, params: UdpEgoParams) -> None:
        """Raises LuxloopError if the port cannot be opened."""
        self._params, self.refused = params, 0
        self._come = deque[tuple[float, SensorDatagram]](maxlen=MOST)
        self._socket = udp_listener("ego.port", params.host, params.port)
        self._socket.settimeout(0.1)
        self._open = True
        self._thread = threading.Thread(target=self._run, name="ego", daemon=True)
        self._thread.start()

    def samples(self, like: Tensor) -> tuple[Sample, ...]:
        found = []
        while self._come:
            arrived_s, told = self._come.popleft()
            measured_s = TICK_S * math.floor((arrived_s - self._params.latency_s - told.age_s) / TICK_S)
            found.append(Sample(told.sensor, measured_s, arrived_s, like.new_tensor(told.values)))
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
            if (told := decode(datagram)) is None:
                self.refused += 1
            else:
                self._come.append((time.monotonic(), told))


def open_ego(params: Egos) -> Ego:
    """The sensors of a rig file. Raises LuxloopError if they cannot be opened."""
    match params:
        case NoEgoParams():
            return Ego()
        case UdpEgoParams():
            return UdpEgo(params)
    return cast(Ego, plugin.make(params.kind, KEY, {}, params.options, METHODS))
