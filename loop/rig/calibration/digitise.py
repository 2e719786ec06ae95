"""Digitise a lamp: measure its pixels on a screen, one comb after another."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
import torch
from scipy.ndimage import median_filter

from luxloop.loop.rig.arrays import Array, Indices, Mask
from luxloop.loop.rig.calibration.geometry import Geometry, Observation, adjust
from luxloop.loop.rig.calibration.lamp import grid_over, headlight
from luxloop.loop.rig.calibration.shapes import PixelMeasurements, Windows, combs, measure, windows
from luxloop.loop.rig.calibration.shots import Shots
from luxloop.loop.rig.calibration.structured_light import Chart, Places, decode, patterns, places
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight

FRAMES: Final = 2  # of each light, whose mean is taken
LOCATED: Final = 0.5  # share of a lamp's pixels that have to be found
REFINED: Final = (16, 16)  # one of so many pixels is measured in each round that refines the charts
DEAD: Final = 0.05  # share of the light of pixels around, below which one is dead
STUCK: Final = 0.05  # the same of one that shines while all are off
AROUND: Final = 7  # pixels, whose median that is
PLACED: Final = 0.2  # pixels: a place without a shift beyond that is used for the charts
SENSOR_M: Final = 0.01  # diameter of a luxmeter's sensor
SENSOR_POINTS: Final = 15  # along that
LINEAR_FROM, SQUARE_FROM = 4, 9  # luxmeter readings, from which on the scale may change over the field


@dataclass(frozen=True, eq=False)
class Reading:
    """A luxmeter's reading on the screen, facing along its normal, with all pixels of all modules on. u, v: position of its sensor in the
    camera's picture in px.
    """

    lux: float
    u: float
    v: float


@dataclass(frozen=True, eq=False)
class ModuleMeasurement:
    """A measured module.

    light: in cd, or in the camera's unit without a luxmeter reading. geometry: camera, screen and module to each other. measured: of each
    pixel. u, v: `[rows, cols]` px, where its light is centred. dead, stuck: `[rows, cols]` bool. checked: relative root mean square
    difference between lights that were not fitted and what the digitised module makes of them, by the light's name.
    """

    name: str
    light: Headlight
    geometry: Geometry
    measured: PixelMeasurements
    u: Array
    v: Array
    dead: Mask
    stuck: Mask
    checked: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Nominal:
    """Data sheet of a module: its number, name, pixels, and tangents (y, z) `[rows, cols]` of their light."""

    number: int
    name: str
    rows: int
    cols: int
    y: Array
    z: Array

    @classmethod
    def of(cls, number: int, name: str, light: Headlight) -> "Nominal":
        matrix = light.matrix.to_scipy().astype(float)
        y, z = (each.numpy() for each in light.tangents(torch.float64, torch.device("cpu")))
        total = np.maximum(np.asarray(matrix.sum(0)).ravel(), 1e-30)
        across, up = np.tile(y, light.rows), np.repeat(z, light.cols)
        shape = light.pixel_rows, light.pixel_cols
        return cls(number, name, *shape, (matrix.T @ across / total).reshape(shape), (matrix.T @ up / total).reshape(shape))

    def alone(self, sizes: Sequence[int], u: Array) -> list[Array]:
        """Utilisations of all modules, those of the others 0. sizes: number of pixels of each. u: `[n_p]`, of this one."""
        return [u if k == self.number else np.zeros(n) for k, n in enumerate(sizes)]

    def shot(self, what: str) -> str:
        """Name of frames of this module."""
        return f"{self.number}_{what}"


def locate_pixels(light: Sequence[Array], noise: float, nominal: Nominal) -> Places:
    """Locate the pixels in the light `[height, width]` of `patterns`. noise: standard deviation of it. Raises LuxloopError for too few."""
    decoded = decode(light, nominal.rows, nominal.cols, noise)
    if not decoded[2].any():
        raise LuxloopError(f"module {nominal.name!r}: the camera sees none of its pixels; look at lamp, screen, camera and exposure")
    found = places(*decoded, nominal.rows, nominal.cols)
    share = float(np.isfinite(found.u).mean())
    if share < LOCATED:
        raise LuxloopError(
            f"module {nominal.name!r}: only {100 * share:.0f} % of its pixels were located; have the camera see all of its light on the "
            "screen, sharp, and at least 1.2 camera pixels a lamp pixel"
        )
    return found


def digitise_module(
    shots: Shots,
    nominal: Nominal,
    sizes: Sequence[int],
    start: Geometry,
    factor_of: Callable[[Geometry], Array],
    comb_frames: int = 4,
    texels: tuple[int, int] = (4, 2),
) -> ModuleMeasurement:
    """Measure one module, the others dark. sizes: number of pixels of each module. start: camera, screen and the approximate pose of the
    lamp. factor_of: cd per unit of light at each camera pixel, `[height, width]`. comb_frames: of each comb, whose mean is taken. texels:
    rows and columns of texels a pixel. Raises LuxloopError as `Shots.exposures`.
    """
    name, lit, on = nominal.shot, partial(nominal.alone, sizes), np.ones(nominal.rows * nominal.cols)
    every = shots.exposures(name("brightest"), lit(on))
    main = every[:1]
    linear = shots.response[shots.frames(name("full"), lit(on), max(comb_frames, 2), main[0])] / main[0]
    bright = linear.mean(0) > 0.5 * np.percentile(linear.mean(0), 99)
    noise = float(np.sqrt(linear.var(0, ddof=1)[bright].mean()))
    coded = dict(patterns(nominal.rows, nominal.cols))
    light = {what: shots.light(name(what), lit(u), FRAMES, main) for what, u in coded.items()}
    dark = shots.light(name("off"), lit(0 * on), comb_frames, every)
    taken = np.stack([shots.light(name(what), lit(u), comb_frames, every) - dark for what, u in combs(nominal.rows, nominal.cols)])
    found = locate_pixels([*light.values()], noise / np.sqrt(FRAMES), nominal)
    chart, lamp_of = found.chart, found.lamp_of
    geometry = _place_lamp(start, nominal, chart)
    images: Array = (taken * factor_of(geometry)).astype(np.float32)
    for each in REFINED:
        rough = measure(partial(windows, images, chart, lamp_of), nominal.rows, nominal.cols, texels, each)
        chart, lamp_of = _refine(rough, chart)
    geometry = _place_lamp(geometry, nominal, chart)
    factor = factor_of(geometry).astype(np.float32)
    images = taken * factor
    measured = measure(partial(windows, images, chart, lamp_of), nominal.rows, nominal.cols, texels)
    dead, stuck = _faulty(measured, partial(windows, np.broadcast_to(dark * factor, images.shape), chart, lamp_of))

    row, col = np.indices((nominal.rows, nominal.cols)) + 0.5
    y, z = geometry.tangents(geometry.on_screen(*chart(row, col)))
    grid = grid_over(y, z, texels)
    made = headlight(nominal.name, grid, measured, Chart.fit((y.ravel(), z.ravel()), (row.ravel(), col.ravel())))
    u, v = chart(*measured.centres())
    module = ModuleMeasurement(nominal.name, made, geometry, measured, u, v, dead, stuck, {})
    checked = {"full": _difference(module, factor * (linear.mean(0) - light["dark"]), on)}
    checked |= {
        what: _difference(module, factor * (light[what] - light["dark"]), each) for what, each in coded.items() if what.endswith("phase_0")
    }
    return replace(module, checked=checked)


def scale_to_lux(modules: Sequence[ModuleMeasurement], readings: Sequence[Reading]) -> tuple[tuple[ModuleMeasurement, ...], float]:
    """The modules with intensities in cd by luxmeter readings, and the relative standard deviation of the readings from the result.

    One reading gives the scale. With four readings the scale is linear over the picture, with nine quadratic, to correct errors of the
    assumed screen.
    """
    at = np.array([[each.u, each.v] for each in readings])
    wanted = np.log([each.lux for each in readings])
    found = np.log([sum(_lux(module, each) for module in modules) for each in readings])
    shape = modules[0].geometry.camera
    terms = _terms(at, len(readings), (shape.width, shape.height))
    solved, *_ = np.linalg.lstsq(terms, wanted - found, rcond=None)
    left = terms @ solved - (wanted - found)
    std = float(np.sqrt((left**2).sum() / max(len(readings) - len(solved), 1)))
    made = []
    for module in modules:
        places = np.stack([module.u.ravel(), module.v.ravel()], -1)
        share = np.exp(_terms(places, len(readings), (shape.width, shape.height)) @ solved)
        intensity = module.measured.intensity * share.reshape(module.u.shape)
        light = module.light.dim(torch.from_numpy(share.astype(np.float32)))
        made.append(replace(module, light=light, measured=replace(module.measured, intensity=intensity)))
    return tuple(made), std


def _terms(at: Array, readings: int, size: tuple[int, int]) -> Array:
    u, v = at[:, 0] / size[0] - 0.5, at[:, 1] / size[1] - 0.5
    terms = [np.ones_like(u)]
    if readings >= LINEAR_FROM:
        terms += [u, v]
    if readings >= SQUARE_FROM:
        terms += [u * u, u * v, v * v]
    return np.stack(terms, -1)


def _lux(module: ModuleMeasurement, reading: Reading) -> float:
    """Mean illuminance of the screen over a luxmeter's sensor at a reading's place, with all pixels on."""
    geometry, screen = module.geometry, module.geometry.screen.rotation
    points = geometry.on_screen(np.array(reading.u), np.array(reading.v)) + sensor(*screen[:, :2].T)
    found = lux(module.light, geometry.lamp.matrix, points, screen[:, 2])
    if found <= 0:
        raise LuxloopError(f"the lamp gives no light at {reading.u:g}, {reading.v:g} px; give a reading inside its field")
    return found


def sensor(across: Array, along: Array) -> Array:
    """Points `[n, 3]` m of a luxmeter's sensor, from its middle. across, along: unit vectors `[3]` of its plane."""
    line = np.linspace(-0.5, 0.5, SENSOR_POINTS)
    x, y = (each.ravel() for each in np.meshgrid(line, line))
    disc = np.hypot(x, y) <= 0.5
    return SENSOR_M * (x[disc, None] * across + y[disc, None] * along)


