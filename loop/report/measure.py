"""Photometric values of a beam: luminous intensity by direction, illuminance of a wall and of places on a flat road."""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from luxloop.loop.report.facts import lit_deg
from luxloop.loop.scenario.model import HeadlightParams
from luxloop.loop.simulation.lamps import T_world_lamp
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole
from luxloop.world.headlight.lamp import Lamp, direction
from luxloop.world.light.illumination import lux_per_cd

SCREEN_M = 25.0  # distance of the aiming screen
LINE_POINTS = 51
MOST_POINTS = 2_000_000
STEP_DEG = 0.5  # of a wall's grid by default
FINEST_DEG = 0.001  # least step
COARSEST_DEG = 80.0  # largest step
ROUNDING = 1e-9  # of angles in steps
LIMITS_DEG = (89.0, 89.0)  # beyond, a wall is out of reach
LIMITS_M = (1000.0, 1000.0, 100.0)
Values = Mapping[str, Tensor]  # columns of one length, named with their units


def points(given: Sequence[str], axes: str, limits: Sequence[float], option: str) -> Tensor:
    """Points `[axes, N]` from words such as "1,2", or "1,2:5,2:9" for 9 points on a line from one to another (51 without a number).

    axes: letters of the axes, of which the third may be left out and is then 0. limits: largest magnitudes. Raises LuxloopError.
    """
    found = []
    for word in given:
        first, *others = word.split(":")
        ends = [_point(each, axes, limits) for each in (first, *others[:1])]
        count = others[1] if len(others) == 2 else str(LINE_POINTS)
        if None in ends or len(others) > 2 or not count.isdecimal() or not 2 <= int(count) <= MOST_POINTS:
            a, b = ",".join(axes[:2]), ",".join(axes)
            range_ = ", ".join(f"{axis} within ±{limit:g}" for axis, limit in zip(axes, limits, strict=True))
            raise LuxloopError(
                f"{option} {word}: give a point as {a}{'' if a == b else f' or {b}'}, or a line as {a}:{a} or {a}:{a}:COUNT, with {range_}"
            )
        line = torch.tensor([each for each in ends if each is not None], dtype=torch.float64).T
        share = torch.linspace(0, 1, int(count), dtype=torch.float64) if others else torch.zeros(1, dtype=torch.float64)
        found.append(line[:, :1] + (line[:, -1:] - line[:, :1]) * share)
    return torch.cat(found, 1)


def _point(word: str, axes: str, limits: Sequence[float]) -> list[float] | None:
    try:
        values = [float(each) for each in word.split(",")]
    except ValueError:
        return None
    values += [0.0] * (len(axes) - len(values)) if len(values) >= 2 else []
    return values if len(values) == len(axes) and all(abs(v) <= limit for v, limit in zip(values, limits, strict=True)) else None


def grid(lamp: Lamp, beam: str, step_deg: float, extent: Sequence[str] | None = None) -> Tensor:
    """Directions `[2, N]` in deg, to the right and up, over what a beam lights, row by row.

    step_deg: of both angles. extent: other angles, as largest ones to all sides, "H,V", or as two corners, "H,V:H,V". Raises LuxloopError.
    """
    if not FINEST_DEG <= step_deg <= COARSEST_DEG:
        raise LuxloopError(f"--step-deg {step_deg:g}: give a step of {FINEST_DEG:g} to {COARSEST_DEG:g} deg")
    if extent:
        corners = points(extent, "HV", LIMITS_DEG, "--extent")
        corners = torch.cat([corners, -corners], 1) if corners.shape[1] == 1 else corners
        across, up = torch.stack(corners.aminmax(dim=1), 1).tolist()
    else:
        intensity = lamp.lit(lamp.beam(beam))
        across, up = lit_deg(lambda h, v: intensity(direction(h, v).flatten(1)).view(h.shape))
    (h0, h1), (v0, v1) = ((math.ceil(low / step_deg - ROUNDING), math.floor(high / step_deg + ROUNDING)) for low, high in (across, up))
    rows, columns = v1 - v0 + 1, h1 - h0 + 1
    if rows * columns > MOST_POINTS:
        raise LuxloopError(f"--step-deg {step_deg:g}: makes {rows} x {columns} points; give a larger step")
    v, h = (torch.arange(first, last + 1, dtype=torch.float64) * step_deg for first, last in ((v0, v1), (h0, h1)))
    return torch.cartesian_prod(v, h).T.flip(0)


def towards(lamp: Lamp, beam: str, h_v_deg: Tensor, distance_m: float = SCREEN_M) -> Values:
    """Intensity by direction `[2, N]` in deg, and illuminance of an upright wall at a distance, in the direction from the lamp's origin."""
    rays = direction(*h_v_deg)
    wall = rays / rays[0] * distance_m
    facing = torch.tensor([[-1.0], [0.0], [0.0]], dtype=torch.float64)
    (lx,) = _illuminances([(lamp, torch.eye(4, dtype=torch.float64))], beam, wall, facing)
    return {"h_deg": h_v_deg[0], "v_deg": h_v_deg[1], "y_m": wall[1] + 0.0, "z_m": wall[2], "cd": lamp.lit(lamp.beam(beam))(rays), "lx": lx}


def on_road(lamps: Mapping[str, Lamp], beam: str, places: Tensor) -> Values:
    """Illuminance at places `[3, N]` m by a car's lamps by side, mounted as by default: horizontal, and vertical facing the car."""
    mounted = [(lamp, T_world_lamp(side, HeadlightParams())) for side, lamp in lamps.items()]
    up, back = torch.tensor([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]], dtype=torch.float64)[:, :, None]
    horizontal, vertical = _illuminances(mounted, beam, places, up, back)
    return {"x_m": places[0], "y_m": places[1], "z_m": places[2], "lx_horizontal": horizontal, "lx_vertical": vertical}


def _illuminances(mounted: Iterable[tuple[Lamp, Tensor]], beam: str, places: Tensor, *normals: Tensor) -> list[Tensor]:
    """Illuminance `[N]` in lx, for each normal `[3, 1]`, of places `[3, N]` m; NaN in the middle of a module."""
    total = [torch.zeros(places.shape[1], dtype=torch.float64) for _ in normals]
    for lamp, T in mounted:
        for centre, intensity in _emitters(lamp, beam):
            away = T[:3, :3] @ centre + T[:3, 3:] - places
            cd = intensity(T[:3, :3].T @ -away)
            total = [lx + cd * lux_per_cd(away, normal) for lx, normal in zip(total, normals, strict=True)]
    return total


def _emitters(lamp: Lamp, beam: str) -> list[tuple[Tensor, Callable[[Tensor], Tensor]]]:
    """Photometric centre `[3, 1]` in the lamp and intensity of each module; of a photometric file, which has none, its own."""
    us = lamp.beam(beam)
    parts = [
        (module.T_lamp_module[:3, 3:], replace(lamp, modules=(module,)).lit((u,))) for module, u in zip(lamp.modules, us, strict=False)
    ]
    return parts or [(torch.zeros(3, 1, dtype=torch.float64), lamp.lit(us))]


def write_csv(file: Path, values: Values) -> None:
    """Write columns as comma-separated values with nine digits. Raises LuxloopError where the file cannot be written."""
    with whole(file) as part, part.open("w", newline="", encoding="utf-8") as target:
        writer = csv.writer(target)
        writer.writerow(values)
        writer.writerows([f"{value:.9g}" for value in row] for row in torch.stack(list(values.values()), 1).tolist())
