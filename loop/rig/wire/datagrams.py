"""Samples of a vehicle's sensors as UDP datagrams of JSON, one a datagram:

    {"sensor": "gyro", "measured_s": 12.34, "sent_s": 12.35, "values": [0.0, 0.01, 0.2]}

Both times are of the sender's clock, so that a receiver knows the age of a sample without a common clock.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

LARGEST: Final = 4096  # bytes of a datagram
MOST_VALUES: Final = 64


@dataclass(frozen=True)
class SensorDatagram:
    """A sample as it goes over the network. values: as in `luxloop.perception.egomotion.Sample`. Times in s of the sender's clock."""

    sensor: str
    measured_s: float
    sent_s: float
    values: tuple[float, ...]

    @property
    def age_s(self) -> float:
        """Time from measurement to sending in s."""
        return self.sent_s - self.measured_s


def encoded(sensor: str, measured_s: float, sent_s: float, values: Sequence[float]) -> bytes:
    """The datagram of a sample."""
    return json.dumps({"sensor": sensor, "measured_s": measured_s, "sent_s": sent_s, "values": list(values)}).encode()


def decoded(datagram: bytes) -> SensorDatagram | None:
    """The sample of a datagram, None where it has none."""
    if len(datagram) > LARGEST:
        return None
    try:
        data = json.loads(datagram)
        values = tuple(float(value) for value in data["values"])
        sample = SensorDatagram(str(data["sensor"]), float(data["measured_s"]), float(data["sent_s"]), values)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None
    finite = all(math.isfinite(value) for value in (sample.measured_s, sample.sent_s, *values))
    return sample if finite and 0 < len(values) <= MOST_VALUES else None
