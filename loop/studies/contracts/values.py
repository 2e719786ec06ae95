"""Pure calls: a state is data, arguments stay unchanged, and the same arguments give the same bits."""

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor

from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import validate
from luxloop.loop.scenario.overrides import overridden
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.caches import PartialImage
from luxloop.world.errors import LuxloopError
from luxloop.world.plugin import Guard, Name, check_methods

DATA = (Tensor, np.ndarray, np.generic, bool, int, float, complex, str, bytes, type(None), Enum, Path, torch.device, torch.dtype)
Part = TypeVar("Part")
Parts = dict[str, Any]  # leaves of a value by their path, such as "state.gains[0]"


@lru_cache(1)  # half a gigabyte; calls for the same world are consecutive
def world(scenario: str, device: str, *overrides: str) -> Simulation:
    """Small simulated world of a contract. scenario: TOML. overrides: changes of its keys, as KEY=VALUE."""
    data = tomllib.loads(scenario)
    return prepare(validate(overridden(data, overrides), data["name"]), device)


def name_of(made_by: type) -> Name:
    """Name of a class in a scenario. Raises LuxloopError if it is no class."""
    if not isinstance(made_by, type):
        raise LuxloopError(f"{made_by!r} is not a class; give the class itself, such as Mine, and its options as a second value")
    return Name(f"{made_by.__module__}:{made_by.__name__}")


def build_part(made_by: type, key: str, calls: Mapping[str, tuple[str, ...]], make: Callable[[Name], Part]) -> Part:
    """Part that `make` builds from a class's name: a guarded part, or a wrapper with one as `own`.

    key: of the scenario, for messages. calls: arguments of each method, by its name. Raises LuxloopError if it is no class, lacks a method,
    cannot be made, or takes other arguments.
    """
    name = name_of(made_by)
    check_methods(made_by, f"{key}: {name}", tuple(calls))
    part = make(name)
    check_calls(part if isinstance(part, Guard) else part.own, calls)  # type: ignore[attr-defined]
    return part


def check_calls(own: Guard, calls: Mapping[str, tuple[str, ...]]) -> None:
    """Raise LuxloopError if a method does not take the arguments of its calls."""
    for method, values in calls.items():
        takes = signature(getattr(own.part, method))
        try:
            takes.bind(*values)
        except TypeError as error:
            called = f"{method}({', '.join(values)})"
            raise LuxloopError(f"{own.key}: {own.name}: {method} takes {takes}, but is called as {called}; let it take these") from error


def pure_state(own: Guard, method: str, inputs: Mapping[str, Any]) -> Any:
    """State from a method, called as by `pure`. Raises LuxloopError as `pure`, and if the state is no data."""
    state = pure(own, method, inputs, "state")
    check_state(own, method, state)
    return state


def pure(own: Guard, method: str, inputs: Mapping[str, Any], gives: str) -> Any:
    """Result of a method. gives: name of the result.

    Raises LuxloopError if the method changes an argument, or gives different results for the same arguments.
    """
    where, call = f"{own.key}: {own.name}: {method}", getattr(own, method)
    before = copy_parts(inputs)
    result = call(*inputs.values())
    if changed := difference(before, inputs):
        raise LuxloopError(
            f"{where} changes {changed}, which was passed to it; make a new value, with dataclasses.replace and without operations in place"
        )
    first = copy_parts(result, gives)
    again = call(*inputs.values())
    if changed := difference(first, result, gives):
        raise LuxloopError(f"{where} changes {changed}, which it returned before, when it is called again; return a copy, with clone()")
    if differs := difference(first, again, gives):
        given = " and ".join(inputs)
        remedy = "keep what it remembers in the state and not in self" if "state" in (*inputs, gives) else "keep nothing in self"
        raise LuxloopError(
            f"{where} gives another {differs} when it is called again with the same {given}; {remedy}, and seed random numbers anew"
        )
    return result


def check_state(own: Guard, method: str, state: Any) -> None:
    """Raise LuxloopError if a state holds anything but data, and so cannot be saved and restored."""
    for place, part in _parts(state, "state"):
        if not isinstance(part, DATA):
            raise LuxloopError(
                f"{own.key}: {own.name}: {method} gives a state that cannot be saved: {place} is {_kind(part)}; "
                "make the state a frozen dataclass of tensors and numbers, and keep what never changes in self"
            )


def check_tensor(value: Any, like: Tensor, shape: tuple[int, ...], what: str) -> None:
    """Raise LuxloopError if a value is no finite tensor of a shape, and of the dtype and device of another tensor."""
    wanted = f"a tensor {_description(like.dtype, shape, like.device)}"
    if not isinstance(value, Tensor):
        raise LuxloopError(f"{what} is {_kind(value)}; it must be {wanted}")
    given = _description(value.dtype, tuple(value.shape), value.device)
    if f"a tensor {given}" != wanted:
        remedy = "check its dimensions" if value.shape != shape else "make it from a tensor that is given, with new_tensor(...)"
        raise LuxloopError(f"{what} is {given}; it must be {wanted}: {remedy}")
    if lost := int((~value.isfinite()).sum()):
        where = value.tolist() if value.numel() <= 4 else f"in {lost} of {value.numel()} places"
        raise LuxloopError(
            f"{what} is not finite, {where}; errors are NaN where the symbol is not seen: leave the state as it is where "
            "observation.measurement.code != ExtractionStatus.SEEN; attitude and rates of an Ego are NaN where they are not measured: "
            "use nan_to_num()"
        )


def _description(dtype: torch.dtype, shape: tuple[int, ...], device: torch.device) -> str:
    return f"{str(dtype).removeprefix('torch.')} {list(shape)} on {device}"


def _kind(value: Any) -> str:
    return "None" if value is None else f"of the type {type(value).__name__}"


def _parts(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Leaves of a value with their paths; anything but a known container is a leaf."""
    inner: Mapping[Any, Any] | None = None
    if is_dataclass(value) and not isinstance(value, type):
        inner = {f".{field.name}": getattr(value, field.name) for field in fields(value)}
    elif isinstance(value, BaseModel):
        inner = {f".{name}": each for name, each in value}
    elif isinstance(value, Mapping):
        inner = {f".{name}" if place else name: each for name, each in value.items()}
    elif isinstance(value, slice):
        inner = {f".{name}": getattr(value, name) for name in ("start", "stop", "step")}
    elif isinstance(value, tuple | list):
        inner = {f"[{number}]": each for number, each in enumerate(value)}
    if inner is None:
        yield place, value[:, :] if isinstance(value, PartialImage) else value
    else:
        for name, each in inner.items():
            yield from _parts(each, f"{place}{name}")


def copy_parts(value: Any, place: str = "") -> Parts:
    """Copies of a value's leaves. place: name of the value."""
    return {
        name: part.clone() if isinstance(part, Tensor) else part.copy() if isinstance(part, np.ndarray) else part
        for name, part in _parts(value, place)
    }


def difference(before: Parts, value: Any, place: str = "") -> str | None:
    """Path of the first leaf that differs from earlier copies, None if all agree. place: name of the value."""
    after = dict(_parts(value, place))
    return next((name for name in before | after if not (name in before and name in after and _same(before[name], after[name]))), None)


def _same(a: Any, b: Any) -> bool:
    """Whether two leaves agree bit for bit; NaN equals NaN."""
    if type(a) is not type(b):
        return False
    if not isinstance(a, Tensor | np.ndarray):
        return not isinstance(a, DATA) or a is b or bool(a == b) or bool(a != a and b != b)
    return a.dtype == b.dtype and a.shape == b.shape and bool(((a == b) | ((a != a) & (b != b))).all())
