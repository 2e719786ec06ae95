"""Another simulator as a plant, in lockstep over a socket (docs/programs.md): it gets light, and gives frames, samples and objects."""

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RemotePlantParams
from luxloop.loop.simulation.objects import object_of, told_again
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame, Objects
from luxloop.loop.simulation.remote_answers import Answer
from luxloop.loop.simulation.remote_link import Link
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import camera_view, saturation_luminance
from luxloop.perception.egomotion import Sample
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST
from luxloop.world.messages import ArrayBytes, Arrays, raw

Window = tuple[int, int, int, int]  # first row, end row, first column, end column


@dataclass(frozen=True, eq=False)
class RemoteState:
    """What was shown, and which objects were told. shown: number of exposures since the start."""

    shown: int
    objects: Objects | None


@dataclass(frozen=True, eq=False)
class RemotePlant:
    """A simulator behind a link. It holds the world, so that an earlier state cannot be shown again.

    welcome: what the simulator is told first. like: in whose dtype and on whose device frames and samples are.
    """

    link: Link
    welcome: Mapping[str, Any]
    modules: tuple[LampModule, ...]
    sends: Literal["utilisation", "texture"]
    like: Tensor

    def start(self) -> tuple[RemoteState, Arrivals]:
        """What is known before the first exposure, once a simulator is there. Raises LuxloopError where none comes, or it fails."""
        self.link.meet(self.welcome)
        answer, frames = self.link.ask({"type": "start", "number": None})
        return self._came(0, None, answer, frames)

    def show(self, state: RemoteState, exposure: Exposure) -> tuple[RemoteState, Arrivals]:
        """What has come by the end of an exposure. Raises LuxloopError where the simulator fails or goes away, and for an earlier state."""
        if exposure.number != state.shown:
            raise LuxloopError(
                f"exposure {exposure.number} does not follow exposure {state.shown - 1}; a simulator goes on from its own state alone"
            )
        head, arrays = self.parts(exposure)
        answer, frames = self.link.ask(head, arrays)
        return self._came(exposure.number + 1, state.objects, answer, frames)

    def parts(self, exposure: Exposure) -> tuple[dict[str, Any], dict[str, ArrayBytes]]:
        """Head and arrays of the message that shows an exposure."""
        commands, windows, arrays = exposure.commands or (REST,) * len(self.modules), list[Window](), dict[str, ArrayBytes]()
        for k, (module, light, command) in enumerate(zip(self.modules, exposure.lights, commands, strict=True)):
            lamp = module.headlight
            if self.sends == "texture":
                rows = lamp.rows_of(light.band)
                window, part = lit((command.intensity * lamp.light_rows(light.u, rows)).float().cpu().numpy(), rows.start)
            else:
                window, part = lit(light.u.view(lamp.pixel_rows, lamp.pixel_cols).float().cpu().numpy())
            windows.append(window)
            arrays[f"light.{k}"] = raw(part)
        head = {"type": "show", **{name: getattr(exposure, name) for name in ("number", "start_s", "duration_s")}}
        return {**head, "commands": [asdict(each) for each in commands], "windows": windows}, arrays

    def close(self) -> None:
        """Tell the simulator that the run is over."""
        self.link.close()

    def _came(self, shown: int, before: Objects | None, answer: Answer, frames: Arrays) -> tuple[RemoteState, Arrivals]:
        objects = None if answer.objects is None else told_again(before or (), map(object_of, answer.objects), answer.time_s)
        samples = (Sample(each.sensor, each.measured_s, each.arrived_s, self.like.new_tensor(each.values)) for each in answer.samples)
        come = (
            Frame(
                each.number,
                each.taken_s,
                each.arrived_s,
                None if each.lost else torch.from_numpy(frames[f"frame.{each.number}"].astype(np.float32)).to(self.like),
            )
            for each in answer.frames
        )
        return RemoteState(shown, objects), Arrivals(answer.time_s, tuple(come), tuple(samples), objects)


def remote_plant(scenario: Scenario, params: RemotePlantParams, modules: Sequence[LampModule]) -> RemotePlant:
    """The plant of a scenario; nothing is opened before its start. When the plant is collected, its simulator is told that it is over."""
    camera = scenario.camera
    link = Link(params.address, params.timeout_s, (camera.height_px, camera.width_px))
    plant = RemotePlant(link, _welcome(scenario, params, modules), tuple(modules), params.sends, modules[0].headlight.matrix.values)
    weakref.finalize(plant, link.close)
    return plant


def lit(values: np.ndarray, first: int = 0) -> tuple[Window, np.ndarray]:
    """The smallest window that has all of an array `[rows, columns]` that is not 0, and what it has. first: number of the first row."""
    rows, columns = np.flatnonzero(values.any(1)), np.flatnonzero(values.any(0))
    if not len(rows):
        return (0, 0, 0, 0), values[:0, :0]
    top, end, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    return (first + top, first + end, left, right), values[top:end, left:right]


def _welcome(scenario: Scenario, params: RemotePlantParams, modules: Sequence[LampModule]) -> dict[str, Any]:
    camera, view = scenario.camera, camera_view(scenario.camera)
    return {
        "name": scenario.name,
        "sends": params.sends,
        "steps": scenario.steps,
        "rate_hz": scenario.rate_hz,
        "shares": scenario.shares,
        "seed": scenario.seed,
        "camera": {
            **{name: getattr(view, name) for name in ("width", "height", "fx", "fy", "cx", "cy")},
            "bits": camera.bits,
            "gamma": camera.gamma,
            "exposure_s": camera.exposure_s,
            "saturation_cd_m2": saturation_luminance(camera),
            "T_body_camera": view.T_world_view.flatten().tolist(),
        },
        "modules": [_module(each) for each in modules],
        "model": scenario.model_dump(mode="json"),
    }


def _module(module: LampModule) -> dict[str, Any]:
    names = ("rows", "cols", "left", "right", "bottom", "top", "pixel_rows", "pixel_cols", "peak_cd")
    facts = {name: getattr(module.headlight, name) for name in names}
    return {"name": module.name, **facts, "T_body_module": module.T_world_headlight.double().flatten().tolist()}
