"""Pictures of the lighting functions: `python lighting_functions.py [FOLDER] [NAME ...]`, by default all into the current folder.

Each is a table of functions as scenario files have it, the objects that a tracker reports, and the same objects as boxes on the road.
"""

import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import torch

from luxloop import (
    Lamp,
    LightingParams,
    Module,
    Planner,
    Situation,
    Ssc,
    TrackedObject,
    idealised,
    pose_from_degrees,
    show_headlight,
    validate,
)

MOUNTS = {"left": pose_from_degrees((0.0, 0.6, 0.75)), "right": pose_from_degrees((0.0, -0.6, 0.75))}
TOP, BOTTOM = 0.25, 0.75  # of the picture: above is the sky, below the road before the light
SYMBOLS = Path(str(files("luxloop.scenarios"))) / "symbols"

CAR = ("car", "car", (32.0, 2.6, 0.0), 180.0, (4.4, 1.8, 1.5))
ANNA = ("anna", "pedestrian", (24.0, -2.6, 0.0), 90.0, (0.4, 0.5, 1.75))
SIGN = ("sign", "sign", (30.0, -3.8, 1.4), 180.0, (0.1, 0.9, 0.9))
CURVE = ((11.0, 0.0), (20.0, 0.0), (26.0, -1.0), (32.0, -7.0))
BRIGHTER = {"quantity": "u_rel", "value": 8.0}
PICTURE = {"centre_m": (9.0, 0.0, 0.45), "width_m": 0.9, "height_m": 0.25}

# Name: utilisation of the base beam, objects, functions, curvature of the course in 1/m.
FUNCTIONS: dict[str, tuple[float, tuple[Any, ...], dict[str, dict[str, Any]], float]] = {
    "glare-free": (0.5, (CAR, ANNA), {"guard": {"kind": "glare_free", "soft_zones": ({"margin_m": 0.8, "u_rel": 0.4},)}}, 0.0),
    "marker": (0.12, (ANNA,), {"line": {"kind": "marker", "near_m": 11.0}, "body": {"kind": "marker", "target": "body"}}, 0.0),
    "sign": (0.5, (SIGN,), {"dimmed": {"kind": "sign", "value": 0.05}}, 0.0),
    "symbol": (0.12, (), {"warning": {"kind": "symbol", "image": "snowflake"}}, 0.0),
    "observer": (0.12, (), {"warning": {"kind": "symbol", "image": "warning_triangle", "observer": PICTURE}}, 0.0),
    "path": (0.12, (), {"detour": {"kind": "path", "control_m": CURVE, "width_m": 1.6, "image": "chevrons", **BRIGHTER}}, 0.0),
    "lane": (0.12, (), {"borders": {"kind": "lane", "style": "lines", "near_m": 11.0, "far_m": 45.0, **BRIGHTER}}, 0.01),
    "width": (0.12, (), {"own_width": {"kind": "width", "near_m": 11.0}}, 0.0),
}


def draw(name: str, folder: Path) -> None:
    base, objects, functions, curvature = FUNCTIONS[name]
    light = idealised(200, 720, (2, 2), half_width_deg=18, top_deg=3, bottom_deg=-7)
    tracked = tuple(
        TrackedObject(each, category, pose_from_degrees(place, yaw_deg=yaw), size) for each, category, place, yaw, size in objects
    )
    now = Situation(
        0.0,
        torch.eye(4, dtype=torch.float64),
        torch.stack([T[:3, 3] for T in MOUNTS.values()]),
        tracked,
        curvature_1_m=curvature,
    )
    plan = Planner.prepare(functions, LightingParams(), lambda image: SYMBOLS / f"{image}.png").plan(now)
    ssc = Ssc.prepare(light, default=torch.full((light.n_pixels,), base))
    beam = {side: (ssc.utilisation(plan.primitives, T).u,) for side, T in MOUNTS.items() if plan.primitives}
    boxes = [
        {"name": each, "kind": "box", "size_m": size, "albedo": 0.3, "track": [{"position_m": place, "yaw_deg": yaw}]}
        for each, _, place, yaw, size in objects
    ]
    scenario = validate({"name": name, "objects": boxes, "light": {"ambient_lx": 0.02}}, name)
    lamp = Lamp("fine", (Module("fine", light),))
    out = folder / f"functions-{name}.jpg"
    show_headlight({"left": lamp, "right": lamp}, out, beam=beam, view="driver", style="luminance", scenario=scenario)
    picture = cv2.imread(str(out))
    cv2.imwrite(str(out), picture[round(TOP * len(picture)) : round(BOTTOM * len(picture))])


if __name__ == "__main__":
    arguments = sys.argv[1:]
    folder = Path(arguments[0]) if arguments else Path()
    folder.mkdir(parents=True, exist_ok=True)
    for name in arguments[1:] or FUNCTIONS:
        draw(name, folder)
