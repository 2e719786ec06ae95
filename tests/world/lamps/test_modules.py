"""Modules of lamp descriptions and utilisations from files: what is odd is told."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxloop.world.lamps.modules import ModuleParams, build_module
from luxloop.world.lamps.utilisations import read_utilisation
from luxloop.world.photometry import Distribution, write
from tests.refusal import sentence

RECTANGLES = {
    **{"kind": "blurred_rectangles", "rows": 2, "columns": 4, "left_deg": 8, "right_deg": -8, "bottom_deg": -3, "top_deg": 3},
    **{"blur_deg": 0.3, "peak_cd": 1000},
}


OVERLAPPING = {
    **{"kind": "gaussian", "columns": 40, "left_deg": 79, "right_deg": -79, "row_centres_deg": [0] * 12, "row_sigmas_deg": [50] * 12},
    **{"column_sigma": 50, "peak_cd": [1000] * 12},
}


@pytest.mark.parametrize(
    ("source", "more", "words"),
    [
        (RECTANGLES, {"overlap": {"bound_cd": 1e6}}, "bound_cd = 1e+06 leaves no light"),
        (OVERLAPPING, {"texture": {"rows": 4096, "columns": 4096}}, "coarser texture"),
        (RECTANGLES, {"texture": {"rows": 1}}, "texture.rows = 1: cannot show 2 rows"),
        (RECTANGLES, {"texture": {"columns": 3}}, "at least 4, better 16"),
    ],
)
def test_what_cannot_be_a_module_is_refused(tmp_path, source, more, words):
    with sentence(words):
        build_module(ModuleParams.model_validate({"name": "m", "source": source, **more}), tmp_path, lambda *_: [])


def build_source(folder: Path, **source: Any) -> None:
    build_module(ModuleParams.model_validate({"name": "m", "source": source, "texture": {"rows": 8, "columns": 8}}), folder, lambda *_: [])


def test_light_that_the_measurement_cuts_off_is_told(tmp_path):
    angles = np.linspace(-2.0, 2.0, 9)
    cone = np.clip(2.25 - np.hypot(*np.meshgrid(angles, angles)), 0, None)
    for column, light in enumerate((cone, cone + 0.25 * (cone > 0), 0 * cone + cone * (cone > 0.5))):
        write(tmp_path / f"p{column}.ies", Distribution("A", angles, angles, light))
    with pytest.warns(UserWarning, match=r"p0.ies: ends where it still gives 11 % of its peak; measure".replace(" %", "%")):
        build_source(tmp_path, kind="file", path="p0.ies")
    words = r"pixel in row 0, column 1 \(counted from 0\) ends where it still gives 20% of its peak, as do 1 more"
    with pytest.warns(UserWarning, match=words):
        build_source(tmp_path, kind="folder", path=".", rows=1, columns=3)


def test_a_luminaire_as_a_lamp_is_told_unless_its_aim_is_given(tmp_path):
    spot = Distribution("C", np.array([0.0, 5, 10, 90]), np.array([0.0]), np.array([[900.0, 500, 0, 0]]))
    write(tmp_path / "spot.ies", spot)
    with pytest.warns(UserWarning, match="nadir was taken as the beam axis"):
        build_source(tmp_path, kind="file", path="spot.ies")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*as a light texture")  # of 8 x 8 texels
        build_source(tmp_path, kind="file", path="spot.ies", aim="beam")


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def npz(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, array)
    return stream.getvalue()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.npy", npy(np.zeros(8, "f8,f8")), "no real numbers"),
        ("a.npy", npy(np.zeros(8, complex)), "no real numbers"),
        ("a.npy", npz(np.zeros(8)), "holds no utilisations"),
        ("a.npy", npy(np.array([{}])), "holds no utilisations"),
        (
            "a.npy",
            npy(np.array([0, 1, 2, 0, 0, np.nan, 0, np.inf])),
            "row 1, column 1, from 0, is nan (and 1 more), not from 0 to 1; set it to 0",
        ),
        ("a.npy", npy(np.array([0, 0, -0.5, 0, 0, 0, 0, 2])), "row 0, column 2, from 0, is -0.5, not"),
        ("a.npy", npy(np.array([0, 1, 0, 2.0, 0, 0, 0, 0])), "not 0 and 2; divide by the largest"),
        ("a.png", b"", "no picture"),
        ("a.csv", b"", "no lines"),
        ("a.csv", b"\n \n", "no lines"),
        ("a.csv", b"# 0,0,0,0\n", "holds no utilisations"),
        ("a.csv", b"\xff\xfe0\x00", "holds no utilisations"),
    ],
)
def test_what_is_no_utilisation_is_named(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with sentence(words, name):
        read_utilisation(tmp_path / name, 2, 4)


@pytest.mark.parametrize("text", ["0,0.5\n1,0\n", "0;0,5\n1;0\n", "\ufeff0;0,5\n\n1;0\n"])
def test_a_table_with_either_decimal_mark(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, "utf-8")
    assert read_utilisation(tmp_path / "a.csv", 2, 2).tolist() == [0, 0.5, 1, 0]
