"""Whether a single run whose symbol reaches the end of the footprint would find a road other than the plane z = 0.

It then draws for that road (`luxloop.controllers.symbol.stages`), as no copy of a batch does.
"""

import torch
from torch import Tensor

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.controllers.symbol.stages import SURE
from luxloop.loop.studies.batch.copies import Copies, Light
from luxloop.loop.studies.batch.looking import Taken
from luxloop.perception.camera import expose
from luxloop.perception.noise import FrameNoise


def finds_another_road(copies: Copies, light: Light, k: int, taken: Taken) -> bool:
    """Whether the k-th copy finds another road in its frames, as `Lifting` decides."""
    sensor = copies.sensor
    found = sensor.relocalise(_frames(copies, light, k, taken), _lights(copies, light, k))
    risen = found.shape[0].abs() > sensor.params.footprint_margin_m
    return bool(found.match > SURE) and bool(found.found) and bool(risen)


def _lights(copies: Copies, light: Light, k: int) -> list[Utilisation]:
    """Utilisations `[n_p]` of the modules that draw."""
    whole = []
    for drawn, pixels, resting in zip(light.drawn[k], light.pixels, copies.projector.resting, strict=True):
        whole.append(Utilisation(drawn if pixels is None else torch.zeros_like(resting.u).index_copy_(0, pixels, drawn)))
    return whole


def _frames(copies: Copies, light: Light, k: int, taken: Taken) -> tuple[Tensor, Tensor]:
    """On and off frame `[height, width]`, digital numbers."""
    camera, base = copies.simulation.scenario.camera, copies.view.base
    on = copies.rest.clone()
    on[light.crop.slices] += light.added[k]
    noisy = taken.disturbances.noise_factor(taken.step)
    found = []
    for number, luminance in enumerate((on, copies.rest)):
        ambient = taken.disturbances.ambient_factor(taken.step, number)
        noise = noisy * FrameNoise.of(taken.seed, taken.step, number).part((slice(0, base.shape[0]), slice(0, base.shape[1])), base)
        found.append(expose(luminance if ambient == 1 else luminance + (ambient - 1) * base, camera, noise))
    return found[0], found[1]
