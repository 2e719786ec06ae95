"""Descriptions become lamps, and what is wrong in them is named; one door for presets and files."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from luxloop import load_lamp
from luxloop.world.headlight.lamp import direction
from luxloop.world.lamps import archive, presets
from luxloop.world.lamps.description import build
from luxloop.world.lamps.utilisations import read_utilisation
from luxloop.world.photometry import lm63
from luxloop.world.photometry.distribution import Distribution
from tests.refusal import refusal

ROOT = Path(__file__).parents[3]
EXAMPLE, PAGE = ROOT / "scenarios" / "examples" / "lamp.toml", ROOT / "docs" / "lamps.md"
MATRIX = """
name = "small"
[[module]]
name = "matrix"
source = { kind = "blurred_rectangles", rows = 2, columns = 4, left_deg = 8, right_deg = -8, bottom_deg = -3, top_deg = 3, blur_deg = 0.3, \
peak_cd = 1000 }
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "lamp.toml"
    path.write_text(text)
    return path


def pixel_file(path: Path) -> Path:
    angles = np.linspace(-2, 2, 17)
    h, v = np.meshgrid(angles, angles, indexing="ij")
    lm63.write(path, Distribution("A", angles, angles, 500 * np.clip(1.5 - np.hypot(h, v), 0, None)))
    return path


def test_the_example_builds_as_it_says():
    lamp, (matrix, foreground) = build(EXAMPLE)
    fine, wide = (module.headlight for module in lamp.modules)
    assert [module.name for module in lamp.modules] == ["matrix", "foreground"] and "low" in lamp.beams
    assert (matrix.pixel_rows, matrix.pixel_cols, matrix.rows) == (16, 64, 96)
    assert matrix.overlap is not None and foreground.overlap is None
    assert matrix.entries_per_texel[1] < matrix.entries_per_texel[0]
    assert int(fine.matrix.indptr.diff().max()) == 6
    assert (wide.left - wide.right) / wide.cols < 0.07  # a quarter of a Gaussian of 15 deg
    assert lamp.modules[0].pose(swivel_deg=15)[0, 3] == 0.02


