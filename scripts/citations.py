"""Which function implements which equation, section, figure and table of the thesis, as docstrings cite them.

A docstring cites a section as T 7.3.3, an equation as T eq. 7.4.1, a figure as T fig. 7.10, tables as T tables 8.2 and 8.3, and several of
them as (T 7.5.2, eq. 7.4.1 to 7.4.3).
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from luxloop.loop.report.terminal import markdown_table

ROOT = Path(__file__).parents[1]
PACKAGES = ("world", "perception", "controllers", "loop", "benchmarks/sparse")

NUMBER = r"(?:\d+|[AB])(?:\.\d+)*"
LIST = rf"{NUMBER}(?:(?:, | and | to ){NUMBER})*"
PART = rf"(?:(eq|fig|tab)\w*\.? )?({LIST})"
UNNAMED = PART.replace("(eq", "(?:eq").replace(f"({LIST})", LIST)
CITATION = re.compile(rf"\bT ({UNNAMED}(?:,? (?:and )?{UNNAMED})*)")
KINDS = {"": "", "eq": "eq", "fig": "fig", "tab": "table"}


class Citation(NamedTuple):
    """kind: eq, fig, table, or nothing for a section. name: of what cites it. meaning: what that is."""

    kind: str
    number: str
    file: str
    name: str
    meaning: str


def order(number: str) -> list[int]:
    return [ord(part) if part.isalpha() else int(part) for part in number.split(".")]


def numbers(text: str) -> list[str]:
    """Those of a list such as `7.4.1 to 7.4.3, 7.4.5`."""
    found: list[str] = []
    for word, number in re.findall(rf"(to )?({NUMBER})", text):
        section, _, last = number.rpartition(".")
        first = int(found[-1].rpartition(".")[2]) + 1 if word else int(last or 0)
        found += [f"{section}.{k}" for k in range(first, int(last) + 1)] if word else [number]
    return found


def cited(text: str) -> Iterator[tuple[str, str]]:
    """Kind and number of all that a docstring cites."""
    for citation in CITATION.findall(" ".join(text.split())):
        for kind, of_kind in re.findall(PART, citation):
            yield from ((KINDS[kind], number) for number in numbers(of_kind))


def meaning(docstring: str) -> str:
    """Its first sentence, without what it cites."""
    text = re.sub(rf" ?\({CITATION.pattern}[^()]*\)", "", " ".join(docstring.split("\n\n")[0].split()))
    text = re.split(r"(?<!eq)(?<!fig)\.\s", text)[0]
    return text.rstrip(".:").replace("|", "\\|")


def documented(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Name and docstring of a module (no name), its classes and its functions."""

    def inside(node: ast.Module | ast.ClassDef | ast.FunctionDef, name: str) -> Iterator[tuple[str, str]]:
        yield name, ast.get_docstring(node) or ""
        for child in node.body:
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                yield from inside(child, f"{name}.{child.name}".lstrip("."))

    return inside(tree, "")


@cache
def citations() -> list[Citation]:
    """All citations of the thesis in docstrings, by number and place; a module's only where none of its functions has the same."""
    found = set()
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for name, docstring in documented(ast.parse(path.read_text("utf-8"))):
            file = path.relative_to(ROOT).as_posix()
            found |= {Citation(kind, number, file, name, meaning(docstring)) for kind, number in cited(docstring)}
    by_functions = {(each.kind, each.number, each.file) for each in found if each.name}
    kept = [each for each in found if each.name or (each.kind, each.number, each.file) not in by_functions]
    return sorted(kept, key=lambda each: (each.kind, order(each.number), each.file, each.name))


def cited_table(which: str) -> str:
    """A table of what cites `equations`, or `sections`, figures and tables."""
    kinds = {"equations": {"eq": ""}, "sections": {"": "", "fig": "fig. ", "table": "table "}}[which]
    rows = []
    for kind, number, file, name, what in (each for each in citations() if each.kind in kinds):
        rows.append((f"{kinds[kind]}{number}", f"[{file}](../{file})" + (f" `{name}`" if name else ""), what))
    return markdown_table(("T", "file and function", "meaning"), rows, "l")
