"""Processes that cannot simulate, or no longer, say so."""

import subprocess
import sys
from pathlib import Path

import pytest

from luxloop.world.rendering.rasterise import NoOpenGL
from luxloop.world.rendering.surfaces import face_source

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


def test_few_addresses_are_refused_before_libraries_crash() -> None:
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
def test_a_context_that_cannot_be_current_is_a_sentence(then: str, word: str) -> None:
    try:
        face_source("opengl")
    except NoOpenGL as error:
        pytest.skip(str(error))
    assert word in said(RENDER + then)
