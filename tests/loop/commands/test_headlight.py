"""The commands `luxloop headlight ...`: what an engineer would type, and what they would get wrong."""

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from luxloop import Lamp, Module, Simulation, idealised, load, read_photometry
from luxloop.loop.report.headlight import lights_by_side
from luxloop.world.lamps.archive import save
from luxloop.world.photometry import Distribution, write
from tests.loop.conftest import Lux as Loop
from tests.loop.conftest import assert_refused

EXAMPLE = Path(__file__).parents[3] / "scenarios" / "examples" / "lamp.toml"
Lux = Callable[[str], tuple[int, str, str]]


@pytest.fixture
def lux(lux: Loop, tmp_path: Path) -> Lux:
    """Run a command line in an empty folder; gives exit code, stdout and stderr."""
    (tmp_path / "small.toml").unlink()
    return lambda line: lux("headlight", *line.split())


def test_facts_of_a_preset(lux):
    code, out, _ = lux("info hd84")
    assert code == 0
    assert all(fact in out for fact in ("3 x 28", "low", "full", " cd", " lm", "Guessed", "mean utilisation", "100.0%"))
    assert re.search(r"^low: keeps \d+ of \d+ of r149-passing-c$", out, re.M)
    assert re.search(r"^high: keeps all of \d+ of r149-driving-b$", out, re.M)
    _, out, _ = lux("info ssl-hd-lores")
    assert out.splitlines()[1].startswith("The module LoRes alone")


def test_a_beam_goes_out_as_a_photometric_file_and_comes_back(lux):
    code, out, _ = lux("export hd84 --beam high --out high.ies --step-deg 0.5")
    assert code == 0 and "high.ies written: hd84, beam high" in out
    file = read_photometry(Path("high.ies"))
    assert (file.distribution.type, file.warnings) == ("A", ())
    code, out, _ = lux("info high.ies")
    assert code == 0 and "hd84, beam high" in out and "type A" in out
    # As a lamp of one pixel it has the beam it was made from, but for what half a degree cannot hold.
    code, checked, _ = lux("check high.ies --rule r112-driving-b")
    assert checked.startswith("high: ")  # one pixel has no beams to tell apart
    _, original, _ = lux("check hd84 --beam high --rule r112-driving-b")
    assert code == 0 and checked.count("pass") == original.count("pass")


def test_a_photometric_file_is_checked_by_its_own_table(lux):
    angles = np.arange(-90.0, 91)
    peak = 30_200 * np.exp(-0.12 * (abs(angles)[:, None] + abs(angles)))
    write("hv.ies", Distribution("A", angles, angles, peak))
    Path("hv.ies").write_text(Path("hv.ies").read_text() + "END\n")
    code, out, err = lux("check hv.ies --rule r149-driving-a")
    assert code == 0 and "30,200" in out and err.count("'END'") == 1
    for line in ("info hv.ies", "show hv.ies", "show hv.ies --view pixels --out b.png"):
        assert lux(line)[2].count("'END'") == 1


def test_values_are_measured_into_a_table_or_a_file(lux):
    code, out, _ = lux("measure hd84 --beam high --at 0,0 --at -2.5,-0.86")
    assert code == 0 and "hd84, beam high, left lamp" in out and "-2.5" in out and out.count("\n") == 4
    assert "left and right lamps" in lux("measure hd84 --road 50,-1.75:100,-1.75:3")[1]
    code, out, _ = lux("measure hd84 --wall 25 --step-deg 1 --out wall.csv")
    rows = Path("wall.csv").read_text().splitlines()
    assert code == 0 and "wall.csv written" in out and rows[0] == "h_deg,v_deg,y_m,z_m,cd,lx" and f"{len(rows) - 1} points" in out


def test_a_failing_beam_is_told_by_the_exit_code_and_the_worst_point(lux):
    code, out, _ = lux("check hd84 --beam full --rule r112-passing-b")
    assert code == 1
    assert "requirements fail" in out and "B50L" in out and "-3.43, +0.57" in out


def test_a_rule_without_a_beam_checks_the_beam_that_it_is_for(lux):
    for rule, beam in (("r149-passing-c", "low"), ("r149-driving-b", "high"), ("r123-oncoming-50m", "high")):
        assert f"hd84, beam {beam}" in lux(f"check hd84 --rule {rule}")[1]
    lux("export hd84 --beam high --out high.ies --step-deg 1")
    assert lux("check high.ies --rule r149-driving-b")[1] == lux("check high.ies --beam full --rule r149-driving-b")[1] != ""
    code, _, err = lux("check high.ies")
    assert code == 2 and "has no low beam" in err and "--rule" in err and "headlight rules" in err


