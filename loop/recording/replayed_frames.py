"""Frames that a recording kept, by the step in which they came."""

from collections import defaultdict
from pathlib import Path

import torch
from torch import Tensor

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.frames import TABLE, image_file, read_exposures, read_image
from luxloop.loop.simulation.recorded import inside
from luxloop.world.errors import LuxloopError


class KeptFrames:
    """Those of a folder, in which there may be none."""

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        """scenario: that was recorded. Raises LuxloopError where the table of frames is damaged."""
        self._folder, self._camera, per_step = folder, scenario.camera, len(scenario.shares)
        self._numbers = defaultdict[int, dict[str, int]](dict)
        for each in read_exposures(inside(folder / TABLE, folder)) if (folder / TABLE).is_file() else ():
            if each["came_with"] is not None and not each["lost"]:
                self._numbers[each["came_with"] // per_step]["off" if each["number"] % per_step else "on"] = each["number"]

    def at(self, step: int) -> dict[str, Tensor]:
        """Digital numbers `[height, width]` of the newest frames `on` and `off` that came in a step; without those that are damaged."""
        found = {}
        for name, number in self._numbers.get(step, {}).items():
            try:
                found[name] = read_image(inside(image_file(self._folder, number), self._folder), self._camera, torch.empty(0))
            except LuxloopError:
                continue
        return found
