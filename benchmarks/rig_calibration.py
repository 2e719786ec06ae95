"""How well a lamp is digitised, with and without effects that the calibration does not model: places, intensities, directions.

`python benchmarks/rig_calibration.py small` or `hd` prints a row of the table of docs/rig_calibration.md for each case.
"""

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from bench import show
from rig_bench import ALBEDO, BLUR, VEIL, Effects, Rig, model, rig, wall

from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.digitise import ModuleMeasurement, Nominal, Reading, digitise_module, lux, scale_to_lux
from luxloop.loop.rig.calibration.geometry import Geometry, candela_factor
from luxloop.loop.rig.calibration.shots import Shots, linear_response
from luxloop.loop.rig.simulated.faults import LensParams
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised

CASES = {
    "nothing": Effects(),
    "blur": Effects(LensParams(**BLUR)),
    "veiling glare": Effects(LensParams(**VEIL)),
    "glossy screen": Effects(gloss=True),
    "another lens": Effects(division=True),
    "all four": Effects(LensParams(**BLUR, **VEIL), gloss=True, division=True),
}


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
            normal, screen = of.truth.screen.rotation[:, 2], of.truth.screen.place
            point = of.truth.lamp.place + ray * (normal @ (screen - of.truth.lamp.place) / (normal @ ray))
            reading = Reading(1.0, *of.lens_px(of.truth.camera.project(point[None]))[0].tolist())
            offsets = rng.uniform(-0.005, 0.005, (4000, 2))
            sensor = point + offsets[np.hypot(*offsets.T) < 0.005] @ of.truth.screen.rotation[:, :2].T
            found.append(replace(reading, lux=lux(of.light, of.truth.lamp.matrix, sensor, normal)))
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
    true = flux(of.light)
    errors = []
    for n in (1, 9):
        (inside,), _ = scale_to_lux([found], readings(of, n))
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

    def rms(x: Array) -> float:
        return float(np.sqrt(np.mean(np.square(x))))

    return {
        "places, px rms": rms(off),
        "intensities, % rms": 100 * rms(errors[0]),
        "with 9 readings": 100 * rms(errors[1]),
        "directions, pixels rms": rms(turned),
        "all pixels on, %": 100 * rms(a - b) / rms(b),
        "checked, %": 100 * found.checked["full"],
    }


if __name__ == "__main__":
    size, *chosen = sys.argv[1:] or ["small"]
    light, camera = lamp(size)
    rows = {}
    with TemporaryDirectory() as folder:
        scenario = wall(model(Path(folder) / "lamp.npz", light), camera.pop("width"), camera.pop("height"), **camera)
        for name in chosen or CASES:
            of = replace(rig(scenario, CASES[name], 4 if size == "small" else 2), light=light)
            rows[name] = figures(of, digitise(of))
    show(f"Lamp {size}", rows)
