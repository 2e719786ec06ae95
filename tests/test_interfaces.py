"""docs/interfaces.md has the fields of what parts of one's own get and give, as annotations and docstrings say.

The docstring of a class describes a field as `name: what it is.`, or names it in backticks in its first sentence, and says when it is None.
`python -m tests.test_interfaces` writes the tables of the page anew.
"""

import ast
import inspect
import re
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path

import pytest

from loop.terminal.tables import markdown

PAGE = Path(__file__).parents[1] / "docs" / "interfaces.md"
MARKED = re.compile(r"(?<=<!-- )(fields|calls)( of )([\w.]+):(\w+)( -->\n)(?:\|.*\n)*")
CLASSES = [pytest.param(module, name, id=name) for kind, _, module, name, _ in MARKED.findall(PAGE.read_text("utf-8")) if kind == "fields"]


def source(module: str, name: str) -> ast.ClassDef:
    tree = ast.parse(inspect.getsource(getattr(import_module(module), name))).body[0]
    assert isinstance(tree, ast.ClassDef)
    return tree


def annotated(module: str, name: str) -> dict[str, ast.AnnAssign]:
    return {ast.unparse(each.target): each for each in source(module, name).body if isinstance(each, ast.AnnAssign)}


def described(module: str, name: str) -> dict[str, str]:
    """What the docstring of a class says of each of its fields."""
    text = " ".join((getattr(import_module(module), name).__doc__ or "").split())
    field = "|".join(annotated(module, name))
    parts = re.split(rf"(?:^|(?<=[.;] ))((?:{field})(?:, (?:{field}))*): ", text)
    found = {each: meaning.strip(" .;") for names, meaning in zip(parts[1::2], parts[2::2], strict=True) for each in names.split(", ")}
    return {each: parts[0].split(". ")[0].strip(" .") for each in annotated(module, name) if f"`{each}`" in parts[0]} | found


def fields(module: str, name: str) -> str:
    meanings = described(module, name)
    rows = []
    for each, field in annotated(module, name).items():
        kind = ast.unparse(field.annotation) + (f" = {ast.unparse(field.value)}" if field.value else "")
        rows.append((f"`{each}`", "`" + kind.replace("|", "\\|") + "`", meanings.get(each, "")))
    return markdown(("field", "type", "meaning"), rows, "l") + "\n"


def calls(module: str, name: str) -> str:
    rows = []
    for method in (each for each in source(module, name).body if isinstance(each, ast.FunctionDef) and each.name[0] != "_"):
        asked = ", ".join(each.arg for each in method.args.args[1:])
        is_value = any(ast.unparse(each).endswith("property") for each in method.decorator_list)
        returned = ast.unparse(method.returns).strip("'").replace("|", "\\|") if method.returns else ""
        meaning = " ".join((ast.get_docstring(method) or "").split())
        rows.append((f"`{method.name}`" if is_value else f"`{method.name}({asked})`", f"`{returned}`", meaning))
    return markdown(("call", "returns", "meaning"), rows, "l") + "\n"


def with_tables(text: str) -> str:
    makers = {"fields": fields, "calls": calls}
    return MARKED.sub(
        lambda match: f"{''.join(match.group(1, 2, 3))}:{''.join(match.group(4, 5))}{makers[match[1]](*match.group(3, 4))}", text
    )


def test_the_page_says_what_the_classes_say() -> None:
    text = PAGE.read_text("utf-8")
    assert with_tables(text) == text, "fields or docstrings have changed: write the tables anew with `python -m tests.test_interfaces`"


@pytest.mark.parametrize(("module", "name"), CLASSES)
def test_every_field_is_described(module: str, name: str) -> None:
    assert is_dataclass(getattr(import_module(module), name))
    meanings = described(module, name)
    for each, field in annotated(module, name).items():
        assert each in meanings, f"the docstring of {name} does not say what {each} is"
        assert "None" not in ast.unparse(field.annotation) or "None" in meanings[each], f"say when {each} of {name} is None"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text("utf-8")), "utf-8")
