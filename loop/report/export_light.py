"""Light as files for other programs: a beam of a lamp, and the light of each module of a scenario at one time."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from luxloop.loop.report.facts import borders_deg
from luxloop.world.arrays import write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST, Commands, Lamp
from luxloop.world.photometry import Distribution, sample, write, write_eulumdat

if TYPE_CHECKING:
    from luxloop.loop.simulation.simulation import Simulation

LEAST_STEP_DEG, MOST_STEP_DEG, MOST_NODES = 0.01, 5.0, 4_000_000
PLANES: Final = 360  # C planes of EULUMDAT
SUFFIXES: Final = (".ies", ".ldt")


def refuse_time(simulation: "Simulation", time_s: float) -> None:
    """Raises LuxloopError for a time beyond the scenario."""
    lasts_s = simulation.scenario.steps / simulation.scenario.rate_hz
    if not 0 <= time_s <= lasts_s:
        raise LuxloopError(f"--at {time_s:g}: {simulation.scenario.name} lasts {lasts_s:g} s; give a time in it, in s from its start")


def modules_at(simulation: "Simulation", time_s: float) -> Iterator[tuple[str, Tensor]]:
    """Names of the modules and their poses `[4, 4]` float64 on the body at a time."""
    commands: Commands = simulation.lights_at(time_s)[1] if simulation.planner.commanding else ()
    modules = simulation.world.modules
    for module, command in zip(modules, commands or (REST,) * len(modules), strict=True):
        yield module.name, module.turned(command)


def write_light(simulation: "Simulation", time_s: float, file: Path, step_deg: float) -> list[Path]:
    """Write the light of all modules of the plant at a time, with wear and errors of aim; returns the files.

    file: .npz for one file, .ies or .ldt for a file per module, named after the module if there are several. step_deg: of the angles of
    photometric files. Raises LuxloopError for another suffix, a time beyond the scenario, a plant that does not know the truth, and where a
    file cannot be written.
    """
    suffix = file.suffix.lower()
    if suffix not in (".npz", *SUFFIXES):
        raise LuxloopError(f"--out {file}: gives no format of light; end it in .npz, .ies or .ldt")
    refuse_time(simulation, time_s)
    us, commands = simulation.lights_at(time_s)
    arrays, files = list[tuple[str, np.ndarray]](), list[Path]()
    for number, (module, u, command) in enumerate(zip(simulation.world.modules, us, commands or (REST,) * len(us), strict=True)):
        headlight, T = module.headlight, module.turned(command).numpy()
        texture = (command.intensity * headlight.light_texture(u)).detach().cpu()
        if suffix == ".npz":
            values = {
                "candela": texture.numpy(),
                "u": u.detach().cpu().numpy().reshape(headlight.pixel_rows, headlight.pixel_cols),
                "border_deg": np.array(borders_deg(headlight)),
                "T_body_module": T,
            }
            arrays += [(f"{module.name}.{key}", array) for key, array in values.items()]
            continue
        part_name = re.sub(r"[^\w.+-]", "-", module.name)  # a lamp file may call a module a/b
        own = file if len(us) == 1 else file.with_name(f"{file.stem}-{part_name}{file.suffix}")
        own = own.with_stem(f"{own.stem}-{number}") if own in files else own  # and another one a-b
        x, y, z = T[:3, 3]
        yaw, pitch, roll = Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)
        keywords = {"_POSITION_M": f"{x:.4f} {y:.4f} {z:.4f}", "_ROLL_PITCH_YAW_DEG": f"{roll:.4f} {pitch:.4f} {yaw:.4f}"}
        name = f"{headlight.name}, {module.name}, {simulation.scenario.name} at {time_s:g} s"
        _write(own, partial(headlight.intensity, texture.double()), borders_deg(headlight), name, step_deg, keywords)
        files.append(own)
    if suffix == ".npz":
        write_npz(file, arrays)
    return files or [file]


def export(lamp: Lamp, beam: str, file: Path, step_deg: float = 0.1) -> Distribution:
    """Write a beam as LM-63-2019, type A, or as EULUMDAT, by the suffix; it is dark outside the lamp's field.

    Raises LuxloopError for an unknown beam, another suffix, a step out of range or too fine, and where the file cannot be written.
    """
    return _write(file, lamp.lit(lamp.beam(beam)), lamp.field_deg, f"{lamp.name}, beam {beam}", step_deg, {})


def _write(
    file: Path, intensity: Callable[[Tensor], Tensor], field_deg: tuple[float, ...], name: str, step_deg: float, keywords: Mapping[str, str]
) -> Distribution:
    """Write an intensity in cd. field_deg: left and right (left positive), bottom and top (up positive) of the lit field. name: of the
    luminaire. keywords: further keywords of LM-63.
    """
    left, right, bottom, top = field_deg
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise LuxloopError(f"--out {file}: gives no photometric format; end it in {' or '.join(SUFFIXES)}")
    if suffix == ".ies":
        h, v = _nodes(-left, -right, step_deg), _nodes(bottom, top, step_deg)
        _refuse_many(len(h), len(v), step_deg)
        distribution = sample(intensity, h, v)
        write(file, distribution, {"LUMINAIRE": name, **keywords})
    else:
        corner = math.cos(math.radians(max(left, -right))) * math.cos(math.radians(max(-bottom, top)))
        gamma = _nodes(0.0, math.degrees(math.acos(corner)), step_deg)
        gamma = np.append(gamma[gamma >= 0], 180.0)
        _refuse_many(PLANES, len(gamma), step_deg)
        distribution = sample(intensity, np.arange(PLANES) * (360 / PLANES), gamma, "C")
        write_eulumdat(file, distribution, name)
    return distribution


def _refuse_many(columns: int, rows: int, step_deg: float) -> None:
    if columns * rows > MOST_NODES:
        raise LuxloopError(f"--step-deg {step_deg:g}: makes {columns} x {rows} angles; give a larger step")


def _nodes(low: float, high: float, step_deg: float) -> np.ndarray:
    """Multiples of a step from below low to above high, and +-90 deg, where LM-63 requires type A to begin and end, `[n]` deg."""
    if not LEAST_STEP_DEG <= step_deg <= MOST_STEP_DEG:
        raise LuxloopError(f"--step-deg {step_deg:g}: give an angle step of {LEAST_STEP_DEG:g} to {MOST_STEP_DEG:g} deg")
    first, last = math.floor(low / step_deg) - 1, math.ceil(high / step_deg) + 1
    inner = np.arange(first, last + 1) * step_deg
    return np.concatenate([[-90.0], inner[(inner > -90) & (inner < 90)], [90.0]])
