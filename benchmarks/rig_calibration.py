"""How well a lamp is digitised, with and without effects that the calibration does not model: places, intensities, directions.

`python benchmarks/rig_calibration.py --lamp small` or `hd` prints a row of the table of docs/rig_calibration.md for each case.
"""

import itertools
import sys
from argparse import Namespace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from bench import run, show
from rig_bench import ALBEDO, Rig, lens_px, rig, wall

from luxloop import Lamp, Module, Scenario, idealised
from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.digitise import ModuleMeasurement, Nominal, Reading, digitise_module, lux, scale_to_lux
from luxloop.loop.rig.calibration.geometry import Geometry, candela_factor
from luxloop.loop.rig.calibration.shots import Shots, linear_response
from luxloop.world.headlight import Headlight
from luxloop.world.lamps import archive


def uneven_wall(given: Namespace, size: str, folder: Path) -> Scenario:
    """A lamp whose pixels differ by 15 % and of which two are dead, before a screen."""
    lamp = given.lamps[size]
    light = idealised(**lamp["preset"])
    share = np.exp(0.15 * np.random.default_rng(1).standard_normal(light.n_pixels)).clip(0.5, 1.5)
    share[[light.n_pixels // 3, light.n_pixels // 2 + 5]] = 0
    archive.save(folder / f"{size}.npz", Lamp(size, (Module("matrix", light.dim(torch.from_numpy(share.astype(np.float32)))),)))
    return wall(str(folder / f"{size}.npz"), lamp["camera"])


def flux(light: Headlight) -> Array:
    """Luminous flux of each pixel in lm, `[n_p]`."""
    y, z = (each.numpy() for each in light.tangents())
    area = (light.left - light.right) / light.cols * (light.top - light.bottom) / light.rows
    return np.asarray(light.matrix.to_scipy().T @ (area * (1 + y**2 + z[:, None] ** 2) ** -1.5).ravel())


def readings(of: Rig, n: int) -> list[Reading]:
    """What a luxmeter shows at n x n places of the screen."""
    rng, found, lamp, screen = np.random.default_rng(0), [], of.truth.lamp, of.truth.screen
    normal = screen.rotation[:, 2]
    for a, b in itertools.product(np.linspace(0.1, 0.9, n) if n > 1 else [0.5], repeat=2):
        y, z = of.light.left + a * (of.light.right - of.light.left), of.light.top + b * (of.light.bottom - of.light.top)
        ray = lamp.rotation @ np.array([1.0, y, z])
        point = lamp.place + ray * (normal @ (screen.place - lamp.place) / (normal @ ray))
        offsets = rng.uniform(-0.005, 0.005, (4000, 2))
        sensor = point + offsets[np.hypot(*offsets.T) < 0.005] @ screen.rotation[:, :2].T
        u, v = lens_px(of.truth.camera, of.params, of.truth.camera.project(point[None]))[0].tolist()
        found.append((lux(of.light, lamp.matrix, sensor, normal), u, v))
    return found


def places(of: Rig) -> tuple[Array, Array]:
    """Where each pixel's light is centred in the camera, `[n_p]` px each, NaN of dead ones."""
    seen = of.bench.transports[0].T.tocsr()
    v, u = (each.ravel() + 0.5 for each in np.indices(of.bench.shape))
    with np.errstate(invalid="ignore", divide="ignore"):
        total = seen @ np.ones(len(u))
        return (seen @ u) / total, (seen @ v) / total


def digitise(of: Rig, folder: Path | None = None) -> ModuleMeasurement:
    """The rig's lamp, digitised, in the camera's unit."""
    shots = Shots(of.bench, linear_response(of.bench.levels), folder, "benchmark")
    nominal = Nominal.of(0, "matrix", of.light)

    def factor(geometry: Geometry) -> Array:
        return candela_factor(geometry, of.bench.shape, lambda cos: np.full_like(cos, ALBEDO))

    return digitise_module(shots, nominal, [of.light.n_pixels], of.known, factor)


def figures(of: Rig, found: ModuleMeasurement) -> dict[str, float]:
    """How far a digitised lamp is from the rig's."""
    u, v = places(of)
    alive = np.isfinite(u) & ~found.dead.ravel()
    off = np.hypot(found.u.ravel() - u, found.v.ravel() - v)[alive]
    one, nine = (scale_to_lux([found], readings(of, n))[0][0].light for n in (1, 3))
    by_one, by_nine = (flux(each)[alive] / flux(of.light)[alive] - 1 for each in (one, nine))
    nominal, mine = Nominal.of(0, "", of.light), Nominal.of(0, "", one)
    columns = (mine.y - nominal.y) / (of.light.left - of.light.right) * of.light.pixel_cols
    rows = (mine.z - nominal.z) / (of.light.top - of.light.bottom) * of.light.pixel_rows
    y, z = of.light.tangents()
    zz, yy = torch.meshgrid(z, y, indexing="ij")
    rays = torch.stack([torch.ones_like(yy), yy, zz]).flatten(1)
    a, b = (each.intensity(each.light_texture(torch.ones(each.n_pixels)), rays).numpy() for each in (one, of.light))

    def rms(x: Array) -> float:
        return float(np.sqrt(np.mean(np.square(x))))

    return {
        "places, px rms": rms(off),
        "intensities, % rms": 100 * rms(by_one),
        "with 9 readings": 100 * rms(by_nine),
        "directions, pixels rms": rms(np.hypot(columns, rows).ravel()[alive]),
        "all pixels on, %": 100 * rms(a - b) / rms(b),
        "checked, %": 100 * found.checked["full"],
    }


def measure(given: Namespace) -> dict[str, Any]:
    if wrong := {*given.only} - given.cases.keys() | {given.lamp} - given.lamps.keys():
        sys.exit(f"unknown {', '.join(wrong)}; lamps are {', '.join(given.lamps)}, cases {', '.join(given.cases)}")
    rows = {}
    with TemporaryDirectory() as folder:
        scenario = uneven_wall(given, given.lamp, Path(folder))
        for name in given.only:
            of = rig(scenario, **given.cases[name], fine=given.lamps[given.lamp]["fine"])
            rows[name] = figures(of, digitise(of))
    show(f"Lamp {given.lamp}", rows)
    return {"cases": rows}


if __name__ == "__main__":
    run(measure, __doc__, "lamp", "only")
