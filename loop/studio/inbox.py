"""Decoding of a studio's messages, and a step as `State`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from luxloop.world.messages import LENGTH, ArrayHead, decode

MOST_BYTES = 2**28  # of an array, decoded
Arrays = Mapping[str, np.ndarray]


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Head and arrays of a server's message. Raises ValueError if an array contradicts its head, or is larger than MOST_BYTES."""
    (length,) = LENGTH.unpack_from(data)
    body = memoryview(data)[LENGTH.size + length :]
    head, arrays = json.loads(data[LENGTH.size : LENGTH.size + length]), {}
    for name, each in head.pop("arrays", {}).items():
        array = ArrayHead.model_validate(each)
        if int(array.dtype[1]) * prod(array.shape) > MOST_BYTES:
            raise ValueError(f"array {name} has the shape {list(array.shape)}; arrays have at most {MOST_BYTES} bytes")
        arrays[name] = decode(name, array, bytes(body[array.start : array.start + array.bytes]))
    return head, arrays


@dataclass(frozen=True, eq=False)
class State:
    """A step of a run; contents that were not requested, or do not exist in this step, are empty or None.

    head: plain values, see docs/programs.md. metrics: values of the recording by column, NaN if missing. light: `[rows, columns]` float32
    cd, texture of each module by its name. utilisations: `[rows, columns]` uint8 of each module's pixels, 255 for full utilisation. arrays:
    all others, by name.
    """

    head: Mapping[str, Any]
    metrics: Mapping[str, float]
    light: Arrays
    utilisations: Arrays
    arrays: Arrays

    @property
    def step(self) -> int:
        """Number of the step, from 0."""
        return int(self.head["step"])

    @property
    def time_s(self) -> float:
        """Start of the step in s."""
        return float(self.head["time_s"])

    @property
    def frames(self) -> tuple[np.ndarray, ...]:
        """Digital numbers `[height, width]` of the frames that arrived in this step: with all light, and, if symbols are held, without
        them.
        """
        return tuple(self.arrays[name] for name in ("frames.on", "frames.off") if name in self.arrays)

    @property
    def depth(self) -> np.ndarray | None:
        """Depth `[height, width]` float32 m along the camera's axis, 0 without an object."""
        return self.arrays.get("depth")

    @property
    def instances(self) -> np.ndarray | None:
        """Instance at each pixel, `[height, width]` uint16: an index in `instance_names`."""
        return self.arrays.get("instances")

    @property
    def instance_names(self) -> list[str]:
        """Names of the instances; the first, "", is none, the second the road."""
        return list(self.head.get("instances", ()))

    @property
    def materials(self) -> np.ndarray | None:
        """Material at each pixel, `[height, width]` uint8: an index in `material_names`."""
        return self.arrays.get("materials")

    @property
    def material_names(self) -> list[str]:
        """Names of the materials; the first, "", is none."""
        return list(self.head.get("materials", ()))

    @property
    def objects(self) -> list[Mapping[str, Any]]:
        """Truth of all objects: `name`, `category`, `instance` (its index in `instance_names`), `T_world_object` (16 numbers, row by row),
        `size_m`, `box` (left, top, right, bottom in px of its visible part, None if hidden) and `visible` (visible share).
        """
        return list(self.head.get("truth", ()))


class Inbox:
    """Newest message of each type, combined.

    replies: answers `done` and `error` by their `ask`, None for a message that the studio could not read. answers: others by type.
    """

    def __init__(self, run: int) -> None:
        self._run = run
        self.welcome: Mapping[str, Any] = {}
        self.scenario: dict[str, Any] = {}
        self.state: State | None = None
        self.replies, self.answers = dict[int | None, Mapping[str, Any]](), dict[str, Mapping[str, Any]]()
        self.playing, self.steps, self.failed = False, list[int](), ""
        self._rows, self.edits = list[np.ndarray](), 0
        self._light, self._utilisations = dict[str, np.ndarray](), dict[str, np.ndarray]()

    def knows(self, done: Mapping[str, Any]) -> bool:
        """Whether everything that preceded an answer has arrived: new runs, and edits."""
        number: int = self.scenario["number"]
        return number > done["number"] or (number == done["number"] and self.edits >= done["edits"][self._run])

    @property
    def facts(self) -> Any:
        """Facts of the run."""
        return self.scenario["runs"][self._run]

    @property
    def done_steps(self) -> int:
        """Number of the run's steps."""
        return self.steps[self._run] if self.steps else 0

    @property
    def at_rest(self) -> bool:
        """Whether the newest state has arrived, and none follows by itself."""
        return not self.playing and self.state is not None and self.state.step >= self.done_steps - 1

    def table(self) -> dict[str, np.ndarray]:
        """Rows of all steps, by column."""
        columns = [each["name"] for each in self.facts["columns"]]
        rows = np.full((len(self._rows), len(columns)), np.nan, np.float32)
        for k, row in enumerate(self._rows):
            rows[k, : len(row)] = row
        return {name: rows[:, k] for k, name in enumerate(columns)}

    def take(self, head: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Take a message."""
        kind = head["type"]
        if kind == "welcome":
            self.welcome = head
        elif kind == "scenario":
            self.scenario, self.state = dict(head), None
            self._rows, self._light, self._utilisations, self.edits = [], {}, {}, 0
        elif head.get("run", self._run) != self._run:
            return
        elif kind == "edit":
            self._edit(head)
        elif kind == "rows":
            self._rows[head["first"] :] = list(arrays["rows"])
        elif kind == "step":
            self.state = self._state(head, arrays)
        elif kind in ("status", "done"):
            self.playing, self.steps = head.get("playing", self.playing), head["steps"]
            self.failed = head.get("failed", self.failed) or ""
        elif kind != "error":
            self.answers[kind] = head
        if kind in ("done", "error"):
            self.replies[head["ask"]] = head

    def _edit(self, head: Mapping[str, Any]) -> None:
        self.edits += 1
        if head["facts"] is not None:
            runs = list(self.scenario["runs"])
            runs[self._run] = head["facts"]
            self.scenario = {**self.scenario, "runs": runs, "model": head["model"], "steps": head["model"]["steps"]}

    def _state(self, head: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> State:
        others = dict(arrays)
        for k, module in enumerate(self.facts["modules"]):
            name = module["name"]
            if (window := head["light_windows"].get(str(k))) is not None:
                top, bottom, left, right = window
                size, before = (module["rows"], module["cols"]), self._light.get(name)
                texture = np.zeros(size, np.float32) if before is None or before.shape != size else before.copy()
                texture[top:bottom, left:right] = others.pop(f"light.{k}").astype(np.float32) * np.float32(head["modules"][k]["scale_cd"])
                self._light[name] = texture
            if (u := others.pop(f"u.{k}", None)) is not None:
                self._utilisations[name] = u
        names, number = [each["name"] for each in self.facts["columns"]], head["step"]
        row = self._rows[number] if number < len(self._rows) else ()
        return State(head, dict(zip(names, map(float, row), strict=False)), {**self._light}, {**self._utilisations}, others)
