"""docs/thesis.md says which function implements which equation of the thesis, and lists its systems."""

import re
from pathlib import Path

from citations import citations, cited_table, numbers

PAGE = (Path(__file__).parents[1] / "docs" / "thesis.md").read_text("utf-8")

# What there is to cite: how many sections a chapter or section has, and how many equations.
SECTIONS = "1:3 2:5 3:5 3.1:2 3.5:3 4:3 4.2:2 5:4 6:3 7:5 7.2:2 7.3:3 7.4:2 7.5:2 8:5 9:4 9.4:3 A:5 B:5 B.3:3"
EQUATIONS = "2.1:6 2.3:5 2.4:1 3.1:3 3.5:2 5.2:2 5.3:1 6.2:1 7.2:1 7.3:4 7.4:5 8.3:3 9.4:4 B.1:4 B.2:4"


def numbered(counts: str) -> set[str]:
    """1.1, 1.2 and 1.3 of 1:3, and so on."""
    pairs = [pair.split(":") for pair in counts.split()]
    return {f"{above}.{k}" for above, count in pairs for k in range(1, int(count) + 1)}


def test_every_citation_names_what_the_thesis_has():
    sections = numbered(SECTIONS) | {*map(str, range(1, 11)), "A", "B"}
    wrong = [each for each in citations() if each.number not in {"": sections, "eq": numbered(EQUATIONS)}.get(each.kind, {each.number})]
    assert not wrong, "a section is cited as T 7.3.3, an equation as T eq. 7.4.1"


def test_the_tables_of_the_site_list_equations_and_sections():
    assert "| 7.3.2 |" in cited_table("equations") and "| 9.4.2 |" in cited_table("sections")


def test_every_equation_is_implemented_or_said_not_to_be():
    implemented = {each.number for each in citations() if each.kind == "eq"}
    rest = PAGE.partition("## Equations without code")[2].partition("\n## ")[0]
    without = {number for row in re.findall(r"^\| ([AB\d][^|]*) \|", rest, re.M) for number in numbers(row)}
    assert not implemented & without
    assert implemented | without == numbered(EQUATIONS)


def test_the_coverage_of_the_thesis_has_every_section():
    """With a file and a test, which tests/test_docs.py looks for, or what is open."""
    rows = re.findall(r"^\| ([AB\d][^|]*) \| ([^|]*) \|(.*?)\|(.*?)\|(.*?)\|$", PAGE.partition("# Coverage")[2], re.M)
    listed = {number for row in rows for number in numbers(row[0])}
    for section in numbered(SECTIONS) - numbered("1:3") | {"10"}:
        assert any(f"{each}.".startswith(f"{section}.") or f"{section}.".startswith(f"{each}.") for each in listed), section
    for number, system, file, test, lacking in rows:
        assert ("](../tests/" in test and "](" in file) or (lacking.strip() and not test.strip()), f"{number} {system}"
