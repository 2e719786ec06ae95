"""The plan of the house, held by reading imports: loop -> controllers -> perception -> world, OpenGL in one room, short modules."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "world": {"world"},
    "perception": {"world", "perception"},
    "controllers": {"world", "perception", "controllers"},
    "loop": {"world", "perception", "controllers", "loop", "scenarios"},
}
MODULES = [path.relative_to(ROOT) for package in MAY_IMPORT for path in sorted((ROOT / package).rglob("*.py"))]
OPENGL = {"pyrender", "OpenGL", "pyglet"}
OPENGL_AT = Path("world/rendering/rasterise.py")  # which makes the context
DRAWS_WITH_IT = Path("world/rendering/deferred.py")
LONGEST = 450  # lines: beyond that a module holds more than one idea

each_module = pytest.mark.parametrize("module", MODULES, ids=str)


def imported(source: str) -> set[str]:
    """Top-level names of all packages that a module imports, at its head or inside functions."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add("." if node.level else (node.module or "").split(".")[0])
    return names


def test_imports_are_found_wherever_they_stand() -> None:
    source = "import a.b, c as d\nfrom e.f import g\ndef h():\n    from . import i\n    import j\n"
    assert imported(source) == {"a", "c", "e", ".", "j"}


@each_module
def test_arrows_point_one_way(module: Path) -> None:
    package = module.parts[0]
    names = imported((ROOT / module).read_text())
    assert "." not in names, f"{module}: name the package in imports"
    forbidden = names & set(MAY_IMPORT) - MAY_IMPORT[package]
    assert not forbidden, f"{module}: {package} must not import {forbidden}"
    assert not names & {"tests", "benchmarks", "examples"}


@each_module
def test_opengl_stays_in_its_room(module: Path) -> None:
    source = (ROOT / module).read_text()
    if module == OPENGL_AT:
        assert "PYGLET_HEADLESS" in source, f"{module}: without it pyrender needs X libraries, which a server has not"
    else:
        allowed = {"OpenGL"} if module == DRAWS_WITH_IT else set()
        assert not imported(source) & OPENGL - allowed, (
            f"{module}: OpenGL belongs in world/rendering/rasterise.py and world/rendering/deferred.py"
        )


@each_module
def test_module_can_be_held_in_mind(module: Path) -> None:
    assert len((ROOT / module).read_text().splitlines()) <= LONGEST
