"""Parts of the user's own are found by name, and what is wrong with them is said in one sentence."""

import copy
import sys
from pathlib import Path

import pytest
from pydantic import Field

from luxloop.world import plugin
from luxloop.world.errors import LuxloopError
from luxloop.world.params import Params
from tests.refusal import refusal

PARTS = """
class Part:
    def __init__(self, a, share=0.5):
        self.a, self.share = a, share
    def work(self):
        pass

class Shared(Part):
    def __init__(self, a, share):
        super().__init__(a, share)

class Any(Part):
    def __init__(self, *everything, **more):
        super().__init__(more["c"])

class Bare(Part):
    def __init__(self, a, /):
        super().__init__(a)

class OfFile(Part):
    def __init__(self, a, file):
        open(file)

class OfShapes(Part):
    def __init__(self, a):
        helper()

def helper():
    raise RuntimeError("shapes do not fit:\\n  2 and 3")

class Failing(Part):
    def work(self):
        helper()
    def over(self):
        return Failing(4)
"""


class Checked(Params):
    """Options that are checked."""

    share: float = Field(gt=0)

    def work(self) -> None: ...


@pytest.fixture
def parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_parts.py").write_text(PARTS)
    (tmp_path / "broken_parts.py").write_text("1 / 0\n")
    (tmp_path / "half_written_parts.py").write_text("class Part(:\n")
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("no_such_parts:Part", {}, ["No module named 'no_such_parts'", "PYTHONPATH"]),
        ("broken_parts:Part", {}, ["importing broken_parts fails at ", "broken_parts.py, line 1 (ZeroDivisionError"]),
        ("half_written_parts:Part", {}, ["importing half_written_parts fails", "SyntaxError", "line 1"]),
        ("own_parts:Port", {}, ["own_parts has no Port; did you mean 'Part'?"]),
        ("own_parts:helper", {}, ["helper is no class; known are Part, Shared, "]),
        (
            "own_parts:OfFile",
            {"file": "no.csv"},
            ["the place and road.options fails at ", "own_parts.py, line 22 (FileNotFoundError: ", "no.csv"],
        ),
        ("own_parts:OfShapes", {}, ["own_parts.py, line 29 (RuntimeError: shapes do not fit: 2 and 3)"]),
        ("own_parts:Part", {}, ["no method rest", "work, rest"]),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(name, options, words):
    with pytest.raises(LuxloopError) as error:
        plugin.make(plugin.Name(name), "road.kind", {"place": 3}, options, ("work", "rest") if name.endswith(":Part") else ("work",))
    message = str(error.value)
    assert message.startswith(f"road.kind: {name}: ") and all(word in message for word in words), message


@pytest.mark.usefixtures("parts")
@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("own_parts:Part", {"shore": 1}, "road.options.shore: own_parts:Part has no option of this name; did you mean 'share'?"),
        ("own_parts:Part", {"a": 1}, "road.options.a: own_parts:Part has no option of this name; known are share"),  # 'a' is the place
        ("own_parts:Part", {"share": "0,3"}, "road.options.share: is the text '0,3'; write 0.3"),
        ("own_parts:Part", {"share": "much"}, "road.options.share: is the text 'much'; write a number"),
        (f"{__name__}:Checked", {"share": "0,3"}, "road.options.share: is the text '0,3'; write 0.3"),
        ("own_parts:Shared", {}, "road.options.share: is missing, and own_parts:Shared has no default for it; add it"),
        (
            "own_parts:Bare",
            {"b": 1},
            "road.options.b: own_parts:Bare has no option of this name; leave it out, for it takes none",
        ),
        (
            "own_parts:Shared",
            {"zzz": 2},
            "2 errors\n"
            "  road.options.zzz: own_parts:Shared has no option of this name; known are share\n"
            "  road.options.share: is missing, and own_parts:Shared has no default for it; add it",
        ),
        (f"{__name__}:Checked", {"Share": 1}, f"road.options.Share: {__name__}:Checked has no option of this name; did you mean 'share'?"),
    ],
)
def test_a_wrong_option_is_named_by_its_key(name, options, message):
    given = {} if name.endswith("Checked") else {"place": 3}
    with pytest.raises(LuxloopError) as error:
        plugin.make(plugin.Name(name), "road.kind", given, options, ("work",))
    assert str(error.value) == message


@pytest.mark.usefixtures("parts")
def test_what_takes_any_option_gets_them_all():
    assert plugin.make(plugin.Name("own_parts:Any"), "road.kind", {"place": 3}, {"c": 4}, ("work",)).a == 4


def test_options_that_a_model_refuses_are_told_in_one_line():
    with refusal(r"road\.options fails \(share: Input should be greater than 0\)$"):
        plugin.make(plugin.Name(f"{__name__}:Checked"), "road.kind", {}, {"share": -1}, ())


@pytest.mark.usefixtures("parts")
def test_a_method_that_fails_is_said_as_init_is():
    made = plugin.make(plugin.Name("own_parts:Failing"), "road.kind", {"place": 3}, {}, ("work",))
    with refusal(r"^road\.kind: own_parts:Failing: work fails at .*own_parts\.py, line 29 \(RuntimeError: "):
        made.work()
    again = made.over()
    assert again.a == 4 and isinstance(again.__class__, type)
    with refusal("work fails at"):
        again.work()
    assert copy.copy(made).a == 3


def test_a_folder_goes_to_the_end_of_the_path_and_hides_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "own_part_in_two_folders.py").write_text("class Part:\n    def work(self):\n        return __file__\n")
    (tmp_path / "a" / "json.py").write_text("class Part:\n    def work(self):\n        pass\n")
    name = plugin.beside("own_part_in_two_folders:Part", tmp_path / "a")
    assert (
        name == f"{tmp_path}/a/own_part_in_two_folders:Part"
        and plugin.beside("own_parts_elsewhere:Part", tmp_path) == "own_parts_elsewhere:Part"
    )
    assert plugin.make(plugin.Name(name), "road.kind", {}, {}, ("work",)).work() == f"{tmp_path}/a/own_part_in_two_folders.py"
    assert sys.path[-1] == str(tmp_path / "a")
    for other in ("../b/own_part_in_two_folders:Part", "json:Part"):
        with refusal(r"Python knows another module of this name, .*\.py; rename /"):
            plugin.load(plugin.Name(plugin.beside(other, tmp_path / "a")), "road.kind", ("work",))
