"""How well a lamp is digitised, with and without effects that the calibration does not model: places, intensities, directions.

`python benchmarks/rig_calibration.py small` or `hd` prints a row of the table of docs/rig_calibration.md for each case.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from rig_bench import ALBEDO, Effects, Rig, model, rig, seen_at, wall

from luxloop.loop.report.terminal import markdown
from luxloop.loop.rig.calibration.bench import Array
from luxloop.loop.rig.calibration.digitise import Digitised, Nominal, Reading, Settings, digitised, lux, scaled, take
from luxloop.loop.rig.calibration.geometry import Geometry, candela_factor
from luxloop.loop.rig.calibration.response import Response
from luxloop.loop.rig.calibration.shots import Shots
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised

CASES = {
    "nothing": Effects(),
    "blur": Effects(blur=True),
    "veiling glare": Effects(veil=True),
    "glossy screen": Effects(gloss=True),
    "another lens": Effects(lens=True),
    "all four": Effects(blur=True, veil=True, gloss=True, lens=True),
}
COLUMNS = (
    "not modelled",
    "places, px rms",
    "intensities, % rms",
    "with 9 readings",
    "directions, pixels rms",
    "all pixels on, %",
    "checked, %",
)


def uneven(light: Headlight, seed: int = 1) -> Headlight:
    """A lamp whose pixels differ by 15 % and of which two are dead."""
    share = np.exp(0.15 * np.random.default_rng(seed).standard_normal(light.n_pixels)).clip(0.5, 1.5)
    share[[light.n_pixels // 3, light.n_pixels // 2 + 5]] = 0
    return light.dim(torch.from_numpy(share.astype(np.float32)))


def lamp(size: str) -> tuple[Headlight, dict[str, Any]]:
    """A lamp, and the camera that looks at its light."""
    if size == "hd":
        return uneven(idealised()), {"width": 1920, "height": 800, "hfov_deg": 24.0, "pitch_deg": 4.0}
    return uneven(idealised(20, 40, (4, 2), 4.0, 1.8, -2.2)), {"width": 160, "height": 120, "hfov_deg": 12.0}


def flux(light: Headlight) -> Array:
    """Luminous flux of each pixel in lm, `[n_p]`."""
    y, z = (each.numpy() for each in light.tangents(torch.float64, torch.device("cpu")))
    area = (light.left - light.right) / light.cols * (light.top - light.bottom) / light.rows
    return np.asarray(light.matrix.to_scipy().T @ (area * (1 + y**2 + z[:, None] ** 2) ** -1.5).ravel())


def readings(of: Rig, n: int) -> list[Reading]:
    """What a luxmeter shows at n places of the screen, one or nine."""
    rng, found = np.random.default_rng(0), []
    for a in np.linspace(0.1, 0.9, 3) if n > 1 else [0.5]:
        for b in np.linspace(0.1, 0.9, 3) if n > 1 else [0.5]:
            y, z = of.light.left + a * (of.light.right - of.light.left), of.light.top + b * (of.light.bottom - of.light.top)
            ray = of.truth.lamp.rotation @ np.array([1.0, y, z])
            normal, screen = of.truth.screens[0].rotation[:, 2], of.truth.screens[0].place
            point = of.truth.lamp.place + ray * (normal @ (screen - of.truth.lamp.place) / (normal @ ray))
            u, v = seen_at(of.truth.camera.project(point[None]), of.lens_of)
            reading = Reading(1.0, float(u[0]), float(v[0]))
            offsets = rng.uniform(-0.005, 0.005, (4000, 2))
            sensor = point + offsets[np.hypot(*offsets.T) < 0.005] @ of.truth.screens[0].rotation[:, :2].T
            found.append(replace(reading, lux=lux(of.light, of.truth, sensor, reading)))
    return found


def places(of: Rig) -> tuple[Array, Array]:
    """Where each pixel's light is centred in the camera, `[n_p]` px each, NaN of dead ones."""
    seen = of.bench.transports[0].T.tocsr()
    v, u = (each.ravel() + 0.5 for each in np.indices(of.bench.shape))
    with np.errstate(invalid="ignore", divide="ignore"):
        total = seen @ np.ones(len(u))
        return (seen @ u) / total, (seen @ v) / total


def measured(of: Rig, folder: Path | None = None, settings: Settings | None = None) -> Digitised:
    """The rig's lamp, digitised, in the camera's unit."""
    settings = settings or Settings()
    shots = Shots(of.bench, Response.linear(of.bench.levels), folder, "benchmark")
    nominal = Nominal.of(0, "matrix", of.light)
    taken = take(shots, nominal, [of.light.n_pixels], settings)

    def factor(geometry: Geometry) -> Array:
        return candela_factor(geometry, of.bench.shape, lambda cos: np.full_like(cos, ALBEDO))

    return digitised(taken, nominal, of.known, settings, factor)


def figures(of: Rig, found: Digitised) -> list[float]:
    """The numbers of COLUMNS."""
    u, v = places(of)
    alive = np.isfinite(u) & ~found.dead.ravel()
    off = np.hypot(found.u.ravel() - u, found.v.ravel() - v)[alive]
    true = flux(of.light)
    errors = []
    for n in (1, 9):
        (inside,), _ = scaled([found], readings(of, n))
        errors.append(flux(inside.light)[alive] / true[alive] - 1)
        if n == 1:
            one = inside
    pitch = (of.light.left - of.light.right) / of.light.pixel_cols, (of.light.top - of.light.bottom) / of.light.pixel_rows
    nominal, mine = Nominal.of(0, "", of.light), Nominal.of(0, "", one.light)
    turned = np.hypot((mine.y - nominal.y) / pitch[0], (mine.z - nominal.z) / pitch[1]).ravel()[alive]
    on = torch.ones(of.light.n_pixels)
    y, z = of.light.tangents(torch.float64, torch.device("cpu"))
    zz, yy = torch.meshgrid(z, y, indexing="ij")
    rays = torch.stack([torch.ones_like(yy), yy, zz]).flatten(1)
    a, b = (each.intensity(each.light_texture(on), rays).numpy() for each in (one.light, of.light))
    rms = lambda x: float(np.sqrt(np.mean(np.square(x))))  # noqa: E731
    return [rms(off), *(100 * rms(each) for each in errors), rms(turned), 100 * rms(a - b) / rms(b), 100 * found.checked["full"]]


def rows(size: str, names: list[str]) -> Iterator[tuple[str, list[float]]]:
    light, camera = lamp(size)
    with TemporaryDirectory() as folder:
        scenario = wall(model(Path(folder) / "lamp.npz", light), camera.pop("width"), camera.pop("height"), **camera)
        for name in names:
            of = replace(rig(scenario, CASES[name], 4 if size == "small" else 2), light=light)
            print(f"{name}: rig built", file=sys.stderr, flush=True)
            start = time.monotonic()
            found = measured(of)
            print(f"{name}: {time.monotonic() - start:.1f} s, {int(found.dead.sum())} dead", file=sys.stderr, flush=True)
            yield name, figures(of, found)


if __name__ == "__main__":
    size, *chosen = sys.argv[1:] or ["small"]
    table = [[name, *(f"{each:.3g}" for each in numbers)] for name, numbers in rows(size, chosen or list(CASES))]
    print(markdown(COLUMNS, table))
