"""What is controlled: utilisations in, frames out. The simulated world is the first plant."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from controllers.ssc import Utilisation
from controllers.symbol.projector import DrawingModule
from perception.camera import CameraParams, average_rows, camera_view, expose, frame_generator
from world.ambient import ambient_luminance
from world.face_source import FaceSource
from world.gbuffer import gbuffer
from world.illumination import Transport, added_light, reach, transport
from world.scene import Scene
from world.shadow import shadow_map

SHADOW_MAP = (1024, 664)  # width, height in px: about 6 cm of road at 17 m
KEPT_VIEWS = 4  # on and off frame, before and after a change

Frames = tuple[Tensor, Tensor]


class Plant(Protocol):
    """Shows utilisations and returns what the camera sees; its state is a value, so that a run can be taken up anywhere."""

    def start(self) -> Any:
        """The plant's state before step 0."""
        ...

    def show(self, state: Any, lights: Sequence[Utilisation], step: int) -> tuple[Any, Frames | None]:
        """Show one utilisation `[n_p]` a module; returns the on and off frames `[height, width]` (digital numbers) that arrive now."""
        ...


@dataclass(frozen=True)
class LitView:
    """A scene as the camera sees it at one time: light transport a module, and luminance `[height, width]` in cd/m^2.

    base: without the lamps. off: with their base beams, as an off frame shows it.
    """

    transports: tuple[Transport, ...]
    base: Tensor
    off: Tensor

    def luminance(self, lights: Sequence[Utilisation]) -> Tensor:
        """Luminance `[..., height, width]` in cd/m^2 of the symbol alone: on minus off, negative where it is darker than the base beams."""
        return added_light(self.transports, lights, self.base - self.off)


class SimulatedPlant:
    """The world in simulation. Its state is the queue of frames that are under way from the camera."""

    def __init__(
        self,
        scene: Scene,
        modules: Sequence[DrawingModule],
        camera: CameraParams,
        source: FaceSource,
        rate_hz: float,
        seed: int,
        device: torch.device,
    ) -> None:
        self.scene, self.modules, self.camera, self.source = scene, tuple(modules), camera, source
        self.period_s, self.seed, self.device = 1 / rate_hz, seed, device
        self.view = camera_view(camera)
        self._lit: OrderedDict[Any, LitView] = OrderedDict()

    def start(self) -> tuple[Frames | None, ...]:
        """As many missing frames as the camera is late."""
        return (None,) * self.camera.latency_steps

    def show(
        self, state: tuple[Frames | None, ...], lights: Sequence[Utilisation], step: int
    ) -> tuple[tuple[Frames | None, ...], Frames | None]:
        """Expose an on frame at the step's time and an off frame half a period later; what moves has moved in between."""
        on_view, off_view = (self.lit(t_s) for t_s in self.exposures(step))
        lit = added_light(on_view.transports, lights, on_view.base)
        on, off = self._expose(lit, step, 0), self._expose(off_view.off.expand(lit.shape), step, 1)
        queue = (*state, None if self._dropped(step) else (on, off))
        return queue[1:], queue[0]

    def exposures(self, step: int) -> tuple[float, float]:
        """Times in s of a step's on and off frame."""
        return step * self.period_s, (step + 0.5) * self.period_s

    def lit(self, t_s: float) -> LitView:
        """The camera's view of the scene at a time; rendered only when geometry has moved."""
        key = self.scene.key_at(t_s)
        if key not in self._lit:
            self._lit[key] = self._render(t_s)
            if len(self._lit) > KEPT_VIEWS:
                self._lit.popitem(last=False)
        self._lit.move_to_end(key)
        return self._lit[key]

    def _render(self, t_s: float) -> LitView:
        triangles, samples = self.scene.at(t_s), self.camera.oversampling
        view = camera_view(self.camera, samples)
        surfaces = gbuffer(triangles, view, self.source.face_ids(triangles, view)).to(self.device)
        transports = []
        for module in self.modules:
            headlight = module.pixel_controller.headlight
            shadow = shadow_map(triangles, headlight.view(module.T_world_headlight, *SHADOW_MAP), self.source).to(self.device)
            transports.append(transport(reach(surfaces, headlight, module.T_world_headlight, shadow), headlight, view.width, samples))
        base = average_rows(ambient_luminance(surfaces, self.scene.ambient_lx, self.scene.street_lamps), samples)
        beams = [Utilisation(module.pixel_controller.default) for module in self.modules]
        return LitView(tuple(transports), base, added_light(transports, beams, base))

    def _expose(self, luminance: Tensor, step: int, frame: int) -> Tensor:
        return expose(luminance, self.camera, frame_generator(self.seed, step, frame, self.device))

    def _dropped(self, step: int) -> bool:
        p = self.camera.drop_probability
        return p > 0 and bool(np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(step, 2))).random() < p)
