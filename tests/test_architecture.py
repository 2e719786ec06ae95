"""The plan of the house, held by reading imports: loop -> controllers -> perception -> world, folders without circles, and
`luxloop`, the door before them."""

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
ORDER = ("world", "perception", "controllers", "loop", "luxloop")  # each may import those before it
DATA = {"scenarios"}  # of loop only
INSIDE = {*ORDER[:-1], *DATA}  # what is imported as luxloop.NAME
MODULES = [path.relative_to(ROOT) for package in ORDER for path in sorted((ROOT / package).rglob("*.py"))]
FOLDERS = sorted({module.parent for module in MODULES})
TESTS = [path.relative_to(ROOT) for package in ORDER for path in sorted((ROOT / "tests" / package).rglob("*.py"))]
USERS = {("loop", "luxloop")}  # tests that may import a higher package: those of loop use the front door as programs do
DOORS = {Path("luxloop"), Path("loop/commands")}  # which may import from everywhere, and which nothing imports
OPENGL = {"pyrender", "OpenGL", "pyglet"}
OPENGL_AT = Path("world/rendering/rasterise.py")  # which makes the context
DRAWS_WITH_IT = Path("world/rendering/deferred.py")
GROWS = r"\.(add|append|clear|extend|insert|pop|popitem|remove|setdefault|update)\("
TRICKS = re.compile(r"object\.__setattr__|\bcopy\.copy\(|from copy import copy\b|vars\(.*?\)\[.*\] = |^ +global ", re.M)


@cache
def text_of(module: Path) -> str:
    return (ROOT / module).read_text("utf-8")


@cache
def parsed(source: str) -> ast.Module:
    return ast.parse(source)


@cache
def imported(source: str) -> set[str]:
    """All that a module imports, at its head or inside functions: `a.b.c` of `from a.b import c`, `world.c` of `from luxloop.world import
    c`, what begins with "." of relative imports."""
    return {
        name.removeprefix("luxloop.") if name.partition("luxloop.")[2].partition(".")[0] in INSIDE else name for name in named_in(source)
    }


@cache
def named_in(source: str) -> set[str]:
    """Names of imports as they stand."""
    names = set()
    for node in ast.walk(parsed(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{'.' * node.level}{node.module or ''}.{alias.name}" for alias in node.names}
    return names


def tops(names: set[str]) -> set[str]:
    return {name.partition(".")[0] or "." for name in names}


def folder_of(name: str) -> Path | None:
    """Where a module, or that of which this is a part, lies; None where it is none of ours."""
    for path in (Path(*name.split(".")), Path(*name.split(".")[:-1])):
        if path.parts and path.parts[0] in ORDER:
            if (ROOT / path).with_suffix(".py").is_file():
                return path.parent
            if (ROOT / path / "__init__.py").is_file():
                return path
    return None


@cache
def arrows(folder: Path) -> set[Path]:
    """The other folders from which its modules import."""
    sources = [text_of(module) for module in MODULES if module.parent == folder]
    return {found for source in sources for name in imported(source) if (found := folder_of(name))} - {folder}


def test_imports_are_found_wherever_they_stand():
    source = "import a.b, c as d\nfrom e.f import g\ndef h():\n    from . import i\n    import j\n"
    assert tops(imported(source)) == {"a", "c", "e", ".", "j"}
    names = imported(
        "from luxloop.world import plugin\nfrom luxloop.world.headlight import Headlight\n"
        "import luxloop.world.light.ambient\nimport torch.fft\n"
    )
    assert {folder_of(name) for name in names} == {Path("world"), Path("world/headlight"), Path("world/light"), None}


def test_imports_point_one_way():
    wrong = []
    for module in MODULES:
        package, names = module.parts[0], tops(imported(text_of(module)))
        barred = {*ORDER[ORDER.index(package) + 1 :], *(DATA if package != "loop" else ()), "tests", "benchmarks", "examples"}
        wrong += [f"{module}: {package} must not import {name}" for name in sorted(names & barred)]
        wrong += [f"{module}: name the package in imports"] * ("." in names)
        wrong += [f"{module}: import luxloop.{name}" for name in sorted(tops(named_in(text_of(module))) & INSIDE)]
    for test in TESTS:
        package = test.parts[1]
        higher = tuple(f"{name}." for name in (*ORDER[ORDER.index(package) + 1 :], "benchmarks") if (package, name) not in USERS)
        found = {name for name in imported(text_of(test)) if name.removeprefix("tests.").startswith(higher)}
        wrong += [f"{test}: move it to tests/loop, where it may import {name}" for name in sorted(found)]
    assert not wrong, "\n".join(wrong)


def test_no_folders_import_each_other():
    TopologicalSorter({folder: arrows(folder) for folder in FOLDERS}).prepare()  # raises CycleError, which names them


def test_packages_name_their_folders():
    wrong = []
    for package in ORDER[:-1]:
        text = ast.get_docstring(parsed(text_of(Path(package, "__init__.py")))) or ""
        unnamed = [folder.name for folder in FOLDERS if folder.parent == Path(package) and f"`{folder.name}" not in text]
        wrong += [f"{package}/__init__.py: say what {name} offers" for name in unnamed]
    assert not wrong, "\n".join(wrong)


def test_nothing_imports_the_doors():
    wrong = [f"{folder}: must not import {door}" for folder in FOLDERS for door in arrows(folder) & DOORS]
    assert not wrong, "\n".join(wrong)


def test_opengl_stays_in_its_room():
    assert "PYGLET_HEADLESS" in text_of(OPENGL_AT), f"{OPENGL_AT}: without it pyrender needs X libraries, which a server has not"
    allowed = {OPENGL_AT: OPENGL, DRAWS_WITH_IT: {"OpenGL"}}
    wrong = [module for module in MODULES if tops(imported(text_of(module))) & OPENGL - allowed.get(module, set())]
    assert not wrong, f"OpenGL belongs in {OPENGL_AT} and {DRAWS_WITH_IT}, not in {', '.join(map(str, wrong))}"


def test_values_stay_as_they_are():
    wrong = []
    for module in MODULES:
        tree = parsed(text_of(module))
        source = ast.unparse(tree)
        wrong += [f"{module}: make another value with `replace`"] * bool(TRICKS.search(source))
        for name in re.findall(r"^(\w+)(?:: .+)? = ", source, re.M):
            wrong += [f"{module}: {name} is written while it runs"] * bool(re.search(rf"^ +{name}(\[.*\] = |{GROWS})", source, re.M))
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and any("frozen=True" in ast.unparse(each) for each in node.decorator_list):
                written = re.search(rf"^ +self\.\w+(\[.*\])? [-+*/|]?= |\bself\.\w+{GROWS}", ast.unparse(node), re.M)
                wrong += [f"{module}: {node.name} is frozen"] * bool(written)
    assert not wrong, "\n".join(wrong)


def test_the_page_of_the_house_names_every_folder_and_only_files_that_exist():
    page = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    named = re.findall(r"`((?:world|perception|controllers|loop)/[a-z_/]+\.py)`", page)
    assert named and all((ROOT / name).is_file() for name in named)
    table = page.partition("## Folders")[2].partition("## One step")[0]
    missing = [
        str(folder) for folder in FOLDERS if len(folder.parts) == 2 and f"`{folder.name}`" not in table and f"/{folder.name}`" not in table
    ]
    assert not missing
