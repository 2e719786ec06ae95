"""Measurement of a lamp's pixels on a screen, from combs of distant pixels, and the headlight matrix that follows."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.sparse as sp
import torch
from scipy.ndimage import map_coordinates, median_filter

from luxloop.loop.rig.arrays import Array, Indices, Mask
from luxloop.loop.rig.calibration.geometry import Geometry, Observation, adjust, lux_per_cd
from luxloop.loop.rig.calibration.shapes import REACH, PixelMeasurements, Windows, borders, combs, measure, windows
from luxloop.loop.rig.calibration.shots import Shots
from luxloop.loop.rig.calibration.structured_light import Chart, Places, decode, patterns, places
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.lamps import mount
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import Lamp
from luxloop.world.spmv import Csr
from luxloop.world.texels import TexelGrid

LEAST = 3e-3  # light below this share of a pixel's peak is left out
MARGIN = math.ceil(REACH - 0.5)  # reach in pixels of light beyond the outermost pixels
NEAR = 0.25  # additional reach in pixels of a shifted pixel's shape
AT_ONCE = 64  # rows of texels computed together


def grid_over(y: Array, z: Array, texels: tuple[int, int]) -> TexelGrid:
    """Grid of a light texture over pixel tangents y and z `[rows, cols]`, extended by the reach of the outermost pixels' blurred light."""
    rows, cols = y.shape
    margin_y, margin_z = ((0.5 + MARGIN) * float(np.ptp(each)) / max(n - 1, 1) for each, n in ((y, cols), (z, rows)))
    return TexelGrid(
        rows=texels[0] * (rows + 2 * MARGIN),
        cols=texels[1] * (cols + 2 * MARGIN),
        left=float(y.max()) + margin_y,
        right=float(y.min()) - margin_y,
        bottom=float(z.min()) - margin_z,
        top=float(z.max()) + margin_z,
    )


def headlight(name: str, grid: TexelGrid, measured: PixelMeasurements, lamp_of: Chart) -> Headlight:
    """Headlight matrix of a digitised module in cd. lamp_of: from tangents (y, z) to lamp coordinates (row, column)."""
    rows, cols = measured.intensity.shape
    block_of = [np.searchsorted(borders(n), np.arange(n), "right") - 1 for n in (rows, cols)]
    y, z = (each.numpy() for each in grid.tangents())
    lit = np.nan_to_num(measured.intensity).clip(min=0)
    least = LEAST * measured.shapes.max((2, 3))
    reach = int(np.ceil(REACH))
    parts = []
    for start in range(0, grid.rows, AT_ONCE):
        zz, yy = np.meshgrid(z[start : start + AT_ONCE], y, indexing="ij")
        row, col = (each.ravel() for each in lamp_of(yy, zz))
        texel = np.arange(row.size)
        entries: list[tuple[Array, Array, Array]] = []
        for i, j in itertools.product(range(-reach, reach + 1), repeat=2):
            r, c = np.floor(row).astype(int) + i, np.floor(col).astype(int) + j
            inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
            inside &= (np.abs(row - r - 0.5) < REACH + NEAR) & (np.abs(col - c - 0.5) < REACH + NEAR)
            r, c, at = r[inside], c[inside], texel[inside]
            dr, dc = row[at] - r - 0.5 - measured.shift_row[r, c], col[at] - c - 0.5 - measured.shift_col[r, c]
            block = block_of[0][r], block_of[1][c]
            place = [(each + REACH) * (n / (2 * REACH)) - 0.5 for each, n in zip((dr, dc), measured.shapes.shape[2:], strict=True)]
            share = map_coordinates(measured.shapes, (*block, *place), order=1, mode="grid-constant")  # zero outside of a shape
            keep = share > least[block]
            entries.append((at[keep], (r * cols + c)[keep], (share * lit[r, c])[keep]))
        at, pixel, value = (np.concatenate(each) for each in zip(*entries, strict=True))
        parts.append(sp.csr_array((value.astype(np.float32), (at, pixel)), shape=(row.size, rows * cols)))
    matrix = Csr.from_scipy(sp.vstack(parts, format="csr"))
    return Headlight(name=name, matrix=matrix, pixel_rows=rows, pixel_cols=cols, **vars(grid))


