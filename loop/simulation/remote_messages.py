"""Messages from an external simulator as plant (docs/programs.md), validated within strict limits."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any, Final, Literal

import numpy as np
import torch
from pydantic import AfterValidator, Field, TypeAdapter

from luxloop.controllers.situation import TrackedObject
from luxloop.loop.simulation.protocol import Objects
from luxloop.perception.egomotion import Sensor
from luxloop.world.frames import is_rigid
from luxloop.world.messages import LARGEST_HEAD, LENGTH, Arrays, given_arrays, understood, unpack
from luxloop.world.params import Params
from luxloop.world.traffic.tracked import Category

PROTOCOL: Final = 1
MOST_FRAMES: Final = 8  # frames in an answer
MOST_ITEMS: Final = 1000  # samples or objects in an answer
MOST_VALUES: Final = 64  # values of a sample

ROUNDING: Final = 1e-3  # tolerance of a rotation matrix in single precision or with four digits
FARTHEST_M: Final = 10_000

Number = Annotated[int, Field(ge=0, lt=2**53)]
Text = Annotated[str, Field(max_length=4000)]
Seconds = Annotated[float, Field(ge=-1e10, le=1e10)]  # of a clock that may count from 1970
Value = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]  # m, rad, and their rates
Side = Annotated[float, Field(gt=0, le=1000)]  # m


def _rigid(numbers: tuple[float, ...]) -> tuple[float, ...]:
    T = np.array(numbers).reshape(4, 4)
    if not is_rigid(T, ROUNDING):
        raise ValueError("is no pose; give a rotation and a translation in m, row by row, and 0, 0, 0, 1")
    if np.abs(T[:3, 3]).max() > FARTHEST_M:
        raise ValueError(f"lies farther away than {FARTHEST_M} m; give metres")
    return numbers


Pose = Annotated[tuple[float, ...], Field(min_length=16, max_length=16), AfterValidator(_rigid)]  # row by row


class Hello(Params):
    """The first message. name: of the simulator in error messages."""

    type: Literal["hello"]
    protocol: int
    name: Annotated[str, Field(max_length=80)] = "simulator"


class FrameHead(Params):
    """A frame; unless lost, its digital numbers are the array `frame.NUMBER`. number: of its exposure. Times by the simulator's clock."""

    number: Number
    taken_s: Seconds = 0.0
    arrived_s: Seconds = 0.0
    lost: bool = False


class SampleHead(Params):
    """A sample of a vehicle sensor, as `luxloop.perception.egomotion.Sample`."""

    sensor: Sensor
    measured_s: Seconds
    arrived_s: Seconds
    values: Annotated[tuple[Value, ...], Field(min_length=1, max_length=MOST_VALUES)]


class ObjectHead(Params):
    """An object at the answer's time. T_ground_object: pose of its box in the ground frame, with the origin at the centre of the box's
    base. size_m: length, width, height.
    """

    name: Annotated[str, Field(min_length=1, max_length=80)]
    category: Category
    T_ground_object: Pose
    size_m: tuple[Side, Side, Side]


class Answer(Params):
    """The answer to `start` (number None) or to the exposure with this number. objects: all present objects, None without a report."""

    type: Literal["arrivals"]
    number: Number | None
    time_s: Seconds
    frames: Annotated[tuple[FrameHead, ...], Field(max_length=MOST_FRAMES)] = ()
    samples: Annotated[tuple[SampleHead, ...], Field(max_length=MOST_ITEMS)] = ()
    objects: Annotated[tuple[ObjectHead, ...], Field(max_length=MOST_ITEMS)] | None = None


class Failure(Params):
    """The simulator cannot go on."""

    type: Literal["error"]
    text: Text


Message = Hello | Answer | Failure
MESSAGE: Final[TypeAdapter[Message]] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def largest(size: tuple[int, int]) -> int:
    """Size of the largest message in bytes. size: height and width of a frame."""
    return LENGTH.size + LARGEST_HEAD + MOST_FRAMES * 2 * size[0] * size[1]


def read(data: bytes | str, size: tuple[int, int]) -> tuple[Message, Arrays]:
    """A message, and digital numbers `[height, width]` of its frames by name. Raises LuxloopError for an invalid message."""
    with understood():
        head, heads, body = unpack(data)
        message = MESSAGE.validate_python(head)
        frames = [each for each in message.frames if not each.lost] if isinstance(message, Answer) else []
        wanted: Mapping[str, Any] = {f"frame.{each.number}": ("u1", "u2") for each in frames}
        for name, each in heads.items():
            if each.shape != size:
                raise ValueError(f"array {name} has the shape {list(each.shape)}, but frames have {list(size)}, as the welcome says")
        return message, given_arrays(heads, body, wanted, 2 * size[0] * size[1])


LINGER_S: Final = 5.0  # time for which a vanished object stays, so that functions can fade out


class ObjectRow(ObjectHead):
    """An object in a recording; None stands for values that are not finite."""

    since_s: float | None
    until_s: float | None
    confidence: float
    score: float | None


ROWS: Final = TypeAdapter(tuple[ObjectRow, ...])


def track_objects(before: Iterable[TrackedObject], told: Iterable[TrackedObject], time_s: float) -> Objects:
    """Objects reported at a time, and earlier ones for LINGER_S after their last report. A vanished object reported again is a new one."""
    known = {each.name: each for each in before}
    there = [replace(each, since_s=_since(known.get(each.name), time_s)) for each in told]
    gone = [replace(known[name], until_s=min(known[name].until_s, time_s)) for name in known.keys() - {each.name for each in there}]
    return (*there, *(each for each in gone if time_s - each.until_s < LINGER_S))


def object_of(head: ObjectHead) -> TrackedObject:
    """The object of a message or a row."""
    T_ground_object = torch.tensor(head.T_ground_object, dtype=torch.float64).view(4, 4)
    return TrackedObject(head.name, head.category, T_ground_object, head.size_m)


def object_values(objects: Objects | None) -> str | None:
    """Objects as JSON for a row of a recording."""
    return None if objects is None else ROWS.dump_json(tuple(map(row_of, objects))).decode()


def read_objects(text: str | None) -> Objects | None:
    """The objects of a row. Raises ValueError for invalid JSON."""
    return None if text is None else tuple(map(_object, ROWS.validate_json(text)))


def _since(known: TrackedObject | None, time_s: float) -> float:
    return time_s if known is None or known.until_s <= time_s else known.since_s


def row_of(each: TrackedObject) -> ObjectRow:
    """An object as a row of a recording. Raises ValidationError for an invalid object."""
    values = {name: value if math.isfinite(value := getattr(each, name)) else None for name in ("since_s", "until_s", "score")}
    pose = tuple(each.T_world_object.flatten().tolist())
    return ObjectRow(name=each.name, category=each.category, T_ground_object=pose, size_m=each.size_m, confidence=each.confidence, **values)


def _object(row: ObjectRow) -> TrackedObject:
    since_s, until_s = -math.inf if row.since_s is None else row.since_s, math.inf if row.until_s is None else row.until_s
    score = math.nan if row.score is None else row.score
    return replace(object_of(row), since_s=since_s, until_s=until_s, confidence=row.confidence, score=score)
