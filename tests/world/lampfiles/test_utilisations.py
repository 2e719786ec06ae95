"""Utilisations from files: what is wrong in one is said in one sentence, without a line of NumPy's or OpenCV's."""

import io
from pathlib import Path

import numpy as np
import pytest

from luxloop.world.errors import LuxloopError
from luxloop.world.lamps.utilisations import read_utilisation


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
def test_what_is_no_utilisation_is_named(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LuxloopError) as error:
        read_utilisation(tmp_path / name, 2, 4)
    assert words in str(error.value)
    assert name in str(error.value)


@pytest.mark.parametrize("text", ["0,0.5\n1,0\n", "0;0,5\n1;0\n", "\ufeff0;0,5\n\n1;0\n"])
def test_a_table_with_either_decimal_mark(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_text(text, "utf-8")
    assert read_utilisation(tmp_path / "a.csv", 2, 2).tolist() == [0, 0.5, 1, 0]
