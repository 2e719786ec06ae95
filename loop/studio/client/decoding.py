"""Messages of the studio's server, read."""

import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from luxloop.world.messages import LENGTH


def unpacked(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Head and arrays of a message."""
    (length,) = LENGTH.unpack_from(data)
    head = json.loads(data[LENGTH.size : LENGTH.size + length])
    body = memoryview(data)[LENGTH.size + length :]
    return head, {name: _decoded(told, body) for name, told in head.pop("arrays", {}).items()}


def _decoded(told: Mapping[str, Any], body: memoryview) -> np.ndarray:
    part = body[told["start"] : told["start"] + told["bytes"]]
    if told["coding"] == "png":
        import cv2

        return np.asarray(cv2.imdecode(np.frombuffer(part, np.uint8), cv2.IMREAD_UNCHANGED))
    plain = zlib.decompress(part) if told["coding"] == "deflate" else part
    return np.frombuffer(plain, f"<{told['dtype']}").reshape(told["shape"])
