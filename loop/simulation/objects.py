"""Objects that a plant tells of: since when they are there, and until when those were that it tells of no more; as text in a recording."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import torch
from pydantic import TypeAdapter

from luxloop.controllers.situation import TrackedObject
from luxloop.loop.simulation.protocol import Objects
from luxloop.loop.simulation.remote_answers import ObjectHead

LINGER_S: Final = 5.0  # for which an object that is gone stays, while functions fade out


class ObjectRow(ObjectHead):
    """An object in a recording; values that are not finite are None."""

    since_s: float | None
    until_s: float | None
    confidence: float
    score: float | None


ROWS: Final = TypeAdapter(tuple[ObjectRow, ...])


def told_again(before: Iterable[TrackedObject], told: Iterable[TrackedObject], time_s: float) -> Objects:
    """The objects that are told of at a time, and those of before that are gone and linger. One that comes again is a new one."""
    known = {each.name: each for each in before}
    there = [replace(each, since_s=_since(known.get(each.name), time_s)) for each in told]
    gone = [replace(known[name], until_s=min(known[name].until_s, time_s)) for name in known.keys() - {each.name for each in there}]
    return (*there, *(each for each in gone if time_s - each.until_s < LINGER_S))


def object_of(head: ObjectHead) -> TrackedObject:
    """The object of a message or a row."""
    T_ground_object = torch.tensor(head.T_ground_object, dtype=torch.float64).view(4, 4)
    return TrackedObject(head.name, head.category, T_ground_object, head.size_m)


def object_values(objects: Objects | None) -> str | None:
    """Objects as a row of a recording holds them."""
    return None if objects is None else ROWS.dump_json(tuple(map(row_of, objects))).decode()


def read_objects(text: str | None) -> Objects | None:
    """The objects of a row. Raises ValueError for anything else."""
    return None if text is None else tuple(map(_object, ROWS.validate_json(text)))


def _since(known: TrackedObject | None, time_s: float) -> float:
    return time_s if known is None or known.until_s <= time_s else known.since_s


def row_of(each: TrackedObject) -> ObjectRow:
    """An object as a recording holds it. Raises ValidationError where it is none that can be there."""
    values = {name: value if math.isfinite(value := getattr(each, name)) else None for name in ("since_s", "until_s", "score")}
    pose = tuple(each.T_world_object.flatten().tolist())
    return ObjectRow(name=each.name, category=each.category, T_ground_object=pose, size_m=each.size_m, confidence=each.confidence, **values)


def _object(row: ObjectRow) -> TrackedObject:
    since_s, until_s = -math.inf if row.since_s is None else row.since_s, math.inf if row.until_s is None else row.until_s
    score = math.nan if row.score is None else row.score
    return replace(object_of(row), since_s=since_s, until_s=until_s, confidence=row.confidence, score=score)
