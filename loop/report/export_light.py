"""Light as files for other programs: the beam of a lamp, and what each module of a scenario's lamps gives at one time."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from luxloop.loop.report.facts import borders_deg
from luxloop.world.arrays import write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import REST, Commands, Lamp
from luxloop.world.photometry import Distribution, sample, write, write_eulumdat

if TYPE_CHECKING:
    from luxloop.loop.simulation.simulation import Simulation

LEAST_STEP_DEG, MOST_STEP_DEG, MOST_NODES = 0.01, 5.0, 4_000_000
PLANES: Final = 360  # of EULUMDAT, all round
SUFFIXES: Final = (".ies", ".ldt")


@dataclass(frozen=True, eq=False)
class ModuleLight:
    """A module's light at one time.

    headlight: of the module. u: `[n_p]`. texture: `[rows, cols]` in cd, dimmed as commanded. T_body_module: `[4, 4]`, turned as commanded.
    """

    name: str
    headlight: Headlight
    u: Tensor
    texture: Tensor
    T_body_module: Tensor


def refuse_time(simulation: "Simulation", time_s: float) -> None:
    """Raises LuxloopError for a time that is none of the scenario's."""
    lasts_s = simulation.scenario.steps / simulation.scenario.rate_hz
    if not 0 <= time_s <= lasts_s:
        raise LuxloopError(f"--at {time_s:g}: {simulation.scenario.name} lasts {lasts_s:g} s; give a time in it, in s from its start")


def light_at(simulation: "Simulation", time_s: float) -> list[ModuleLight]:
    """Of all modules that shine, as the plant has them: worn and misaimed ones too. Raises LuxloopError on a plant without truth."""
    refuse_time(simulation, time_s)
    lights, commands = simulation.lights_at(time_s)
    found = zip(simulation.world.modules, lights, commands or (REST,) * len(lights), strict=True)
    return [
        ModuleLight(
            module.name,
            module.headlight,
            u,
            command.intensity * module.headlight.light_texture(u),
            command.turn(module.T_body_headlight),
        )
        for module, u, command in found
    ]


def modules_at(simulation: "Simulation", time_s: float) -> Iterator[tuple[str, Tensor]]:
    """Names of the modules and their poses `[4, 4]` float64 on the body at a time, which are computed alone where nothing turns them."""
    commands: Commands = simulation.lights_at(time_s)[1] if simulation.planner.commanding else ()
    modules = simulation.world.modules
    for module, command in zip(modules, commands or (REST,) * len(modules), strict=True):
        yield module.name, command.turn(module.T_body_headlight).double().cpu()


def write_light(simulation: "Simulation", time_s: float, file: Path, step_deg: float) -> list[Path]:
    """Write the light at a time: .npz all modules in one file, .ies or .ldt a file a module, which has its name where there are several.

    Raises LuxloopError for another suffix, a time beyond the scenario, and where a file cannot be written.
    """
    suffix = file.suffix.lower()
    if suffix not in (".npz", *SUFFIXES):
        raise LuxloopError(f"--out {file}: gives no format of light; end it in .npz, .ies or .ldt")
    lights = light_at(simulation, time_s)
    if suffix == ".npz":
        with whole(file) as part:
            write_npz(part, [(f"{each.name}.{key}", array) for each in lights for key, array in _arrays(each)])
        return [file]
    files = list[Path]()
    for number, each in enumerate(lights):
        part_name = re.sub(r"[^\w.+-]", "-", each.name)  # a lamp file may call a module a/b
        own = file if len(lights) == 1 else file.with_name(f"{file.stem}-{part_name}{file.suffix}")
        own = own.with_stem(f"{own.stem}-{number}") if own in files else own  # and another one a-b
        x, y, z = each.T_body_module[:3, 3].tolist()
        yaw, pitch, roll = Rotation.from_matrix(each.T_body_module[:3, :3].double().cpu().numpy()).as_euler("ZYX", degrees=True)
        keywords = {"_POSITION_M": f"{x:.4f} {y:.4f} {z:.4f}", "_ROLL_PITCH_YAW_DEG": f"{roll:.4f} {pitch:.4f} {yaw:.4f}"}
        name = f"{each.headlight.name}, {each.name}, {simulation.scenario.name} at {time_s:g} s"
        light, headlight = each.texture.detach().double().cpu(), each.headlight
        _write(own, partial(headlight.intensity, light), borders_deg(headlight), name, step_deg, keywords)
        files.append(own)
    return files


def _arrays(light: ModuleLight) -> Iterator[tuple[str, np.ndarray]]:
    of = light.headlight
    yield "candela", light.texture.detach().cpu().numpy()
    yield "u", light.u.detach().cpu().numpy().reshape(of.pixel_rows, of.pixel_cols)
    yield "border_deg", np.degrees([math.atan(each) for each in (of.left, of.right, of.bottom, of.top)])
    yield "T_body_module", light.T_body_module.double().cpu().numpy()


def export(lamp: Lamp, beam: str, file: Path, step_deg: float = 0.1) -> Distribution:
    """Write a beam over the lamp's field, as LM-63-2019, type A, or as EULUMDAT, by the suffix; zero outside the field.

    Raises LuxloopError for an unknown beam, another suffix, a step out of range or too fine, and where the file cannot be written.
    """
    return _write(file, lamp.lit(lamp.beam(beam)), lamp.field_deg, f"{lamp.name}, beam {beam}", step_deg, {})


def _write(
    file: Path, intensity: Callable[[Tensor], Tensor], field_deg: tuple[float, ...], name: str, step_deg: float, keywords: Mapping[str, str]
) -> Distribution:
    """field_deg: left and right (left positive), bottom and top (up positive), beyond which it is dark. name: of the luminaire. keywords:
    more of them in LM-63.
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
    """Multiples of the step from one below low to one above high, and +-90 deg, where LM-63 requires type A to begin and end."""
    if not LEAST_STEP_DEG <= step_deg <= MOST_STEP_DEG:
        raise LuxloopError(f"--step-deg {step_deg:g}: give an angle step of {LEAST_STEP_DEG:g} to {MOST_STEP_DEG:g} deg")
    first, last = math.floor(low / step_deg) - 1, math.ceil(high / step_deg) + 1
    inner = np.arange(first, last + 1) * step_deg
    return np.concatenate([[-90.0], inner[(inner > -90) & (inner < 90)], [90.0]])
