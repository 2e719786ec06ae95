"""Code that decides a run: source files of the user's own modules, and the digest of luxloop's code."""

import ast
import hashlib
import site
import sysconfig
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib.machinery import PathFinder
from importlib.resources import files
from importlib.util import resolve_name
from pathlib import Path

from luxloop.world.errors import LuxloopError
from luxloop.world.plugin import PACKAGE, file_of

OURS = "luxloop"
PYTHONS_OWN = Path(sysconfig.get_path("stdlib"))
INSTALLED = {Path(site.getusersitepackages()), *(Path(sysconfig.get_path(kind)) for kind in ("purelib", "platlib"))}


def sources_of(module: str, folder: Path | None = None) -> dict[str, Path]:
    """Source files by module name: a module, the packages around it, and all modules that these import, found without running any.

    Imports are followed within the folder, by default the folder in which Python finds the module; of an installed module, within its own
    package. Empty for an unknown module and for Python's own. Raises LuxloopError where a file is not Python. The standard library's
    modulefinder fails at packages without `__init__.py` and at relative imports that find nothing.
    """
    top = module.partition(".")[0]
    folder = folder or _folder_of(top)
    if folder in (None, PYTHONS_OWN) or top == OURS:
        return {}
    only_its_own = folder in INSTALLED
    found = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        start = name.partition(".")[0]
        if name in found or start == OURS or (only_its_own and start != top):
            continue
        file = file_of(folder, name)
        if file is not None:
            found[name] = file
            waiting += _imports(file, name if file.name == PACKAGE else name.rpartition(".")[0])
        if "." in name:
            waiting.append(name.rpartition(".")[0])
    return found


def _folder_of(top: str) -> Path | None:
    spec = PathFinder.find_spec(top)
    if spec is None:
        return None
    within = list(spec.submodule_search_locations or ())
    return Path(within[0]).parent if within else Path(spec.origin or "").parent


def _imports(file: Path, package: str) -> Iterator[str]:
    """Imported names, which may be modules."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError, OSError) as error:
        raise LuxloopError(f"{file}: cannot be read as Python ({error}); correct it") from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            with suppress(ImportError):  # beyond the top package
                base = resolve_name("." * node.level + (node.module or ""), package)
                yield base
                yield from (f"{base}.{alias.name}" for alias in node.names)


LAYERS = ("world", "perception", "controllers", "loop")
WITHOUT_EFFECT = (  # folders and files that decide no figure of a run
    *("loop/commands/", "loop/report/", "loop/studies/beams.py", "loop/studies/jobs.py"),
    *(f"loop/studies/{folder}/" for folder in ("contracts", "evaluation", "training")),
)


@cache
def digest_of_code() -> str:
    """SHA-256, hexadecimal, of all files of world, perception, controllers and loop that decide figures of a run."""
    digest = hashlib.sha256()
    root = Path(str(files("luxloop")))
    for package in LAYERS:
        for path in sorted((root / package).rglob("*")):
            name = path.relative_to(root).as_posix()
            if path.is_file() and path.suffix != ".pyc" and not name.startswith(WITHOUT_EFFECT):
                digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()