def refuse_both_sides(scenario: Scenario) -> None:
    """Raise LuxloopError if both sides are lit, since a lamp file has one lamp."""
    if len(scenario.headlight.lamps) > 1:
        raise LuxloopError("a lamp file holds one lamp; digitise each by itself, with --set 'headlight.lamps=[\"left\"]'")


def lamp_of(scenario: Scenario, lights: Sequence[Headlight], name: str, notes: str) -> Lamp:
    """The scenario's lamp with digitised modules, one per lit module, as the left lamp that lamp files describe."""
    mounts = mount(scenario.headlight)
    lamp = mounts[0].lamp
    modules = list(lamp.modules)
    for each, light in zip(mounts, lights, strict=True):
        modules[each.number] = replace(modules[each.number], headlight=light)
    lamp = Lamp(name, tuple(modules), notes=notes)
    return lamp if mounts[0].side == "left" else replace(lamp, modules=tuple(each.mirror() for each in modules))


FRAMES = 2  # frames to average for each light
LOCATED = 0.5  # least share of a lamp's pixels to locate
REFINED = (16, 16)  # each round of chart refinement measures one pixel in this many
DEAD = 0.05  # a pixel below this share of its neighbours' median light is dead
STUCK = 0.05  # a pixel above this share while all pixels are off is stuck
AROUND = 7  # pixels along a side of the neighbourhood
SENSOR_M = 0.01  # diameter of a luxmeter's sensor
SENSOR_POINTS = 15  # sample points across the sensor
LINEAR_FROM, SQUARE_FROM = 4, 9  # luxmeter readings for a scale that is linear, quadratic over the picture


# A luxmeter's illuminance in lx on the screen, facing along its normal, with all pixels of all modules on; position (u, v) of its sensor
# in the camera's picture in px.
Reading = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ModuleMeasurement:
    """A digitised module.

    light: in cd, or in the camera's unit without a luxmeter reading. geometry: poses of camera, screen and module. measured: of each pixel.
    u, v: `[rows, cols]` px, image position of the centre of each pixel's light. dead, stuck: `[rows, cols]` bool. checked: relative rms
    difference between measured test patterns, which were not fitted, and the digitised module's light, by pattern name.
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
    """Data sheet of a module: its number, name, pixel grid, and tangents (y, z) `[rows, cols]` of each pixel's light."""

    number: int
    name: str
    rows: int
    cols: int
    y: Array
    z: Array

    @classmethod
    def of(cls, number: int, name: str, light: Headlight) -> "Nominal":
        matrix = light.matrix.to_scipy().astype(float)
        y, z = (each.numpy() for each in light.tangents())
        total = np.maximum(np.asarray(matrix.sum(0)).ravel(), 1e-30)
        across, up = np.tile(y, light.rows), np.repeat(z, light.cols)
        shape = light.pixel_rows, light.pixel_cols
        return cls(number, name, *shape, (matrix.T @ across / total).reshape(shape), (matrix.T @ up / total).reshape(shape))

    def alone(self, sizes: Sequence[int], u: Array) -> list[Array]:
        """Utilisations of all modules with this module at u `[n_p]` and the others dark. sizes: number of pixels of each module."""
        return [u if k == self.number else np.zeros(n) for k, n in enumerate(sizes)]

    def shot(self, what: str) -> str:
        """Name of this module's frames."""
        return f"{self.number}_{what}"


def locate_pixels(light: Sequence[Array], noise: float, nominal: Nominal) -> Places:
    """Positions of the pixels from the light `[height, width]` of `patterns`. noise: standard deviation of the light. Raises LuxloopError
    if too few are located.
    """
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
    """Digitise one module while the others are dark.

    sizes: number of pixels of each module. start: camera, screen and approximate lamp pose. factor_of: cd per unit of light at each camera
    pixel, `[height, width]`. comb_frames: frames to average for each comb. texels: rows and columns of texels per pixel. Raises
    LuxloopError as `Shots.exposures`.
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
    """Modules scaled to cd by luxmeter readings, and the relative standard deviation of the readings from the scaled light.

    One reading gives a constant scale; four give one that is linear over the picture, nine a quadratic one, which corrects errors of the
    assumed screen.
    """
    at = np.array(readings)[:, 1:]
    wanted = np.log([lux for lux, _, _ in readings])
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
    """Mean illuminance in lx over a luxmeter's sensor on the screen, with all pixels on."""
    (_, u, v), geometry, screen = reading, module.geometry, module.geometry.screen.rotation
    points = geometry.on_screen(np.array(u), np.array(v)) + sensor(*screen[:, :2].T)
    found = lux(module.light, geometry.lamp.matrix, points, screen[:, 2])
    if found <= 0:
        raise LuxloopError(f"the lamp gives no light at {u:g}, {v:g} px; give a reading inside its field")
    return found


