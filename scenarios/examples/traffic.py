"""The pictures and times of docs/traffic.md: `python traffic.py pictures`.

It imports from internal packages of luxloop, which may change.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import TypeVar, get_args

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from luxloop import load, prepare, validate
from luxloop.loop.simulation.simulated import build_scene
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.ground_truth import ground_truth
from luxloop.world.rendering.surfaces import ExactSurfaces, face_source, surface_source
from luxloop.world.scene.scene import Scene
from luxloop.world.traffic.generator import random_tables, second_tables
from luxloop.world.traffic.models import Beast, Rider, Thing, Vehicle, Walker

T = TypeVar("T")
SCENES = 8


def pictures(folder: Path) -> None:
    """`night_traffic` after 1.5 s, by night and in 2000 lx; the sky is light grey by day."""
    for name, ambient_lx, white_cd_m2, sky in (("night", 0.05, 6.0, 0.0), ("day", 2000.0, 350.0, 0.8)):
        simulation = prepare(load("night_traffic", [f"light.ambient_lx={ambient_lx}"]))
        result = simulation.at(30)
        image = (result.luminance / white_cd_m2).clamp(0, 1).sqrt()
        image[simulation.world.lit(result.time_s).surfaces.object_id < 0] = sky
        cv2.imwrite(str(folder / f"traffic-{name}.jpg"), (255 * image).byte().cpu().numpy(), [cv2.IMWRITE_JPEG_QUALITY, 80])


def second_population(folder: Path) -> None:
    """All models by day, and streets of the first seeds of development in undimmed high beam."""
    small, sheet = get_args(Walker) + get_args(Rider) + get_args(Beast) + get_args(Thing), []
    for x, height_px, models in ((22.0, 300, small), (58.0, 140, get_args(Vehicle))):
        camera = {"width_px": 1280, "height_px": height_px, "hfov_deg": 34.0, "pitch_deg": -0.5}
        places = [(model, 0.57 * x * (0.5 - (k + 0.5) / len(models))) for k, model in enumerate(models)]
        objects = [
            {"kind": "model", "model": model, "name": model, "seed": k, "track": [{"position_m": [x, y, 0.0], "yaw_deg": 150.0}]}
            for k, (model, y) in enumerate(places)
        ]
        tables = {"lighting": {}, "light": {"ambient_lx": 2000.0}, "camera": camera, "objects": objects}
        day = prepare(validate({"name": "models", **tables}, "models"))
        sheet.append(grey(day.at(0).luminance, 350.0))
        sheet[-1][day.world.lit(0.0).surfaces.object_id.cpu() < 0] = 205
    streets = []
    for seed in range(3_000_000, 3_000_008):
        world = {"camera": {"width_px": 320, "height_px": 160, "pitch_deg": 1.5}, **second_tables(seed)}
        street = prepare(validate({"name": "street", "lighting": {"base": {"beam": "high"}}, **world}, f"seed {seed}"))
        streets.append(grey(street.at(30).luminance, 6.0))
    sheet += [np.hstack(streets[:4]), np.hstack(streets[4:])]
    cv2.imwrite(str(folder / "traffic-second.jpg"), np.vstack(sheet), [cv2.IMWRITE_JPEG_QUALITY, 80])


def grey(luminance: Tensor, white_cd_m2: float) -> NDArray[np.uint8]:
    return (255 * (luminance / white_cd_m2).clamp(0, 1).sqrt()).byte().cpu().numpy()


def times() -> None:
    """Medians over scenes, each drawn a second time, on one road."""
    view = camera_view(CameraParams(width_px=640, height_px=360))
    ways = {
        "exact": ExactSurfaces(face_source()),
        "quick": surface_source(face_source(), moving=True),
        "rays": ExactSurfaces(face_source("raycast")),
    }
    found: dict[str, list[float]] = {}
    road = None

    def timed(name: str, work: Callable[[], T]) -> T:
        start = time.perf_counter()
        result = work()
        found.setdefault(name, []).append(1e3 * (time.perf_counter() - start))
        return result

    for seed in range(SCENES):
        scenario = validate({"name": "night", "lighting": {}, **random_tables(seed)}, f"seed {seed}")
        items = scenario.all_objects
        objects = timed("make the objects", lambda items=items: [item.build() for item in items])
        road = road or build_scene(scenario).bodies[0]
        triangles = Scene((road, *objects)).at(0.0)
        for name, way in ways.items():
            way.gbuffer(triangles, view)
            surfaces = timed(f"G-buffer, {name}", lambda way=way, triangles=triangles: way.gbuffer(triangles, view))
        timed("ground truth", lambda s=surfaces, t=triangles, n=items: ground_truth(s, t, view, [each.category for each in n]))
    for name, values in found.items():
        print(f"{name}: {median(values):.0f} ms")


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path("pictures")
    target.mkdir(parents=True, exist_ok=True)
    pictures(target)
    second_population(target)
    times()
