"""The bytes of a message: four with the length of its head, the head, a JSON object, and the body with its arrays."""

import json
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from pydantic import Field, ValidationError

from luxloop.world.errors import LuxloopError
from luxloop.world.messages.arrays import ArrayHead, Coded
from luxloop.world.params import Params
from luxloop.world.plugin import in_a_line

LENGTH: Final = struct.Struct("<I")
LARGEST_HEAD: Final = 2**20  # bytes
MOST_ARRAYS: Final = 16


class Body(Params):
    """The arrays of a message's body."""

    arrays: dict[str, ArrayHead] = Field({}, max_length=MOST_ARRAYS)


def packed(head: Mapping[str, Any], arrays: Mapping[str, Coded] | None = None) -> bytes:
    """A message. Numbers that are not finite become null, which JSON has in their place."""
    listed, start = {}, 0
    for name, each in (arrays or {}).items():
        listed[name] = {"dtype": each.dtype, "shape": each.shape, "start": start, "bytes": len(each.data), "coding": each.coding}
        start += len(each.data)
    text = json.dumps(_finite({**head, **({"arrays": listed} if listed else {})}), allow_nan=False, separators=(",", ":")).encode()
    return b"".join([LENGTH.pack(len(text)), text, *(each.data for each in (arrays or {}).values())])


def parted(data: bytes | str) -> tuple[dict[str, Any], Mapping[str, ArrayHead], memoryview]:
    """Head, what it says of arrays, and body of a message, of which nothing is copied. Raises what `understood` turns into a sentence."""
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
    """Turns what a message that cannot be read raises into a LuxloopError that says what is wrong with it."""
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
