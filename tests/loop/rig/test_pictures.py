"""`luxloop rig take` and `luxloop rig light`, against a small rig of another process."""

import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.wire.mjpeg import parts
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.lamps import archive
from luxloop.world.lamps.presets import idealised
from tests.loop.conftest import Lux, assert_one_sentence
from tests.loop.rig.conftest import Process, Start, eventually

DARK, BRIGHT = 20, 220  # digital numbers of the small rig's pictures
SCENARIO = """
name = "lamp"
[headlight]
model = "lamp.npz"
lamps = ["left"]
"""


@pytest.fixture
def rig(lux: Lux, small_rig: Start) -> tuple[Lux, Process]:
    """A command line beside a rig file `rig.toml` of a small rig, and a scenario of its lamp."""
    archive.save(Path("lamp.npz"), Lamp("lamp", (Module("matrix", idealised(12, 16, (2, 2), 3.5, 1.8, -1.8)),)))
    Path("lamp.toml").write_text(SCENARIO)
    process = small_rig(12 * 16, dark_s=0.5)
    process.file(Path())
    return lux, process


@pytest.fixture
def seen(rig: tuple[Lux, Process]) -> Iterator[list[float]]:
    """Brightness of the pictures that a second client gets, as they come."""
    levels = list[float]()

    def watch() -> None:
        try:
            for part in parts(answer, 2**20):
                levels.append(float(cv2.imdecode(np.frombuffer(part.body, np.uint8), cv2.IMREAD_GRAYSCALE)[10:].mean()))
        except (OSError, ValueError):
            pass

    with urllib.request.urlopen(f"http://127.0.0.1:{rig[1].camera}/camera", timeout=10) as answer:
        threading.Thread(target=watch, daemon=True).start()
        yield levels


def test_pictures_are_taken_as_they_come_and_the_lamp_stays_dark(rig, seen):
    lux, _ = rig
    code, out, err = lux("rig", "take", "rig.toml", "--count", "3", "--every-s", "0.05")
    assert (code, err) == (0, "") and "boards written: 3 pictures" in out
    taken = [cv2.imread(str(each), cv2.IMREAD_UNCHANGED) for each in sorted(Path("boards").iterdir())]
    assert [each.shape for each in taken] == [(48, 64)] * 3 and all((each[10:] == DARK).all() for each in taken)
    assert max(seen) == DARK
    assert lux("rig", "take", "rig.toml", "--out", "screen.png")[0] == 0
    assert cv2.imread("screen.png", cv2.IMREAD_UNCHANGED).shape == (48, 64)


def test_all_pixels_are_lit_for_a_while_and_dark_again(rig, seen):
    lux, _ = rig
    code, out, err = lux("rig", "light", "rig.toml", "--arm", "--scenario", "lamp.toml", "--level", "0.5", "--seconds", "0.5")
    assert (code, err) == (0, "") and "dark again" in out
    time.sleep(0.1)  # of the camera's latency
    assert max(seen) == pytest.approx((DARK + BRIGHT) / 2, abs=2)  # eight bits of light and of the camera
    assert seen[-1] == DARK


def test_unarmed_nothing_is_lit(rig, seen):
    lux, _ = rig
    code, out, _ = lux("rig", "light", "rig.toml", "--scenario", "lamp.toml")
    assert code == 0 and "all 192 pixels would be lit for 60 s; give --arm" in out
    assert eventually(lambda: len(seen) > 3) and set(seen) == {DARK}


@pytest.mark.parametrize(
    ("arguments", "limits", "told"),
    [
        (["take", "rig.toml", "--out", "lamp.toml"], "", "lamp.toml: is there already"),
        (["light", "rig.toml", "--arm", "--level", "0"], "", "for --level; must be > 0"),
        (["light", "rig.toml", "--arm", "--scenario", "lamp.toml"], "[limits]\npower = 0.25\n", "let 25% of it through"),
    ],
)
def test_mistakes_are_told_in_a_sentence(rig, arguments, limits, told):
    lux, _ = rig
    with Path("rig.toml").open("a") as file:
        file.write(limits)
    code, _, err = lux("rig", *arguments)
    assert code == 2 and told in err
    assert_one_sentence(err)
    assert not Path("boards").exists()