def lux(light: Headlight, T_lamp: Array, points: Array, normal: Array) -> float:
    """Mean illuminance in lx at points `[n, 3]` m of a surface, with all pixels of a module on. T_lamp: `[4, 4]`, its pose."""
    away = points - T_lamp[:3, 3]
    distance = np.linalg.norm(away, axis=1)
    cos = np.abs(away @ normal) / distance
    intensity = light.intensity(light.light_texture(torch.ones(light.n_pixels)), torch.from_numpy((away @ T_lamp[:3, :3]).T.copy()))
    return float((intensity.numpy() * cos / distance**2).mean())


def _place_lamp(geometry: Geometry, nominal: Nominal, chart: Chart) -> Geometry:
    """The lamp's pose from where its pixels are seen; the outermost are left out, since their light ends there."""
    inner = (np.s_[1:-1] if nominal.rows > 2 else np.s_[:], np.s_[1:-1] if nominal.cols > 2 else np.s_[:])
    row, col = (each[inner].ravel() + 0.5 for each in np.indices((nominal.rows, nominal.cols)))
    tangents = np.stack([nominal.y[inner].ravel(), nominal.z[inner].ravel()], -1)
    seen = Observation(tangents, np.stack(chart(row, col), -1))
    return adjust(geometry.camera, geometry.screen, geometry.lamp, seen, fix_camera=True)


