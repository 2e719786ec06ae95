"""How fast and how well a beam is digitised live: `python benchmarks/live_beam.py [--json FILE] [--quick]`.

Processor time from a picture to a light texture, on one core, and the texture's difference from the true one, rms over its lit texels, for
the lamp of 332 x 1024 pixels before a wall whose geometry is known. A camera of 10,000 electrons.
"""

from argparse import Namespace
from functools import partial
from typing import Any

import cv2
import numpy as np
import torch
from bench import interleaved, run, show
from rig_bench import ALBEDO, rig, wall

from luxloop import idealised
from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.calibrate import Calibration
from luxloop.loop.rig.calibration.shots import linear_response
from luxloop.loop.rig.live.plant import Digitiser
from luxloop.perception.camera import saturation_luminance
from luxloop.world.headlight import Headlight

LIT = 0.02  # of the brightest texel


def patterns(light: Headlight) -> dict[str, Array]:
    """Utilisations `[n_p]` by name: a beam that changes smoothly, all pixels on, half of them, and stripes."""
    r, c = np.indices((light.pixel_rows, light.pixel_cols))
    smooth = np.exp(-(((r - 0.5 * light.pixel_rows) / (0.25 * light.pixel_rows)) ** 2) - ((c / light.pixel_cols - 0.5) / 0.2) ** 2)
    images = {"smooth": smooth, "all on": np.ones(r.shape), "cut-off": r > light.pixel_rows // 2, "stripes of 32": c // 32 % 2}
    return {name: 0.8 * np.asarray(u, np.float32).ravel() for name, u in images.items()}


def compare(given: Namespace, width: int, height: int) -> dict[str, Any]:
    """A case for each grid of texels. The lens is known as a board shows it."""
    of = rig(wall("idealised-332x1024", {"width_px": width, "height_px": height, "hfov_deg": 24.0, "pitch_deg": 4.0}))
    bench, truth, light = of.bench, of.truth, of.light
    scale = float(np.pi * saturation_luminance(bench.camera) / ALBEDO)
    response, lamps = linear_response(bench.levels), {"left matrix": truth.lamp}
    calibration = Calibration(of.known.camera, response, np.zeros(3), truth.screen, lamps, {}, scale)
    found, shown = {}, patterns(light)
    pictures = {name: bench.frames([u], 1, bench.camera.exposure_s)[0] for name, u in shown.items()}
    grey = pictures["smooth"]
    colour = np.stack([grey] * 3, -1)
    for texels in given.texels:
        lamp = idealised(texels_per_pixel=tuple(texels))
        reader = Digitiser.of(calibration, "left matrix", lamp)
        ms = interleaved({"grey": partial(reader.texture, grey), "colour": partial(reader.texture, colour)}, given.rounds)
        errors = {}
        for name, u in shown.items():
            true = lamp.light_texture(torch.from_numpy(u))
            lit = true > LIT * true.max()
            error = (reader.texture(pictures[name]) - true)[lit]
            errors[name] = float(error.square().mean().sqrt() / true[lit].square().mean().sqrt())
        rate = 1e3 * lamp.rows * lamp.cols / ms["grey"]
        found[f"{width} x {height} px, {lamp.rows} x {lamp.cols} texels"] = {"ms": ms, "texels/s": rate, "rms error": errors}
    return found


def measure(given: Namespace) -> dict[str, Any]:
    cv2.setNumThreads(1)
    found = {}
    for size in given.cameras_px:
        found |= compare(given, *size)
    show("A live beam", found)
    return {"cases": found}


if __name__ == "__main__":
    run(measure, __doc__)
