"""What has come of one run of a studio."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from luxloop.loop.studio.client.state import State


class Received:
    """The newest of each kind of message, put together. asked: answers `done` and `error` by their `ask`, None where the studio
    could not read it. answers: others by type.
    """

    def __init__(self, run: int) -> None:
        self._run = run
        self.welcome: Mapping[str, Any] = {}
        self.scenario: dict[str, Any] = {}
        self.state: State | None = None
        self.asked, self.answers = dict[int | None, Mapping[str, Any]](), dict[str, Mapping[str, Any]]()
        self.playing, self.steps, self.failed = False, list[int](), ""
        self._rows, self.edits = list[np.ndarray](), 0
        self._light, self._utilisations = dict[str, np.ndarray](), dict[str, np.ndarray]()

    def knows(self, done: Mapping[str, Any]) -> bool:
        """Whether all has come that was so when this was done: runs made anew, and edits."""
        number: int = self.scenario["number"]
        return number > done["number"] or (number == done["number"] and self.edits >= done["edits"][self._run])

    @property
    def facts(self) -> Any:
        """Of the run."""
        return self.scenario["runs"][self._run]

    @property
    def done_steps(self) -> int:
        """How many steps of the run are done."""
        return self.steps[self._run] if self.steps else 0

    @property
    def at_rest(self) -> bool:
        """Whether the newest state is there, and no other one comes by itself."""
        return not self.playing and self.state is not None and self.state.step >= self.done_steps - 1

    def table(self) -> dict[str, np.ndarray]:
        """All rows, by column."""
        columns = [each["name"] for each in self.facts["columns"]]
        rows = np.full((len(self._rows), len(columns)), np.nan, np.float32)
        for k, row in enumerate(self._rows):
            rows[k, : len(row)] = row
        return {name: rows[:, k] for k, name in enumerate(columns)}

    def take(self, head: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """A message has come."""
        kind = head["type"]
        if kind == "welcome":
            self.welcome = head
        elif kind == "scenario":
            self.scenario, self.state = dict(head), None
            self._rows, self._light, self._utilisations, self.edits = [], {}, {}, 0
        elif head.get("run", self._run) != self._run:
            return
        elif kind == "edit":
            self._edited(head)
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
            self.asked[head["ask"]] = head

    def _edited(self, head: Mapping[str, Any]) -> None:
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