def _refine(measured: PixelMeasurements, chart: Chart) -> tuple[Chart, Chart]:
    """Charts that go through the centres of what was measured of the inner pixels."""
    row, col = measured.centres()
    at = np.indices(row.shape) + 0.5
    good = np.isfinite(measured.intensity) & (measured.intensity > DEAD * np.nanmedian(measured.intensity))
    good &= (np.abs(row - at[0]) < 1) & (np.abs(col - at[1]) < 1)
    for axis, n in enumerate(row.shape):
        good &= (at[axis] > 1) & (at[axis] < n - 1) if n > 2 else True
    lamp, camera = (at[0][good], at[1][good]), chart(row[good], col[good])
    return Chart.fit(lamp, camera), Chart.fit(camera, lamp)


def _faulty(measured: PixelMeasurements, dark_at: Callable[[Indices, Indices], Windows]) -> tuple[Mask, Mask]:
    """Dead and stuck pixels; the light of a stuck one is there in the dark, and does not change."""
    around = median_filter(measured.intensity, AROUND)
    low = measured.intensity < np.maximum(DEAD * around, 3 * measured.noise)
    r, c = np.nonzero(low)
    stuck = np.zeros(low.shape, bool)
    if len(r):
        at = dark_at(r, c)
        beyond, core = at.inside & (at.reach > 1), at.inside & (at.reach <= 0.5)
        level = np.nanmedian(np.where(beyond, at.seen, np.nan), 1)
        stuck[r, c] = (at.seen * core).sum(1) / np.maximum(core.sum(1), 1) - level > STUCK * around[r, c]
    return low & ~stuck, stuck


def _difference(module: ModuleMeasurement, seen: Array, u: Array) -> float:
    """Of what is seen of a light in cd `[height, width]`, and what the digitised module gives there."""
    geometry, light = module.geometry, module.light
    v_px, u_px = np.indices(seen.shape) + 0.5
    y, z = geometry.tangents(geometry.on_screen(u_px, v_px))
    margin_y, margin_z = 3 * (light.left - light.right) / light.pixel_cols, 3 * (light.top - light.bottom) / light.pixel_rows
    inside = (y < light.left - margin_y) & (y > light.right + margin_y) & (z < light.top - margin_z) & (z > light.bottom + margin_z)
    rays = torch.from_numpy(np.stack([np.ones(int(inside.sum())), y[inside], z[inside]]))
    made = light.intensity(light.light_texture(torch.from_numpy(u.astype(np.float32))), rays).numpy()
    return float(np.sqrt(((made - seen[inside]) ** 2).mean()) / np.sqrt((seen[inside] ** 2).mean()))
