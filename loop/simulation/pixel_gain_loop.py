"""The loop of pixel gains: lights that alternate by a code, what the camera sees of them, and compensation for what has worn."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from torch import Tensor

from luxloop.controllers.pixels.compensation import Compensation
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.simulation.lamps import Lights, ShiningModule, attitude, under
from luxloop.loop.simulation.protocol import Exposure, ExposurePair
from luxloop.perception.camera import CameraParams
from luxloop.perception.egomotion import Ego
from luxloop.perception.pixel_gains import GainEstimator, PixelGainParams, PixelGains, Sight, code, decide, swing
from luxloop.world.frames import View


@dataclass(frozen=True, eq=False)
class GainState:
    """gains, compensations: one a module, the latter empty before the first update. updated_s: time of the last update."""

    gains: tuple[PixelGains, ...]
    compensations: tuple[Compensation, ...] = ()
    updated_s: float = 0.0


@dataclass(frozen=True, eq=False)
class PixelGainLoop:
    """Estimates the gains of the modules' pixels, and compensates for those that have worn."""

    params: PixelGainParams
    modules: tuple[ShiningModule, ...]
    camera: CameraParams
    view: View

    @cached_property
    def estimator(self) -> GainEstimator:
        """The estimator of all modules."""
        return GainEstimator([each.headlight for each in self.modules], self.camera)

    def start(self) -> GainState:
        """The state before the first frame."""
        return GainState(tuple(PixelGains.unknown(each.headlight) for each in self.modules))

    def lights(self, state: GainState, step: int, planned: Lights) -> tuple[Lights, Lights]:
        """Lights of the two frames of a step in place of the planned light."""
        shown = [each.u for each in planned]
        if state.compensations:
            shown = [each.utilisation(u) for each, u in zip(state.compensations, shown, strict=True)]
        codes = [code(each.headlight, k, step) for k, each in enumerate(self.modules)]
        pairs = [swing(u, signs, self.params.swing) for u, signs in zip(shown, codes, strict=True)]
        first, second = (
            tuple(Utilisation(u, each.band) for u, each in zip(lights, planned, strict=True)) for lights in zip(*pairs, strict=True)
        )
        return first, second

    def step(self, state: GainState, pair: ExposurePair, egos: Sequence[Ego | None]) -> GainState:
        """The state after a pair of frames. egos: motion at both, None for a standing car."""
        images = pair.images
        if images is None:
            return state
        on, off = (self._sight(*each) for each in zip(images, (pair.on, pair.off), egos, strict=True))
        way = attitude(None) if egos[0] is None else egos[0].way(pair.off.start_s - pair.on.start_s).double().cpu()
        state = replace(state, gains=self.estimator.look(state.gains, on, off, way))
        if pair.off.start_s - state.updated_s < self.params.update_s:
            return state
        gains = tuple(decide(each, own) for each, own in zip(self.estimator.headlights, state.gains, strict=True))
        made = tuple(Compensation(each.headlight, own.gain) for each, own in zip(self.modules, gains, strict=True))
        return GainState(gains, made, pair.off.start_s)

    def _sight(self, image: Tensor, exposure: Exposure, ego: Ego | None) -> Sight:
        T_ground_body = attitude(ego)
        modules = under(self.modules, exposure.commands)
        poses = [T_ground_body @ each.T_world_module.double().cpu() for each in modules]
        view = replace(self.view, T_world_view=T_ground_body @ self.view.T_world_view)
        return Sight(image[:, :], view, poses, [module.intensity * each.u for module, each in zip(modules, exposure.lights, strict=True)])
