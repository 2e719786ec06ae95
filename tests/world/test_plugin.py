"""Parts of the user's own are found by name, and what is wrong with them is said in one sentence."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import Field

from world import plugin
from world.errors import LuxloopError
from world.params import Params

PARTS = """
class Part:
    def __init__(self, a, share=0.5):
        self.a, self.share = a, share
    def work(self):
        pass

def part(a, share):
    return Part(a, share)

def part_with_any(*everything, **more):
    return Part(more["c"])

def bare(a, /):
    return Part(a)

def part_of_file(a, file):
    return open(file)

def part_of_shapes(a):
    raise RuntimeError("shapes do not fit:\\n  2 and 3")
"""


class Checked(Params):
    """Options that are checked."""

    share: float = Field(gt=0)


@pytest.fixture
def parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_parts.py").write_text(PARTS)
    (tmp_path / "broken_parts.py").write_text("1 / 0\n")
    (tmp_path / "half_written_parts.py").write_text("class Part(:\n")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("parts")
def test_classes_and_functions_make_a_part() -> None:
    for name in ("own_parts:Part", "own_parts:part"):
        made = plugin.make(name, "road.kind", {"place": 3}, {"share": 0.25}, ("work",))
        assert (made.a, made.share) == (3, 0.25)
    assert plugin.load("math:tau", "road.kind") > 6


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("no_such_parts:Part", {}, ["No module named 'no_such_parts'", "PYTHONPATH"]),
        ("broken_parts:Part", {}, ["broken_parts fails", "ZeroDivisionError"]),
        ("half_written_parts:Part", {}, ["half_written_parts fails", "SyntaxError", "line 1"]),
        ("own_parts:Port", {}, ["own_parts has no Port"]),
        ("own_parts:part_of_file", {"file": "no.csv"}, ["road.options (FileNotFoundError: ", "no.csv"]),
        ("own_parts:part_of_shapes", {}, ["(RuntimeError: shapes do not fit: 2 and 3)"]),
        ("own_parts:Part", {}, ["no method rest", "work, rest"]),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(name: str, options: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(LuxloopError) as error:
        plugin.make(name, "road.kind", {"place": 3}, options, ("work", "rest"))
    message = str(error.value)
    assert message.startswith(f"road.kind: {name}: ") and all(word in message for word in words), message


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("own_parts:Part", {"shore": 1}, "road.options.shore: own_parts:Part has no option of this name; did you mean 'share'?"),
        ("own_parts:Part", {"a": 1}, "road.options.a: own_parts:Part has no option of this name; known are share"),  # 'a' is the place
        ("own_parts:part", {}, "road.options.share: is missing, and own_parts:part has no default for it; add it"),
        (
            "own_parts:bare",
            {"b": 1},
            "road.options.b: own_parts:bare has no option of this name; leave it out, for it takes none",
        ),
        (f"{__name__}:Checked", {"Share": 1}, f"road.options.Share: {__name__}:Checked has no option of this name; did you mean 'share'?"),
    ],
)
def test_a_wrong_option_is_named_by_its_key(name: str, options: dict[str, Any], message: str) -> None:
    given = {} if name.endswith("Checked") else {"place": 3}
    with pytest.raises(LuxloopError) as error:
        plugin.make(name, "road.kind", given, options, ("work",))
    assert str(error.value) == message


@pytest.mark.usefixtures("parts")
def test_what_takes_any_option_gets_them_all() -> None:
    assert plugin.make("own_parts:part_with_any", "road.kind", {"place": 3}, {"c": 4}, ("work",)).a == 4


def test_options_that_a_model_refuses_are_told_in_one_line() -> None:
    with pytest.raises(LuxloopError, match=r"road\.options \(share: Input should be greater than 0\)$"):
        plugin.make(f"{__name__}:Checked", "road.kind", {}, {"share": -1}, ())