def test_a_description_is_built_into_a_file_that_every_command_takes(lux):
    code, out, _ = lux(f"build {EXAMPLE} --out my.npz")
    assert code == 0 and "my.npz written" in out and "of r149-passing-c" in out
    assert lux("info my.npz")[0] == 0
    code, out, _ = lux("show my.npz --view pixels --out pixels.png")
    assert code == 0 and cv2.imread("pixels.png") is not None
    assert load("flat", ["headlight.model=my.npz"]).headlight.model == str(Path("my.npz").resolve())


IMPOSSIBLE = {  # what is said of a command line, in parts
    "info ssl-hdd": "'ssl-hdd' | 'ssl-hd'",
    "info nothing.ies": "nothing.ies | cannot be read",
    "info nothing.npz": "nothing.npz | does not exist",
    "show hd84 --view wal": "'wal' | 'wall'",
    "build folder.npz": "folder.npz | lamp file already",
    "check hd84 --rule R112": "r112-driving-a, r112-driving-b, r112-passing-a, r112-passing-b",
    "show hd84 --beam lo": "'lo' | low",
    "show hd84 --view driver --visibility-m 50": "'driver' | no fog | 'volume'",
    "show hd84 --view volume --visibility-m nan": "visibility of nan m",
    "show hd84 --beam low --view pixels --scenario flat": "'pixels' | leave the scenario out",
    "show hd84 --view pixels --scenario flat": "functions.symbol: the target | noise | finer pixels | "
    "hd84 cannot show what flat draws; give --beam for a beam of hd84 there",
    "show hd84 --time-s 1": "--time-s | --scenario",
    "show hd84 --scenario gfhb --time-s -1": "--time-s | 0 or more",
    "show hd84 --scenario gfhb --traffic left": "--traffic | --beam",
    "show hd84 --scenario raw_utilisations": "lighting.raw[0].file | 'left matrix' | 64 x 256 | 3 x 28",
    "show hd84 --view wall --out wall.bmp": "wall.bmp | .png",
    "show nothing --out no/where/wall.svg": "no/where/wall.svg | cannot be written | make it",
    "check hd84 --rule r149-passing-x": "'r149-passing-x' | did you mean 'r149-passing-",
    "check hd84 --beam full": "'full' | --rule",
    "check hd84 --beam hihg": "no beam 'hihg'",
    "check hd84 --rule=": "no rule ''",
    "export hd84 --out low.ies --step-deg 0": "--step-deg | 0.01",
    "export hd84 --out low.ies --step-deg inf": "--step-deg | 5 deg",
    "export hd84 --out low.csv": "low.csv | .ies or .ldt",
    "export hd84 --out no/where/low.ies": "no/where/low.ies | cannot be written",
    "build nothing.toml": "nothing.toml | cannot be read",
    "measure hd84": "--at H,V | --wall | --road X,Y",
    "measure hd84 --at 0,0 --road 50,0": "give one of",
    "measure hd84 --at 1": "--at 1: | H,V",
    "measure hd84 --at 0,0:1,1:one": "--at 0,0:1,1:one | COUNT",
    "measure hd84 --at 95,0": "--at 95,0 | ±89",
    "measure hd84 --road 1,2,3,4": "--road 1,2,3,4 | X,Y,Z",
    "measure hd84 --road nan,0": "--road nan,0 | X within ±1000",
    "measure hd84 --wall 25": "--wall 25 | --out FILE.csv",
    "measure hd84 --wall 0 --out a.csv": "--wall 0 | greater than 0",
    "measure hd84 --wall 25 --out a.csv --step-deg 0.001": "--step-deg 0.001 | larger step",
    "measure hd84 --wall 25 --out a.csv --step-deg 1e-320": "--step-deg 9.99989e-321 | 0.001",
    "measure hd84 --at 0,0 --step-deg 1": "--step-deg | --wall",
    "measure hd84 --at 0,0 --extent 30,15": "--extent | --wall",
    "measure hd84 --wall 25 --out a.csv --extent 100,15": "--extent 100,15 | H within ±89",
    "measure hd84 --at 0,0 --side both": "--side both | left or right",
    "measure hd84 --at 0,0 --out a.txt": "--out a.txt | .csv",
    "measure hd84 --at 0,0 --out no/where/a.csv": "no/where/a.csv | cannot be written",
    "measure hd84 --at 0,0 --beam lo": "no beam 'lo'",
    f"info {'a' * 300}.npz": "does not exist",
}