def sensor(across: Array, along: Array) -> Array:
    """Sample points `[n, 3]` m of a luxmeter's sensor relative to its centre. across, along: unit vectors `[3]` of its plane."""
    line = np.linspace(-0.5, 0.5, SENSOR_POINTS)
    x, y = (each.ravel() for each in np.meshgrid(line, line))
    disc = np.hypot(x, y) <= 0.5
    return SENSOR_M * (x[disc, None] * across + y[disc, None] * along)


def lux(light: Headlight, T_lamp: Array, points: Array, normal: Array) -> float:
    """Mean illuminance in lx at points `[n, 3]` m of a surface, with all pixels of a module on. T_lamp: pose of the module, `[4, 4]`."""
    away = points - T_lamp[:3, 3]
    intensity = light.intensity(light.light_texture(torch.ones(light.n_pixels)), torch.from_numpy((away @ T_lamp[:3, :3]).T.copy()))
    return float((intensity.numpy() * lux_per_cd(points, T_lamp[:3, 3], normal)).mean())


def _place_lamp(geometry: Geometry, nominal: Nominal, chart: Chart) -> Geometry:
    """Lamp pose from the image positions of its pixels without the outermost, whose light ends at the edge of the field."""
    inner = (np.s_[1:-1] if nominal.rows > 2 else np.s_[:], np.s_[1:-1] if nominal.cols > 2 else np.s_[:])
    row, col = (each[inner].ravel() + 0.5 for each in np.indices((nominal.rows, nominal.cols)))
    tangents = np.stack([nominal.y[inner].ravel(), nominal.z[inner].ravel()], -1)
    seen = Observation(tangents, np.stack(chart(row, col), -1))
    return adjust(geometry.camera, geometry.screen, geometry.lamp, seen, fix_camera=True)


def _refine(measured: PixelMeasurements, chart: Chart) -> tuple[Chart, Chart]:
    """Charts refitted to the measured centres of inner pixels: from lamp to camera, and back."""
    row, col = measured.centres()
    at = np.indices(row.shape) + 0.5
    good = np.isfinite(measured.intensity) & (measured.intensity > DEAD * np.nanmedian(measured.intensity))
    good &= (np.abs(row - at[0]) < 1) & (np.abs(col - at[1]) < 1)
    for axis, n in enumerate(row.shape):
        good &= (at[axis] > 1) & (at[axis] < n - 1) if n > 2 else True
    lamp, camera = (at[0][good], at[1][good]), chart(row[good], col[good])
    return Chart.fit(lamp, camera), Chart.fit(camera, lamp)


def _faulty(measured: PixelMeasurements, dark_at: Callable[[Indices, Indices], Windows]) -> tuple[Mask, Mask]:
    """Dead and stuck pixels, `[rows, cols]` bool; a stuck pixel shines in the dark."""
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
    """Relative rms difference between measured light in cd `[height, width]` and the digitised module's light at utilisation u."""
    geometry, light = module.geometry, module.light
    v_px, u_px = np.indices(seen.shape) + 0.5
    y, z = geometry.tangents(geometry.on_screen(u_px, v_px))
    margin_y, margin_z = 3 * (light.left - light.right) / light.pixel_cols, 3 * (light.top - light.bottom) / light.pixel_rows
    inside = (y < light.left - margin_y) & (y > light.right + margin_y) & (z < light.top - margin_z) & (z > light.bottom + margin_z)
    rays = torch.from_numpy(np.stack([np.ones(int(inside.sum())), y[inside], z[inside]]))
    made = light.intensity(light.light_texture(torch.from_numpy(u.astype(np.float32))), rays).numpy()
    return float(np.sqrt(((made - seen[inside]) ** 2).mean()) / np.sqrt((seen[inside] ** 2).mean()))
