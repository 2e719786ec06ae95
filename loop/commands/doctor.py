"""Checks of this machine for the needs of luxloop: findings, and the commands that mend what is missing.

Nothing here imports a third-party package before the check that reports on it, so that a broken installation can be described.
"""

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

PIP = f"{sys.executable} -m pip install"
EXTRAS = ("dask", "gym", "onnx", "sb3", "studio")
OPENGL_LIBRARIES = "sudo apt-get install -y libegl1 libgl1 libgl1-mesa-dri"


@dataclass(frozen=True)
class Check:
    """Result of a check; `remedy` is a command, empty if all is well."""

    name: str
    status: Literal["ok", "warn", "fail"]
    found: str
    remedy: str = ""


def checks() -> list[Check]:
    """Check everything that a run may need (a few seconds)."""
    return [
        python_check(),
        *package_checks(),
        extras_check(),
        opengl_check(os.environ),
        ray_caster_check(),
        device_check(),
        video_check(),
        data_check(),
        folder_check(Path.cwd()),
    ]


def all_good(results: Iterable[Check]) -> bool:
    """Whether no check failed; with warnings luxloop still runs."""
    return all(check.status != "fail" for check in results)


def _failing_with(name: str, remedy: str) -> Callable[[Callable[..., Check]], Callable[..., Check]]:
    """Decorator of a check: an exception becomes a failed check with a remedy."""

    def decorate(look: Callable[..., Check]) -> Callable[..., Check]:
        def check(*args: object) -> Check:
            try:
                return look(*args)
            except Exception as error:
                return Check(name, "fail", _last_line(str(error)) or type(error).__name__, remedy)

        return check

    return decorate


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or [""])[-1]


def python_check(version: tuple[int, int, int] = sys.version_info[:3]) -> Check:
    found = f"{'.'.join(map(str, version))}, {platform.system()} {platform.machine()}"
    if version < (3, 11):
        return Check("Python", "fail", found, "sudo apt-get install -y python3 python3-venv")
    return Check("Python", "ok", found)


def package_checks() -> list[Check]:
    """One check for each requirement of the installed distribution."""
    try:
        requirements = metadata.requires("luxloop") or []
    except metadata.PackageNotFoundError:
        return [Check("luxloop", "fail", "not installed", f"{PIP} -e {Path(__file__).parents[3]}")]
    return [package_check(requirement) for requirement in requirements if "extra ==" not in requirement]


@_failing_with("extras", f"{PIP} --force-reinstall luxloop")
def extras_check() -> Check:
    """Which extras for users have all their packages; a missing one is no fault."""
    needed = {extra: [each for each in metadata.requires("luxloop") or [] if each.endswith(f'extra == "{extra}"')] for extra in EXTRAS}
    here = {extra for extra in EXTRAS if all(package_check(each.partition(";")[0]).status == "ok" for each in needed[extra])}
    found, missing = (",".join(extra for extra in EXTRAS if (extra in here) is wanted) for wanted in (True, False))
    return Check("extras", "ok", f"{found or 'none'}; {PIP} 'luxloop[{missing}]' adds the others" if missing else found)


def package_check(requirement: str) -> Check:
    """Whether a requirement such as `numpy>=2` is installed in a suitable version."""
    name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
    remedy = f'{PIP} "{requirement}"'
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Check(name, "fail", "not installed", remedy)
    from packaging.requirements import Requirement

    if not Requirement(requirement).specifier.contains(version, prereleases=True):
        return Check(name, "fail", f"{version}, but luxloop needs {requirement}", remedy)
    return Check(name, "ok", version)


def opengl_check(environment: Mapping[str, str]) -> Check:
    """Start the rasteriser in another process, which may crash, and name the renderer. environment: variables of that process."""
    remedy = OPENGL_LIBRARIES if environment.get("PYOPENGL_PLATFORM", "egl") == "egl" else "unset PYOPENGL_PLATFORM"
    command = [sys.executable, "-c", "from luxloop.world.rendering.rasterise import Rasteriser; print(Rasteriser().name)"]
    packages = Path(__file__).parents[3]
    try:
        probe = subprocess.run(command, cwd=packages, env=dict(environment), capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        return Check("OpenGL", "warn", "the driver did not answer within a minute", remedy)
    if probe.returncode < 0:
        return Check("OpenGL", "warn", f"the driver crashed with signal {-probe.returncode}", remedy)
    if probe.returncode > 0:
        return Check("OpenGL", "warn", _last_line(probe.stderr).removeprefix("luxloop.world.rendering.rasterise.NoOpenGL: "), remedy)
    renderer = _last_line(probe.stdout)
    kind = "software" if re.search("llvmpipe|softpipe|swrast", renderer) else "GPU"
    beside = "; triton is loaded before it, since it crashes after it" if find_spec("triton") else ""
    return Check("OpenGL", "ok", f"{renderer}, {kind}{beside}")


@_failing_with("ray caster", f"{PIP} --force-reinstall embreex trimesh")
def ray_caster_check() -> Check:
    import torch

    from luxloop.world.scene.embree import EmbreeMesh

    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]).double()
    mesh = EmbreeMesh(corners, torch.tensor([[0, 1, 2]]), torch.tensor([False]))
    if len(mesh.cast(torch.tensor([0.2, 0.2, 5.0]).double(), torch.tensor([[0.0], [0.0], [-1.0]]), torch.tensor([torch.inf]))[0]) != 1:
        raise RuntimeError("a ray missed the triangle that it was cast at")
    return Check("ray caster", "ok", f"embree, embreex {metadata.version('embreex')}")


@_failing_with("devices", f"{PIP} --force-reinstall torch")
def device_check() -> Check:
    import torch

    gpus = [f"cuda:{i} ({torch.cuda.get_device_name(i)})" for i in range(torch.cuda.device_count())]
    found = ", ".join([f"cpu ({torch.get_num_threads()} threads)", *gpus])
    if not gpus and shutil.which("nvidia-smi"):
        found = f"{found}; an NVIDIA driver is here, but torch {torch.__version__} does not use it"
        return Check("devices", "warn", found, f"{PIP} --force-reinstall torch")
    return Check("devices", "ok", found)


@_failing_with("video", f"{PIP} --force-reinstall --only-binary av av")
def video_check() -> Check:
    import av

    return Check("video", "ok", f"H.264 by {av.Codec('h264', 'w').name}, PyAV {av.__version__}")


@_failing_with("data", "unset LUXLOOP_DATA")
def data_check() -> Check:
    """Which registered road scans and photometric files are in the folder `LUXLOOP_DATA` or among fetched files."""
    from luxloop.loop.scenario import data

    names, own = data.registry(), os.environ.get(data.FOLDER_VARIABLE)
    here = sum(data.present(name) is not None for name in names)
    looked = f"{data.FOLDER_VARIABLE} is {own or 'not set'}, fetched files are in {data.cache_folder()}"
    found = f"{here} of {len(names)} road and photometric files; {looked}"
    return Check("data", "ok", found) if here else Check("data", "warn", f"{found}; measured roads cannot be run", "luxloop data get all")


@_failing_with("working folder", "cd ~  # or give luxloop run --out a folder that you may write to")
def folder_check(folder: Path) -> Check:
    """Whether recordings can be written to a folder."""
    with tempfile.TemporaryFile(dir=folder):
        return Check("working folder", "ok", f"{folder} can be written to")