@pytest.mark.parametrize(("line", "words"), IMPOSSIBLE.items())
def test_what_cannot_be_done_is_one_sentence(lux, line, words):
    done = lux(line)
    assert_refused(done, *words.split(" | "))
    assert not done[1] and not list(Path().iterdir())


def test_a_lighting_scenario_shows_what_it_makes_of_the_lamp(lux):
    code, out, _ = lux("show hd84 --scenario gfhb --time-s 1.5 --view pixels --out driven.png")
    assert code == 0 and "beam gfhb at 1.5 s" in out
    assert lux("show hd84 --beam high --view pixels --out high.png")[0] == 0
    driven, high = cv2.imread("driven.png"), cv2.imread("high.png")
    assert driven.shape == high.shape and (driven != high).mean() > 0.02


def test_the_lights_of_a_scenario_are_those_of_its_run():
    scenario = load("gfhb", ["headlight.model=hd84", "headlight.intensity_cd=1000"])
    shown = lights_by_side(scenario, "hd84", 0.3)[0]
    for side, u in zip(("left", "right"), Simulation.prepare(scenario).at(3).lights, strict=True):
        # gfhb asks for shares, which no intensity changes, but each factor rounds float32 anew.
        torch.testing.assert_close(shown[side][0], u, rtol=1e-6, atol=1e-7)


def test_a_symbol_that_is_held_is_shown_where_its_control_is_by_then():
    scenario = load("flat", ["camera.width_px=320", "camera.height_px=180", "camera.oversampling=1", "renderer=raycast", "steps=3"])
    results = list(Simulation.prepare(scenario).evaluations())
    for step in (0, 2):
        (u,) = lights_by_side(scenario, "idealised-332x1024", step / scenario.rate_hz)[0]["left"]
        torch.testing.assert_close(u, results[step].lights[0], rtol=1e-6, atol=1e-7)  # as above
    assert (results[0].lights[0] - results[2].lights[0]).abs().max() > 0.5


def test_modules_that_a_scenario_leaves_out_are_dark_and_so_is_its_other_lamp(tmp_path):
    save(tmp_path / "two.npz", Lamp("two", (Module("wide", idealised(4, 8)), Module("narrow", idealised(2, 4)))))
    given = ["lighting.base.beam=full", "functions={}", 'headlight.lamps=["right"]', 'headlight.modules=["narrow"]']
    scenario = load("gfhb", given)
    shown = lights_by_side(scenario, str(tmp_path / "two.npz"), 0.0)[0]
    assert list(shown) == ["right"] and [u.tolist() for u in shown["right"]] == [[0.0] * 32, [1.0] * 8]


def test_a_photometric_file_is_drawn_as_it_was_measured_and_other_options_are_refused(lux):
    lux("export hd84 --beam full --out full.ies --step-deg 1")
    assert_refused(lux("show full.ies --beam low"), "--beam", "--view")
    assert not Path("full.png").exists() and lux("show full.ies --view wall --side left")[0] == 0
    code, out, _ = lux("show full.ies")
    assert code == 0 and "full.png written" in out and cv2.imread("full.png") is not None


def test_traffic_on_the_left_gets_beams_of_its_own(lux):
    right, left = (lux(f"check ssl-hd-lores --traffic {side}")[1] for side in ("right", "left"))
    assert right.count("pass") == left.count("pass")
    lux("export hd84 --out right.ies --step-deg 0.5")
    lux("export hd84 --out left.ies --step-deg 0.5 --traffic left")
    right, left = (read_photometry(Path(f"{side}.ies")).distribution.candela for side in ("right", "left"))
    np.testing.assert_allclose(left, right[::-1], atol=0.05 * right.max())
    assert abs(left - right).max() > 0.1 * right.max()


def test_beams_of_a_lamp_file_stay_for_traffic_on_the_left(lux):
    lux(f"build {EXAMPLE} --out my.npz")
    code, _, err = lux("show my.npz --view pixels --traffic left")
    assert code == 0 and err.startswith("warning: lamp ") and "stay as they are" in err and err.count("\n") == 1
