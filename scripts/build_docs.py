"""Build the documentation as a site in build/site, which needs no network to be built or read: `make docs`.

Its pages are docs/, the project's own pages, the files that these link to, and the public names of `luxloop` with their docstrings.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from reference import with_tables

import luxloop

ROOT = Path(__file__).resolve().parents[1]
STAGE = ROOT / "build" / "docs"
TOUR = "tour.md"  # a README.md would take the place of index.md


def place(path: Path) -> str:
    """Where a file of the project lies on the site; source is a text, which browsers show."""
    if path.is_relative_to(ROOT / "docs"):
        return path.relative_to(ROOT / "docs").as_posix()
    name = path.relative_to(ROOT).as_posix()
    return {"README.md": TOUR}.get(name, name if path.suffix == ".md" else f"source/{name}.txt")


def stage(page: Path) -> None:
    """A page whose links lead to the site's copies, and these copies where they are no pages."""

    def moved(link: re.Match[str]) -> str:
        path = (page.parent / link[1]).resolve()
        copy = STAGE / place(path)
        if not copy.exists() and path.suffix != ".md":
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
        return f"]({os.path.relpath(copy, (STAGE / place(page)).parent)}"

    (STAGE / place(page)).parent.mkdir(parents=True, exist_ok=True)
    text = re.sub(
        r"^```(\w+) \w+$", r"```\1", with_tables(page.read_text("utf-8")), flags=re.M
    )  # a second word tells tests what a block is
    (STAGE / place(page)).write_text(re.sub(r"\]\((?!https?:|#)([^)#\s]+)", moved, text), "utf-8")


def names() -> str:
    """A page of the public names."""
    entries = (f"::: luxloop.{name}" for name in luxloop.__all__)
    return "\n\n".join(["# Public names", "What programs import from `luxloop`. [Python](python.md) shows how they are used.", *entries])


def main() -> int:
    shutil.rmtree(STAGE, ignore_errors=True)
    STAGE.mkdir(parents=True)
    for page in (*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")):
        stage(page)
    (STAGE / "names.md").write_text(names(), "utf-8")
    return subprocess.run([Path(sys.executable).with_name("zensical"), "build", "--clean", "--strict"], cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main())
