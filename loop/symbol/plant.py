"""What is controlled: utilisations in, frames out. `SimulatedPlant` exposes frames of the simulated world."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from controllers.pixels.ssc import Utilisation
from loop.scenario.disturbances import UNDISTURBED, DisturbanceParams
from loop.symbol.world import World
from perception.camera import expose, frame_generator
from perception.egomotion import EXACT, Ego, SensorParams, measured
from perception.glare import glare
from world.light.illumination import added_light

Frames = tuple[Tensor, Tensor]


@dataclass(frozen=True, eq=False)
class SimulatedPlant:
    """The simulated world as a plant. Its state is the queue of frames that are under way from the camera."""

    world: World
    rate_hz: float
    seed: int
    sensors: SensorParams = EXACT
    disturbances: DisturbanceParams = UNDISTURBED

    @property
    def period_s(self) -> float:
        return 1 / self.rate_hz

    def start(self) -> tuple[Frames | None, ...]:
        """As many missing frames as the camera is late."""
        return (None,) * self.world.camera.latency_steps

    def show(
        self, state: tuple[Frames | None, ...], lights: Sequence[Utilisation], step: int
    ) -> tuple[tuple[Frames | None, ...], Frames | None]:
        """Expose an on frame at the step's time and an off frame half a period later; what moves has moved in between."""
        on_view, off_view = (self.world.lit(t_s) for t_s in self.exposures(step))
        lit = added_light(on_view.transports, lights, on_view.base)
        on = self.exposed(lit, on_view.base, step, 0)
        off = self.exposed(off_view.off.expand(lit.shape), off_view.base, step, 1)
        queue = (*state, None if self._dropped(step) else (on, off))
        return queue[1:], queue[0]

    def exposures(self, step: int) -> tuple[float, float]:
        """Times in s of a step's on and off frame."""
        return step * self.period_s, (step + 0.5) * self.period_s

    def ego(self, step: int) -> Ego:
        """What the vehicle's sensors have said of its motion by a step."""
        T_body_view = self.world.view.T_world_view.float().to(self.world.device)
        return measured(self.world.motion, self.sensors, step, self.period_s, self.seed, T_body_view)

    def exposed(self, luminance: Tensor, base: Tensor, step: int, frame: int) -> Tensor:
        """Digital numbers of a step's on frame (0) or off frame (1) of luminance `[..., height, width]` in cd/m^2, with what disturbs it.

        base: `[height, width]` cd/m^2, the part of the luminance that is there without the lamps.
        """
        ambient, noisy = self.disturbances.ambient_factor(step, frame), self.disturbances.noise_factor(step)
        if ambient != 1:
            luminance = luminance + (ambient - 1) * base
        t_s = self.exposures(step)[frame]
        for lamp in self.disturbances.oncoming_in(step, frame):
            luminance = luminance + glare(self.world.view_at(t_s), lamp.position_at(t_s), lamp, self.world.device)
        generator = frame_generator(self.seed, step, frame, self.world.device)
        if noisy == 1:
            return expose(luminance, self.world.camera, generator)
        noise = torch.empty(luminance.shape, dtype=luminance.dtype, device=self.world.device).normal_(std=noisy, generator=generator)
        return expose(luminance, self.world.camera, noise)

    def _dropped(self, step: int) -> bool:
        p = self.disturbances.loss_probability(step, self.world.camera.drop_probability)
        return p > 0 and bool(np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(step, 2))).random() < p)
