"""docs/equations.md says which function implements which equation of the thesis; docs/thesis_coverage.md lists its systems.

A docstring cites a section as T 7.3.3, an equation as T eq. 7.4.1, a figure as T fig. 7.10, tables as T tables 8.2 and 8.3, and several of
them as (T 7.5.2, eq. 7.4.1 to 7.4.3). `python -m tests.test_equations` writes the tables of the page anew.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from loop.terminal.tables import markdown

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "equations.md"
COVERAGE = ROOT / "docs" / "thesis_coverage.md"
PACKAGES = ("world", "perception", "controllers", "loop")

# What there is to cite: how many sections a chapter or section has, and how many equations.
SECTIONS = "1:3 2:5 3:5 3.1:2 3.5:3 4:3 4.2:2 5:4 6:3 7:5 7.2:2 7.3:3 7.4:2 7.5:2 8:5 9:4 9.4:3 A:5 B:5 B.3:3"
EQUATIONS = "2.1:6 2.3:5 2.4:1 3.1:3 3.5:2 5.2:2 5.3:1 6.2:1 7.2:1 7.3:4 7.4:5 8.3:3 9.4:4 B.1:4 B.2:4"

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


def numbered(counts: str) -> set[str]:
    """1.1, 1.2 and 1.3 of 1:3, and so on."""
    pairs = [pair.split(":") for pair in counts.split()]
    return {f"{above}.{k}" for above, count in pairs for k in range(1, int(count) + 1)}


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


def table(kinds: dict[str, str]) -> str:
    """Of citations of these kinds, each with the word that stands before its number."""
    rows = []
    for kind, number, file, name, what in (each for each in citations() if each.kind in kinds):
        rows.append((f"{kinds[kind]}{number}", f"[{file}](../{file})" + (f" `{name}`" if name else ""), what))
    return markdown(("T", "file and function", "meaning"), rows, "l") + "\n"


TABLES = {"equations": {"eq": ""}, "sections": {"": "", "fig": "fig. ", "table": "table "}}
MARKED = re.compile(r"(?<=<!-- cited )(\w+)( -->\n)(?:\|.*\n)*")


def with_tables(text: str) -> str:
    return MARKED.sub(lambda match: f"{match[1]}{match[2]}{table(TABLES[match[1]])}", text)


def test_every_citation_names_what_the_thesis_has() -> None:
    sections = numbered(SECTIONS) | {*map(str, range(1, 11)), "A", "B"}
    wrong = [each for each in citations() if each.number not in {"": sections, "eq": numbered(EQUATIONS)}.get(each.kind, {each.number})]
    assert not wrong, "a section is cited as T 7.3.3, an equation as T eq. 7.4.1"


def test_the_page_says_what_docstrings_cite() -> None:
    text = PAGE.read_text("utf-8")
    assert with_tables(text) == text, "docstrings have changed: write the tables anew with `python -m tests.test_equations`"


def test_every_equation_is_implemented_or_said_not_to_be() -> None:
    implemented = {each.number for each in citations() if each.kind == "eq"}
    rest = PAGE.read_text("utf-8").partition("## Equations without code")[2].partition("\n## ")[0]
    without = {number for row in re.findall(r"^\| ([AB\d][^|]*) \|", rest, re.M) for number in numbers(row)}
    assert not implemented & without
    assert implemented | without == numbered(EQUATIONS)


def test_the_coverage_of_the_thesis_has_every_section() -> None:
    """With a file and a test, which tests/test_docs.py looks for, or what is open."""
    rows = re.findall(r"^\| ([AB\d][^|]*) \| ([^|]*) \|(.*?)\|(.*?)\|(.*?)\|$", COVERAGE.read_text("utf-8"), re.M)
    listed = {number for row in rows for number in numbers(row[0])}
    for section in numbered(SECTIONS) - numbered("1:3") | {"10"}:
        assert any(f"{each}.".startswith(f"{section}.") or f"{section}.".startswith(f"{each}.") for each in listed), section
    for number, system, file, test, lacking in rows:
        assert ("](../tests/" in test and "](" in file) or (lacking.strip() and not test.strip()), f"{number} {system}"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text("utf-8")), "utf-8")
