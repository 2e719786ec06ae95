"""Errors of users as sentences, and processes that cannot simulate."""

import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from luxloop.world.errors import LuxloopError, did_you_mean, redact
from luxloop.world.params import Params
from luxloop.world.plugin import KnownOrOwn, OwnName
from luxloop.world.rendering.rasterise import NoOpenGL
from luxloop.world.rendering.surfaces import face_source
from luxloop.world.validation import validate_model

KNOWN = ("zones", "flat", "gfhb", "belgian_block", "kp")


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("zone", "zones"),
        ("Flat", "flat"),
        ("gfbh", "gfhb"),
        ("belgian", "belgian_block"),
        ("kq", "kp"),
        ("flt", "flat"),
        ("bel", "belgian_block"),
    ],
)
def test_one_slip_is_recognised(given, meant):
    assert did_you_mean(given, KNOWN) == f"did you mean {meant!r}?"


@pytest.mark.parametrize("given", ["nonexist", "night", "", "belt", "xy"])
def test_what_is_not_near_is_not_suggested(given):
    assert did_you_mean(given, KNOWN) == "known are zones, flat, gfhb, belgian_block, kp"
    assert did_you_mean(given, KNOWN, "see the list") == "see the list"


def test_input_in_a_message_does_not_control_the_terminal():
    assert str(LuxloopError("a\x1b[31m\x07: line\nü")) == "a?[31m?: line ü"


def test_plain_data_is_told_without_logins():
    rig = {
        "camera": {"url": "rtsp://a:b@host/x?user=c&PWD=d&n=1", "options": {"password": "e", "rtsp_transport": "tcp", "width": 3}},
        "list": ["x://f@g"],
    }
    told = {
        "camera": {"url": "rtsp://***@host/x?user=c&PWD=***&n=1", "options": {"password": "***", "rtsp_transport": "tcp", "width": 3}},
        "list": ["x://***@g"],
    }
    assert redact(rig) == told


class Disc(Params):
    kind: Literal["disc"] = "disc"
    radius_m: float = Field(gt=0, examples=[0.5], description="half of its width")


class Slab(Params):
    kind: Literal["slab"] = "slab"
    corners_m: tuple[tuple[float, float], ...] = Field(min_length=2, examples=[[[0, 0], [1, 2]]], description="its outline")


class Own(Params):
    kind: OwnName
    options: tuple[int, ...] = ()


Shape = Disc | Slab | Own


class Sheet(Params):
    name: str
    shapes: tuple[Annotated[Shape, KnownOrOwn("kind")], ...] = ()
    low: int = 1
    high: int = Field(default_factory=lambda values: values["low"] + 1)


def errors(**data: Any) -> list[str]:
    with pytest.raises(LuxloopError) as caught:
        validate_model(Sheet, data, "the docs have one")
    return list(caught.value.args)


def test_one_error_is_a_sentence():
    assert errors(name=3) == ["name: 3 is not a text in quotes"]


def test_errors_in_nested_lists_have_their_places():
    corners = [[0, "a"], [1], [[], 2]]
    assert errors(name="x", shapes=[{"kind": "slab", "corners_m": corners}]) == [
        "3 errors",
        "shapes[0].corners_m[0][1]: 'a' is not a number",
        "shapes[0].corners_m[1][1]: is missing; write corners_m = [[0, 0], [1, 2]], say: its outline (the docs have one)",
        "shapes[0].corners_m[2][0]: [] is not a number; the shell took its quotes, put all of key=value into single ones",
    ]


def test_a_variant_has_its_own_errors_alone():
    shapes = [{"kind": "disc", "radius": 1}, {"kind": "disk", "zzz": 3}, {"radius_m": 1}, {"kind": "mine:Shape", "option": 1}, 7]
    assert errors(name="x", shapes=shapes) == [
        "5 errors",
        "shapes[0].radius: unknown key; did you mean 'radius_m'?",
        "shapes[3].option: unknown key; did you mean 'options'?",
        "shapes[1].kind: there is no 'disk'; did you mean 'disc'?",
        'shapes[2].kind: is missing; write kind = "disc", or one of slab, package.module:Name (the docs have one)',
        "shapes[4]: 7 is no table of keys; write key = value below a [header]",
    ]


def test_a_default_that_cannot_be_made_is_no_error():
    assert validate_model(Sheet, {"name": "x", "low": 3}, "").high == 4
    assert errors(name="x", low="a") == ["low: 'a' is not a whole number"]


def test_a_misspelt_key_is_not_also_missing():
    assert errors(nam="x") == ["nam: unknown key; did you mean 'name'?"]
    assert errors(zzz="x")[1:] == [
        "zzz: unknown key; known are name, shapes, low, high",
        "name: is missing; add it (the docs have one)",
    ]


ROOT = Path(__file__).parents[2]
RENDER = """
import threading
from luxloop.world.rendering.rasterise import context
context()
def say():
    try:
        context()
    except ValueError as error:
        print(error)
"""


def said(program: str) -> str:
    """What a program of a process of its own prints."""
    return subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120).stdout


def test_few_addresses_are_refused_before_libraries_crash():
    limit = "import resource; resource.setrlimit(resource.RLIMIT_AS, (3_000_000_000, 3_000_000_000))"
    ask = "from luxloop.world.rendering.rasterise import check_process\ntry: check_process()\nexcept ValueError as error: print(error)"
    assert "ulimit -v" in said(f"{limit}\n{ask}") and said(ask) == ""


@pytest.mark.parametrize(
    ("then", "word"),
    [
        ("thread = threading.Thread(target=say); thread.start(); thread.join()", "thread"),
        ("import pyrender; pyrender.OffscreenRenderer(8, 8).delete(); say()", "delete()"),
    ],
)
def test_a_context_that_cannot_be_current_is_a_sentence(then, word):
    try:
        face_source("opengl")
    except NoOpenGL as error:
        pytest.skip(str(error))
    assert word in said(RENDER + then)
