"""The scenario's scene as imaged by the lens under a frame of light; cached until something changes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.rig.arrays import Image
from luxloop.loop.rig.simulated.faults import FaultParams, LampErrorParams, ScreenParams
from luxloop.loop.rig.simulated.lens import Lens
from luxloop.loop.rig.wire.ddp import Codes, LightFrame, utilisations_of
from luxloop.loop.scenario.disturbances import AimParams, PoseErrorParams, WearParams
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.lamps import lamp_modules, mount
from luxloop.loop.simulation.simulated import simulated_plant
from luxloop.loop.simulation.truth import LampModule, true_modules
from luxloop.loop.simulation.world import LitScene, World
from luxloop.world.caches import keeping
from luxloop.world.frames import unit
from luxloop.world.headlight.lamp import REST, Commands
from luxloop.world.light.soiling import SoilingParams

KEPT = 8  # cached images of lights, since on and off frames alternate
STUCK_KEY = 1  # generator key of stuck pixels


class RigScene:
    """A scene as imaged by the true lens, without exposure.

    modules: the true lamps. camera: of the sensor behind the lens.
    """

    def __init__(self, scenario: Scenario, faults: FaultParams) -> None:
        """Build the scene. Raises LuxloopError if a file is missing or damaged, or the lens folds the picture."""
        world = simulated_plant(scenario, lamp_modules(mount(scenario.headlight))).world
        self.modules = _true(world.modules, faults)
        self.camera, self.gamma, self.screen = world.camera, faults.light.gamma, faults.screen
        self.lens, self.columns = Lens.of(faults.lens, world.camera), faults.camera.columns
        self.world = World(world.scene, self.modules, self.lens.camera, world.source, world.motion, False, world.given)
        view, columns = self.world.view, self.columns
        self.world.view = replace(view, width=columns * view.width, fx=columns * view.fx, cx=columns * view.cx)
        self._stuck = tuple(_stuck(each, faults.lamp, faults.seed, k) for k, each in enumerate(self.modules))
        self._lit = dict[bool, _Lit]()  # by whether modules are turned

    @property
    def pixels(self) -> int:
        """Number of pixels of all modules."""
        return sum(each.headlight.n_pixels for each in self.modules)

    def base(self, time_s: float) -> Image:
        """Image `[height, width]` in cd/m^2 of all light but the lamps'. time_s: since the start of the drive."""
        return self._at(time_s, False).base

    def light(self, light: LightFrame, time_s: float) -> Image:
        """Image `[height, width]` in cd/m^2 of the lamps' light alone."""
        given = (light.commands or ())[: len(self.modules)]
        rest = [REST] * (len(self.modules) - len(given))  # of modules without commands
        commands = () if all(each == REST for each in given) else (*given, *rest)
        return self._at(time_s, bool(commands)).image(light.codes.tobytes(), light.codes.dtype.char, commands)

    def _at(self, time_s: float, turned: bool) -> "_Lit":
        scene = self.world.lit(time_s, direct=turned)
        if turned not in self._lit or self._lit[turned].scene is not scene:
            self._lit[turned] = _Lit(scene, self.lens, self.columns, self._gloss(scene), self._utilisations)
        return self._lit[turned]

    def _utilisations(self, codes: Codes) -> list[Tensor]:
        """Utilisations `[n_p]` of each module, with stuck pixels fully on."""
        parts = torch.from_numpy(utilisations_of(codes, self.gamma)).split([each.headlight.n_pixels for each in self.modules])
        return [part.index_fill(0, stuck, 1.0) for part, stuck in zip(parts, self._stuck, strict=True)]

    def _gloss(self, scene: LitScene) -> Tensor | None:
        """Luminance of the glossy screen relative to a diffuse one, `[height, width]`; None without gloss."""
        if not self.screen.gloss:
            return None
        T_world_body = scene.vehicle.T_world_body
        lamp = torch.stack([(T_world_body @ each.T_body_headlight.to(T_world_body))[:3, 3] for each in self.modules]).mean(0)
        return gloss(self.screen, scene.surfaces.position, scene.surfaces.normal, lamp, scene.view.origin)


@dataclass(eq=False)
class _Lit:
    """A scene at one time, and images of the last lights in it.

    columns: samples over a pixel's width. factor: relative luminance of each sample `[height, columns * width]`, None without gloss.
    utilisations: from codes to utilisations.
    """

    scene: LitScene
    lens: Lens
    columns: int
    factor: Tensor | None
    utilisations: Callable[[Codes], list[Tensor]]

    def __post_init__(self) -> None:
        base = self.scene.base.float().unflatten(1, (-1, self.columns)).mean(2)
        self.base = self.lens.image(base.numpy())
        self.image = keeping(KEPT, self._image)

    def _image(self, codes: bytes, kind: str, commands: Commands) -> Image:
        """Image `[height, width]` in cd/m^2 of the lamps' light alone. kind: dtype of the codes."""
        lights, camera = self.utilisations(np.frombuffer(codes, kind)), self.lens.camera
        luminance = torch.zeros(camera.height_px, camera.width_px)
        for number, (u, command) in enumerate(zip(lights, commands or [REST] * len(lights), strict=True)):
            added, sample = self.scene.transported(number, command).luminance(u)
            if self.factor is not None:
                added = added * self.factor.flatten()[sample]
            luminance.view(-1).index_add_(0, sample // self.columns, added, alpha=command.intensity / self.columns)
        if self.scene.backscatter is not None:
            air = torch.as_tensor(self.scene.backscattered([Utilisation(u) for u in lights], commands))
            luminance += air.expand_as(self.scene.base).unflatten(1, (-1, self.columns)).mean(2)
        return self.lens.image(luminance.numpy())


def gloss(params: ScreenParams, position: Tensor, normal: Tensor, lamp: Tensor, eye: Tensor) -> Tensor:
    """Luminance of a glossy surface relative to a diffuse one, `[height, width]`.

    position, normal: `[3, height, width]` m. lamp, eye: `[3]` m.
    """
    to_lamp, to_eye = (unit(each.to(position)[:, None, None] - position) for each in (lamp, eye))
    cos = (unit(to_lamp + to_eye) * normal).sum(0).clamp(-1, 1)
    return 1 + params.gloss * (-(torch.rad2deg(cos.acos()) / params.gloss_width_deg).square()).exp()


def _true(modules: Sequence[LampModule], faults: FaultParams) -> tuple[LampModule, ...]:
    error = faults.lamp
    aim = AimParams(**{name: getattr(error, name) for name in PoseErrorParams.model_fields})
    scaled = (replace(each, headlight=each.headlight.scale(error.scale)) for each in modules)
    return true_modules(scaled, (aim,), WearParams(dead=error.dead, seed=faults.seed), SoilingParams())


def _stuck(module: LampModule, error: LampErrorParams, seed: int, number: int) -> Tensor:
    """Numbers of a module's stuck pixels."""
    n = module.headlight.n_pixels
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, STUCK_KEY))).permutation(n)
    return torch.from_numpy(np.sort(order[: round(error.stuck * n)]))