def test_the_documented_way_from_files_to_a_lamp_works(tmp_path):
    description = re.findall(r"^```toml lamp\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)[0]
    (tmp_path / "pixels").mkdir()
    for row, column in np.ndindex(3, 28):
        pixel_file(tmp_path / "pixels" / f"r{row}_c{column}.ies")
    lamp, (report,) = build(write(tmp_path, description))
    archive.save(tmp_path / "mylamp.npz", replace(lamp, beams={}))  # fitting is tested elsewhere
    assert load_lamp(tmp_path / "mylamp.npz").name == "mylamp"
    assert (report.pixel_rows, report.pixel_cols) == (3, 28)


def test_a_preset_can_be_a_module(tmp_path):
    text = (
        'name="m"\n[[module]]\nname="a"\nlevel_deg=[-1, 1]\nsource={kind="preset", name="hd84"}\noverlap={keep=2, method="least_squares"}'
    )
    lamp, (report,) = build(write(tmp_path, text))
    original = presets.lamp("hd84").finest
    assert lamp.modules[0].level_deg == (-1, 1)
    assert lamp.modules[0].headlight.rows == original.headlight.rows
    assert report.overlap is not None and 0 < report.overlap.rmse < 0.5


def test_a_module_that_only_draws_is_dark_in_default_beams_and_stays_so_in_a_lamp_file(tmp_path):
    preset = '{ kind = "preset", name = "hd84" }'
    text = (
        f'name = "m"\nbeams.default = true\n[[module]]\nname = "base"\nsource = {preset}\n'
        f'[[module]]\nname = "fine"\ndraws_only = true\nsource = {preset}'
    )
    lamp, _ = build(write(tmp_path, text))
    base, fine = lamp.beam("low")
    assert bool(base.any()) and not bool(fine.any())
    archive.save(tmp_path / "m.npz", lamp)
    assert [module.draws_only for module in load_lamp(tmp_path / "m.npz").modules] == [False, True]


def test_given_beams_come_from_pictures_and_tables(tmp_path):
    picture = np.array([[0, 51, 102, 153], [204, 255, 0, 0]], np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    lamp, _ = build(write(tmp_path, f'{MATRIX}\n[beams.given]\nwelcome = {{ matrix = "a.png" }}\nnone = {{}}'))
    assert lamp.beam("welcome")[0].tolist() == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1, 0, 0])
    assert not lamp.beam("none")[0].any()
    expected = picture.ravel() / 255
    np.save(tmp_path / "a.npy", picture / 255)
    (tmp_path / "a.csv").write_text("0;0,2;0,4;0,6\n0,8;1;0;0\n")
    cv2.imwrite(str(tmp_path / "b.png"), picture.astype(np.uint16) * 257)
    for name in ("a.npy", "a.csv", "b.png"):
        np.testing.assert_allclose(read_utilisation(tmp_path / name, 2, 4), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"no picture", "holds no utilisations (no picture)"),
        ("a.csv", b"0,1\n0,x\n", "holds no utilisations"),
        ("a.csv", b"0,1\n0,1\n", "holds 2 x 2 utilisations, but the module has 2 x 4 pixels"),
        ("a.csv", b"0,1,2,3\n0,0,0,0\n", "lie between 0 and 1, not 0 and 3"),
        ("a.npy", b"", "holds no utilisations"),
        ("a.txt", b"", ".npy, .npz, .csv, .png"),
        ("gone.png", None, "cannot be read"),
    ],
)
def test_utilisations_that_do_not_fit_are_named(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with refusal(rf"{name}.*{re.escape(words)}|{re.escape(words)}.*{name}"):
        build(write(tmp_path, f'{MATRIX}\n[beams.given]\nb = {{ matrix = "{name}" }}'))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name = small", "not valid TOML"),
        ('name = "a"', "module: is missing"),
        (
            'nam = "a"\nnotes = 3\nmodule = [1]',
            "3 errors\n  nam: unknown key; did you mean 'name'?\n  notes: 3 is not a text in quotes\n  module[0]: ",
        ),
        (MATRIX.replace('kind = "blurred_rectangles"', 'kind = "blured_rectangles"'), "did you mean 'blurred_rectangles'?"),
        (MATRIX.replace("columns", "colums"), "unknown key; did you mean 'columns'?"),
        (f"{MATRIX}muont = {{ x_m = 1 }}", "unknown key; did you mean 'mount'?"),
        (f"{MATRIX}overlap = {{ method = 'proportional' }}", "give the number of pixels to keep"),
        (f"{MATRIX}overlap = {{ keep = 0 }}", "overlap.keep: 0 should be greater than or equal to 1"),
        (f"{MATRIX}swivel_deg = [1, 5]", "must hold 0"),
        (f"{MATRIX}swivel_deg = 2000-01-01", "swivel_deg: is a date or a time"),
        (f"{MATRIX}texture = {{ left_deg = -20 }}", "module 'matrix': texture borders"),
        (f'{MATRIX}[beams.given.b]\nmatrx = "a.png"', "there is no such module; did you mean 'matrix'?"),
        (f"{MATRIX}[beams.given.full]", "every lamp has full already"),
        (MATRIX + MATRIX.partition("\n")[2].partition("\n")[2], "are not unique"),
        ('name="m"\n[[module]]\nname="a"\nsource={kind="preset", name="hd48"}', "hd84"),
        ('name="m"\n[[module]]\nname="a"\nsource={kind="preset", name="hd84", module="x"}', "it has "),
        ('name="m"\n[[module]]\nname="a"\nsource={kind="preset", name="hd84"}\ntexture={rows=3}', "a preset brings its own"),
        ('name="m"\n[[module]]\nname="a"\nsource={kind="file", path="gone.ies"}', "gone.ies"),
    ],
)
def test_what_is_wrong_in_a_description_is_named(tmp_path, text, words):
    path = write(tmp_path, text)
    with refusal(re.escape(words)) as error:
        build(path)
    assert str(path) in str(error.value)


def test_lamps_come_by_name_and_by_file(tmp_path):
    assert load_lamp("hd84", "right") is presets.lamp("hd84", "right")
    described = load_lamp(write(tmp_path, MATRIX))
    archive.save(tmp_path / "lamp.npz", described)
    stored = load_lamp(str(tmp_path / "lamp.npz"))
    assert torch.equal(stored.modules[0].headlight.matrix.values, described.modules[0].headlight.matrix.values)
    single = load_lamp(pixel_file(tmp_path / "spot.ies"))
    assert (single.name, single.modules[0].headlight.n_pixels) == ("spot", 1)
    ahead = direction(torch.zeros(1), torch.zeros(1))
    assert single.intensity(single.beam("full"), ahead).item() == pytest.approx(750, rel=0.05)


def test_the_right_lamp_mirrors_the_left_one(tmp_path):
    text = MATRIX.replace("left_deg = 8", "left_deg = 16") + "mount = { y_m = 0.1, yaw_deg = 3 }\nswivel_deg = [-5, 10]"
    path = write(tmp_path, text)
    left = load_lamp(path)
    archive.save(tmp_path / "lamp.npz", left)
    h = torch.linspace(-20, 20, 41)
    for right in (load_lamp(path, "right"), load_lamp(tmp_path / "lamp.npz", "right")):
        assert right.modules[0].swivel_deg == (-10, 5)
        assert right.modules[0].T_lamp_module[1, 3] == -0.1
        seen, mirrored = (
            lamp.intensity(lamp.beam("full"), direction(sign * h, torch.zeros(41))) for lamp, sign in ((left, 1), (right, -1))
        )
        torch.testing.assert_close(seen, mirrored, rtol=1e-5, atol=1e-3)
