"""The wheel holds everything that luxloop runs on, and runs away from the checkout."""

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
PACKAGES = ["luxloop", "world", "perception", "controllers", "loop", "scenarios"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, for setuptools would leave its work (and find that of earlier builds) in the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    subprocess.run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, source], check=True)
    (built,) = folder.glob("*.whl")
    return built


def test_wheel_holds_every_file_of_the_packages(wheel):
    shipped = set(zipfile.ZipFile(wheel).namelist())
    ours = {
        ("" if package == "luxloop" else "luxloop/") + path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert ours - shipped == set()
    assert {name.split("/")[0] for name in shipped if ".dist-info/" not in name} == {"luxloop"}
    assert any(name.endswith("licenses/LICENSE") for name in shipped)


@pytest.fixture(scope="module")
def luxloop(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Run a command line with what the wheel holds, away from the checkout; gives the folder that it ran in."""
    site, folder = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("work")
    zipfile.ZipFile(wheel).extractall(site)
    program = "import sys; from luxloop.loop.commands import cli; assert cli.__file__.startswith(sys.argv.pop(1)); sys.exit(cli.main())"

    def run(*arguments: str) -> Path:
        environment = {**os.environ, "PYTHONPATH": str(site)}
        subprocess.run([sys.executable, "-c", program, str(site), *arguments], cwd=folder, env=environment, check=True)
        return folder

    return run


def test_main_job_runs_from_the_wheel(luxloop):
    folder = luxloop("run", "snowflake", "--steps", "2", "--no-video", "--out", "out")
    assert (folder / "out" / "summary.json").is_file()


@pytest.mark.parametrize(("like", "file"), [("gfhb", "gfhb.toml"), ("lamp.toml", "lamp.toml"), ("tune_gains.py", "tune_gains.py")])
def test_what_the_documentation_names_is_copied_from_the_wheel(luxloop, like, file):
    assert (luxloop("new", "--like", like) / file).stat().st_size > 100


@cache
def needed(name: str) -> frozenset[str]:
    """Names of the packages that an installed package needs, and of those that they need."""
    try:
        asked = map(Requirement, metadata.requires(name) or [])
    except metadata.PackageNotFoundError:
        return frozenset()
    names = {canonicalize_name(r.name) for r in asked if r.marker is None or r.marker.evaluate({"extra": ""})}
    return frozenset(names.union(*(needed(each) for each in names))) - {"setuptools"}


def test_constraints_meet_what_the_project_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = {
        canonicalize_name(r.name): r for r in map(Requirement, sum(project["optional-dependencies"].values(), project["dependencies"]))
    }
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    pinned = {canonicalize_name(r.name): next(iter(r.specifier)).version for r in map(Requirement, lines)}
    assert asked.keys() | set().union(*(needed(name) for name in asked)) <= pinned.keys()
    assert all(each.specifier.contains(pinned[name]) for name, each in asked.items())


PIP = [sys.executable, "-m", "pip", "install", "--quiet"]
ADAM = """
import torch
from luxloop.world.rendering.rasterise import Rasteriser
Rasteriser()
weight = torch.nn.Parameter(torch.ones(2))
optimiser = torch.optim.Adam([weight])
weight.sum().backward()
optimiser.step()
"""


def test_an_optimiser_follows_rendering_beside_triton(tmp_path):
    """As it comes with the CUDA build of torch: its LLVM and that of Mesa crashed in one process."""
    subprocess.run([*PIP, "--no-deps", "--target", tmp_path, "triton"], check=True)
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    subprocess.run([sys.executable, "-c", f"{ADAM}import triton._C.libtriton"], env=environment, check=True)
