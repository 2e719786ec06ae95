"""What each module of a scenario's lamps gives at one time, as light textures or photometric files."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from luxloop.loop.report.export_photometry import SUFFIXES, write_texture
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.arrays import write_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole
from luxloop.world.headlight import Headlight
from luxloop.world.headlight.lamp import REST, Commands


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


def refuse_time(simulation: Simulation, time_s: float) -> None:
    """Raises LuxloopError for a time that is none of the scenario's."""
    lasts_s = simulation.scenario.steps / simulation.scenario.rate_hz
    if not 0 <= time_s <= lasts_s:
        raise LuxloopError(f"--at {time_s:g}: {simulation.scenario.name} lasts {lasts_s:g} s; give a time in it, in s from its start")


def light_at(simulation: Simulation, time_s: float) -> list[ModuleLight]:
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
            command.turn(module.T_world_headlight),
        )
        for module, u, command in found
    ]


def modules_at(simulation: Simulation, time_s: float) -> Iterator[tuple[str, Tensor]]:
    """Names of the modules and their poses `[4, 4]` float64 on the body at a time, which are computed alone where nothing turns them."""
    commands: Commands = simulation.lights_at(time_s)[1] if simulation.planner.commanding else ()
    modules = simulation.world.modules
    for module, command in zip(modules, commands or (REST,) * len(modules), strict=True):
        yield module.name, command.turn(module.T_world_headlight).double().cpu()


def write_light(simulation: Simulation, time_s: float, file: Path, step_deg: float) -> list[Path]:
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
    files = []
    for each in lights:
        part_name = re.sub(r"[^\w.+-]", "-", each.name)  # a lamp file may call a module a/b
        own = file if len(lights) == 1 else file.with_name(f"{file.stem}-{part_name}{file.suffix}")
        x, y, z = each.T_body_module[:3, 3].tolist()
        yaw, pitch, roll = Rotation.from_matrix(each.T_body_module[:3, :3].double().cpu().numpy()).as_euler("ZYX", degrees=True)
        keywords = {"_POSITION_M": f"{x:.4f} {y:.4f} {z:.4f}", "_ROLL_PITCH_YAW_DEG": f"{roll:.4f} {pitch:.4f} {yaw:.4f}"}
        name = f"{each.headlight.name}, {each.name}, {simulation.scenario.name} at {time_s:g} s"
        write_texture(own, each.headlight, each.texture, name, step_deg, keywords)
        files.append(own)
    return files


def _arrays(light: ModuleLight) -> Iterator[tuple[str, np.ndarray]]:
    of = light.headlight
    yield "candela", light.texture.detach().cpu().numpy()
    yield "u", light.u.detach().cpu().numpy().reshape(of.pixel_rows, of.pixel_cols)
    yield "border_deg", np.degrees([math.atan(each) for each in (of.left, of.right, of.bottom, of.top)])
    yield "T_body_module", light.T_body_module.double().cpu().numpy()
