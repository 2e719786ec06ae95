"""Poses of the vehicle's body for a motion platform, as UDP datagrams of JSON, one a pose:

    {"number": 12, "time_s": 0.4, "heave_m": 0.01, "roll_deg": 0.2, "pitch_deg": -0.5}

They are of the body over the ground, at a time since the run began; roll is positive right side down, pitch nose down.
"""

import json
import socket
from contextlib import suppress
from dataclasses import asdict, dataclass

from luxloop.loop.rig.wire.addresses import REFUSED, reason_of
from luxloop.world.errors import LuxloopError


@dataclass(frozen=True)
class BodyPose:
    """The body at an exposure. number: of the exposure. time_s: when it begins."""

    number: int
    time_s: float
    heave_m: float
    roll_deg: float
    pitch_deg: float


class PoseSender:
    """Sends poses to an address. Nobody need listen there."""

    def __init__(self, host: str, port: int) -> None:
        """Raises LuxloopError where there is no such address."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((host, port))
        except REFUSED as error:
            self._socket.close()
            raise LuxloopError(f"platform.host: {host} cannot be reached ({reason_of(error)}); check the name, and the network") from error

    def send(self, pose: BodyPose) -> None:
        """Send one; it is lost where that cannot be."""
        with suppress(OSError):
            self._socket.send(json.dumps(asdict(pose)).encode())

    def close(self) -> None:
        """No more poses."""
        self._socket.close()
