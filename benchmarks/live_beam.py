"""How fast and how well a beam is digitised live: `python benchmarks/live_beam.py [--json FILE] [--quick]`.

Processor time from a picture to a light texture, on one core, and the texture's difference from the true one, rms over its lit texels, for
the lamp of 332 x 1024 pixels before a wall whose geometry is known. A camera of 10,000 electrons.
"""

import argparse
import json
import time
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
import torch
from bench import machine, on_one_thread
from rich.table import Table
from rig_bench import ALBEDO, Effects, rig, wall

from luxloop.loop.report import terminal as tables
from luxloop.loop.rig.calibration.bench import Array, SimulatedBench
from luxloop.loop.rig.calibration.files import Calibration
from luxloop.loop.rig.calibration.response import Response
from luxloop.loop.rig.live.digitiser import Digitiser
from luxloop.perception.camera import saturation_luminance
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import idealised

CAMERAS = ((640, 272), (1280, 544), (1920, 800))
TEXELS = ((1, 1), (4, 2))  # rows and columns a pixel: 332 x 1024 and 1328 x 2048 texels
REPEATS = 30
LIT = 0.02  # of the brightest texel


def patterns(light: Headlight) -> dict[str, Array]:
    """Utilisations `[n_p]` by name: a beam that changes smoothly, all pixels on, half of them, and stripes."""
    r, c = np.indices((light.pixel_rows, light.pixel_cols))
    smooth = np.exp(-(((r - 0.5 * light.pixel_rows) / (0.25 * light.pixel_rows)) ** 2) - ((c / light.pixel_cols - 0.5) / 0.2) ** 2)
    shown = {"smooth": smooth, "all on": np.ones(r.shape), "cut-off": r > light.pixel_rows // 2, "stripes of 32": c // 32 % 2}
    return {name: 0.8 * np.asarray(u, np.float32).ravel() for name, u in shown.items()}


def setup(size: tuple[int, int]) -> tuple[SimulatedBench, Calibration, Headlight]:
    """A bench, its calibration with the lens as a board shows it, and the lamp."""
    scenario = wall("idealised-332x1024", *size, 24.0, pitch_deg=4.0)
    found = rig(scenario, Effects())
    scale = float(np.pi * saturation_luminance(found.bench.camera) / ALBEDO)
    known, poses = found.truth, {"left matrix": found.truth.lamp}
    response = Response.linear(found.bench.levels)
    return found.bench, Calibration(found.known.camera, response, np.zeros(3), known.screens[0], poses, {}, scale), found.light


def timed(reader: Digitiser, picture: np.ndarray, repeats: int) -> float:
    """Median processor time in ms of a picture."""
    found = []
    for _ in range(repeats):
        start_s = time.process_time()
        reader.texture(picture)
        found.append(1e3 * (time.process_time() - start_s))
    return median(found)


def measured(size: tuple[int, int], repeats: int) -> list[dict[str, Any]]:
    """A row for each grid of texels."""
    bench, calibration, light = setup(size)
    rows = []
    pictures = {name: bench.frames([u], 1, bench.camera.exposure_s)[0] for name, u in patterns(light).items()}
    for texels in TEXELS:
        lamp = idealised(texels_per_pixel=texels)
        reader = Digitiser.of(calibration, "left matrix", lamp)
        grey = pictures["smooth"]
        ms = {"grey": timed(reader, grey, repeats), "colour": timed(reader, np.stack([grey] * 3, -1), repeats)}
        errors = {}
        for name, u in patterns(light).items():
            true = lamp.light_texture(torch.from_numpy(u))
            lit = true > LIT * true.max()
            error = (reader.texture(pictures[name]) - true)[lit]
            errors[name] = float(error.square().mean().sqrt() / true[lit].square().mean().sqrt())
        rows.append({"camera_px": size, "texels": (lamp.rows, lamp.cols), "ms": ms, "error": errors})
    return rows


def main() -> None:
    on_one_thread("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    cameras, repeats = (CAMERAS[:1], 3) if given.quick else (CAMERAS, REPEATS)
    rows = [row for size in cameras for row in measured(size, repeats)]
    names = list(rows[0]["error"])
    table = Table("camera", "texels", "grey, ms", "colour, ms", "texels/s, million", *(f"{name}, % rms" for name in names))
    for row in rows:
        rate = 1e-3 * row["texels"][0] * row["texels"][1] / row["ms"]["grey"]
        sizes = (" x ".join(map(str, row[key])) for key in ("camera_px", "texels"))
        errors = (f"{100 * row['error'][name]:.2f}" for name in names)
        table.add_row(*sizes, *(f"{row['ms'][name]:.1f}" for name in ("grey", "colour")), f"{rate:.0f}", *errors)
    tables.show(table)
    if given.json:
        given.json.write_text(json.dumps({"machine": machine("torch", "numpy", "opencv-contrib-python-headless"), "cases": rows}, indent=1))


if __name__ == "__main__":
    main()
