"""Messages of a JSON head and a body of arrays, as other programs exchange them with the studio and with the loop (docs/programs.md).

Four bytes with the length of the head, the head, the body. Arrays are read within strict limits. Without torch.
"""

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import prod
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from luxloop.world.errors import LuxloopError
from luxloop.world.params import Params
from luxloop.world.plugin import in_a_line

CODES: Final = {"uint8": "u1", "uint16": "u2", "uint32": "u4", "float16": "f2", "float32": "f4"}
MOST_BYTES: Final = 2**22  # of an array of a studio's client, decoded
PNG: Final = b"\x89PNG\r\n\x1a\n"
GREY: Final = (8, 0)  # bits and colour type of a PNG

Arrays = Mapping[str, np.ndarray]
Size = Annotated[int, Field(ge=0, lt=2**31)]


@dataclass(frozen=True)
class ArrayBytes:
    """An array as a message carries it."""

    dtype: str
    shape: tuple[int, ...]
    coding: Literal["raw", "deflate"]
    data: bytes


def encode(array: np.ndarray) -> ArrayBytes:
    """An array, compressed where that pays. Raises KeyError for a dtype that has no code."""
    whole = raw(array)
    small = zlib.compress(whole.data, 1)
    return replace(whole, coding="deflate", data=small) if len(small) < 0.9 * len(whole.data) else whole


def raw(array: np.ndarray) -> ArrayBytes:
    """An array as it is. Raises KeyError for a dtype that has no code."""
    return ArrayBytes(CODES[str(array.dtype)], array.shape, "raw", np.ascontiguousarray(array).tobytes())


class ArrayHead(Params):
    """Description of an array by a client. start, bytes: its place in the body."""

    dtype: Literal["u1", "u2", "u4", "f2", "f4"]
    shape: tuple[Size, ...] = Field(max_length=3)
    start: Size
    bytes: Size
    coding: Literal["raw", "deflate", "png"]


def given_arrays(heads: Mapping[str, ArrayHead], body: Any, wanted: Mapping[str, tuple[str, ...]], most_bytes: int = MOST_BYTES) -> Arrays:
    """The arrays of a client's message. wanted: the dtypes allowed for each; none may be missing or extra. most_bytes: of one array.

    An array is decoded after its size is checked, and no further than that size. Raises ValueError where one differs from its description.
    """
    if heads.keys() != wanted.keys():
        raise ValueError(f"its arrays are {', '.join(heads) or 'none'}, but it has {', '.join(wanted) or 'none'}")
    end = max((head.start + head.bytes for head in heads.values()), default=0)
    if end != len(body):
        raise ValueError(f"its body has {len(body)} bytes, but its arrays end at {end}")
    for name, head in heads.items():
        if head.dtype not in wanted[name]:
            raise ValueError(f"array {name} is {head.dtype}; it may be {' or '.join(wanted[name])}")
        if int(head.dtype[1]) * prod(head.shape) > most_bytes:
            raise ValueError(f"array {name} has the shape {list(head.shape)}; arrays have at most {most_bytes} bytes")
    return {name: decode(name, head, bytes(body[head.start : head.start + head.bytes])) for name, head in heads.items()}


def decode(name: str, head: ArrayHead, data: bytes) -> np.ndarray:
    """An array of a message, inflated no further than its size. Raises ValueError where it is not as the head says."""
    size = int(head.dtype[1]) * prod(head.shape)
    if head.coding == "png":
        return _picture(name, head, data)
    if head.coding == "deflate":
        inflating = zlib.decompressobj()
        try:
            data = inflating.decompress(data, size + 1)
        except zlib.error as error:
            raise ValueError(f"array {name} is no zlib stream") from error
    if len(data) != size:
        raise ValueError(f"array {name} has not the {size} bytes of its shape")
    return np.frombuffer(data, f"<{head.dtype}").reshape(head.shape)


def _picture(name: str, head: ArrayHead, data: bytes) -> np.ndarray:
    import cv2

    told = struct.unpack(">IIBB", data[16:26]) if data.startswith(PNG) and data[12:16] == b"IHDR" and len(data) >= 26 else None
    if told is None or head.dtype != "u1" or told != (*reversed(head.shape), *GREY):
        raise ValueError(f"array {name} is no 8-bit grey PNG of its shape")
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None or picture.shape != head.shape:
        raise ValueError(f"array {name} is no 8-bit grey PNG of its shape")
    return picture


LENGTH: Final = struct.Struct("<I")
LARGEST_HEAD: Final = 2**20  # bytes
MOST_ARRAYS: Final = 16


class Body(Params):
    """The arrays of a message's body."""

    arrays: dict[str, ArrayHead] = Field({}, max_length=MOST_ARRAYS)


def pack(head: Mapping[str, Any], arrays: Mapping[str, ArrayBytes] | None = None) -> bytes:
    """A message. Numbers that are not finite become null, which JSON has in their place."""
    listed, start = {}, 0
    for name, each in (arrays or {}).items():
        listed[name] = {"dtype": each.dtype, "shape": each.shape, "start": start, "bytes": len(each.data), "coding": each.coding}
        start += len(each.data)
    text = json.dumps(_finite({**head, **({"arrays": listed} if listed else {})}), allow_nan=False, separators=(",", ":")).encode()
    return b"".join([LENGTH.pack(len(text)), text, *(each.data for each in (arrays or {}).values())])


def unpack(data: bytes | str) -> tuple[dict[str, Any], Mapping[str, ArrayHead], memoryview]:
    """Head, descriptions of arrays, and body of a message, without copies. Call it within `understood`, which turns its exceptions into
    sentences.
    """
    if isinstance(data, str):
        raise ValueError("it is text; messages are binary")
    (length,) = LENGTH.unpack_from(data)
    if length > min(len(data) - LENGTH.size, LARGEST_HEAD):
        raise ValueError(f"its head has {length} bytes, but {len(data) - LENGTH.size} are there, and {LARGEST_HEAD} may be")
    head = json.loads(data[LENGTH.size : LENGTH.size + length])
    if not isinstance(head, dict):
        raise ValueError("its head is no object")
    body = Body(arrays=head.pop("arrays", {}))
    return head, body.arrays, memoryview(data)[LENGTH.size + length :]


@contextmanager
def understood() -> Iterator[None]:
    """Turn the exceptions of an unreadable message into a LuxloopError with the reason."""
    try:
        yield
    except ValidationError as error:
        raise LuxloopError(f"message: {in_a_line(error)}") from error
    except RecursionError as error:
        raise LuxloopError("message: not understood (it is nested too deep)") from error
    except (struct.error, ValueError) as error:
        raise LuxloopError(f"message: not understood ({error})") from error


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(each) for key, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, list | tuple) else value
