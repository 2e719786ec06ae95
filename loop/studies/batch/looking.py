"""Measurements of a symbol in the frames of many copies, each in its own footprint, as `SymbolSensor` does for one."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from luxloop.controllers.symbol.sensing.flat_model import Eye
from luxloop.controllers.symbol.sensing.symbol_sensor import ENDS, LIT, Measurement, SymbolSensor
from luxloop.loop.scenario.disturbances import UNDISTURBED, DisturbanceParams
from luxloop.loop.studies.batch.noise import normal
from luxloop.loop.studies.batch.windows import Windows
from luxloop.perception.appearance import Appearance, Axes, appearance, area
from luxloop.perception.birdseye import rectify
from luxloop.perception.camera import CameraParams, expose, luminance_of
from luxloop.perception.extraction import Extraction, OwnExtractionParams, gate, noise_limit, symbol_image
from luxloop.perception.noise import FrameNoise

DARK = -1e30  # contrast beside a crop: below every threshold, and finite, as infinities have no gradients


@dataclass(frozen=True)
class Taken:
    """The frames of a copy: their seed, step and the scenario's disturbances."""

    seed: int
    step: int
    disturbances: DisturbanceParams = UNDISTURBED


@dataclass(frozen=True, eq=False)
class Scene:
    """Luminances in cd/m^2 of windows, `[B, height, width]`.

    added: by the symbols. resting: of all else. base: without the lamps. flat: what the symbols would add on the flat road that the
    controller assumes. limit: threshold of extraction there.
    """

    windows: Windows
    added: Tensor
    resting: Tensor
    base: Tensor
    flat: Tensor
    limit: Tensor

    def __getitem__(self, part: slice) -> "Scene":
        """Some of the copies."""
        return Scene(*(each[part] for each in vars(self).values()))


def look(sensor: SymbolSensor, scene: Scene, camera: CameraParams, frames: Sequence[Taken], quantise: bool) -> Measurement:
    """Measurements `[B]` of all copies. quantise: False leaves digital numbers unrounded, for gradients."""
    windows, eye = scene.windows, sensor.model.eye
    inside = windows.inside(scene.added.device)
    on, off = (
        luminance_of(_exposed(light, scene, camera, frames, number, quantise), camera)
        for number, light in enumerate((scene.resting + scene.added, scene.resting))
    )
    limit = noise_limit(_mean_around(off, inside), camera, sensor.params)
    symbol = _symbols(on - off, limit, inside, windows, sensor.params)
    seen = appearance(*_in_axes(eye, symbol, windows))
    expected = area(*_in_axes(eye, _symbols(scene.flat, scene.limit, inside, windows, sensor.params), windows))
    ratio = torch.where(torch.tensor(windows.empty, device=expected.device), 0.0, seen.area / expected)
    error = eye.features(seen) - sensor.model.target
    return Measurement(gate(seen.area, expected, sensor.params), error, sensor.pose_error(error), ratio, seen, symbol, windows.hull)


def joined(parts: Sequence[Measurement]) -> Measurement:
    """Measurements of some copies and of the following ones as one."""

    def all_of(name: str) -> Tensor:
        return torch.cat([getattr(each, name) for each in parts])

    appearances = zip(*(vars(each.appearance).values() for each in parts), strict=True)
    return Measurement(
        all_of("code"),
        all_of("errors"),
        all_of("pose_error"),
        all_of("area_ratio"),
        Appearance(*map(torch.cat, appearances)),
        all_of("symbol"),
        parts[0].crop,
    )


def at_ends(seen: Measurement, windows: Windows) -> Tensor:
    """Copies `[B]` bool whose symbol reaches the end of the footprint, as `SymbolSensor.at_ends`."""
    return ((seen.symbol > LIT) & windows.ends(ENDS, seen.symbol.device)).flatten(1).any(1)


def rendered(sensor: SymbolSensor, scene: Scene) -> Tensor:
    """Features `[B, 4]` that a flat road would show, as `SymbolSensor.rendered`."""
    windows, eye = scene.windows, sensor.model.eye
    symbol = _symbols(scene.flat, scene.limit, windows.inside(scene.flat.device), windows, sensor.params)
    return eye.features(appearance(*_in_axes(eye, symbol, windows)))


def _exposed(luminance: Tensor, scene: Scene, camera: CameraParams, frames: Sequence[Taken], number: int, quantise: bool) -> Tensor:
    """Digital numbers of the on frames (0) or off frames (1) of luminance `[B, height, width]`."""
    ambient, noisy = (
        luminance.new_tensor(factors)[:, None, None]
        for factors in zip(
            *((each.disturbances.ambient_factor(each.step, number), each.disturbances.noise_factor(each.step)) for each in frames),
            strict=True,
        )
    )
    if bool((ambient != 1).any()):
        luminance = luminance + (ambient - 1) * scene.base
    noise = None
    if camera.noise:
        noise = normal([FrameNoise.of(each.seed, each.step, number) for each in frames], scene.windows, luminance)
        noise = noise if bool((noisy == 1).all()) else noisy * noise
    return expose(luminance, camera, noise, quantise=quantise)


def _mean_around(light: Tensor, inside: Tensor) -> Tensor:
    """Mean of the 3 x 3 pixels in each crop `[B, height, width]`, as in `luxloop.perception.extraction.threshold`."""
    counted = inside.to(light)
    return _sum_around(light * counted) / _sum_around(counted).clamp(min=1)


def _sum_around(image: Tensor) -> Tensor:
    image = pad(image, (1, 1, 1, 1))
    image = image[..., :-2, :] + image[..., 1:-1, :] + image[..., 2:, :]
    return image[..., :-2] + image[..., 1:-1] + image[..., 2:]


def _symbols(contrast: Tensor, limit: Tensor, inside: Tensor, windows: Windows, params: Extraction) -> Tensor:
    """Symbol images `[B, height, width]`, each of its crop alone."""
    if not isinstance(params, OwnExtractionParams):
        return symbol_image(contrast.masked_fill(~inside, DARK), limit, params)
    found = torch.zeros_like(contrast)
    for k, (crop, (v, u)) in enumerate(zip(windows.crops, windows.starts, strict=True)):
        if not windows.empty[k]:
            part = slice(crop.v_start - v, crop.v_stop - v), slice(crop.u_start - u, crop.u_stop - u)
            found[k, *part] = symbol_image(contrast[k, *part], limit[k, *part], params)
    return found


def _in_axes(eye: Eye, symbol: Tensor, windows: Windows) -> tuple[Tensor, Axes]:
    """Symbol images and the axes of their features, of the image or of the road seen from above."""
    if eye.plane is None:
        return symbol, windows.axes(symbol)
    planes = [rectify(eye.plane, each, u, v) for each, (v, u) in zip(symbol, windows.starts, strict=True)]
    return torch.stack(planes), eye.plane.axes
