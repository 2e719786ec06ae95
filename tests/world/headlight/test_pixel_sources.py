"""Folders, files and tables become pixels in their places; what is missing, one too many or broken is named."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from luxloop.world.headlight.pixels import PixelArray, assemble
from luxloop.world.headlight.sources import FileSource, FolderSource, TableSource
from luxloop.world.photometry import lm63
from luxloop.world.photometry.distribution import Distribution
from luxloop.world.texels import TexelGrid
from tests.refusal import refusal, sentence
from tests.world.photometry.test_lm63 import PLAIN

H, V = np.linspace(-6, 6, 25), np.linspace(-3, 3, 13)
GRID = TexelGrid.from_degrees(40, 80, 6, -6, -3, 3)
ROWS, COLUMNS = 2, 3


def candela() -> np.ndarray:
    """`[6, V, H]`: a blob a pixel, from the top left on, which its peak numbers."""
    out = np.zeros((ROWS * COLUMNS, len(V), len(H)))
    for j in range(ROWS * COLUMNS):
        row, column = divmod(j, COLUMNS)
        h, v = np.meshgrid(H - 3 * (column - 1), V - 1.0 * (0.5 - row))
        out[j] = 100 * (j + 1) * np.clip(1.2 - np.hypot(h / 1.5, v), 0, None)
    return out


EXPECTED_CENTRES = [(-3, 0.5), (0, 0.5), (3, 0.5), (-3, -0.5), (0, -0.5), (3, -0.5)]


def check(array: PixelArray) -> None:
    """Pixels lie where `candela` puts them."""
    assert (array.rows, array.columns) == (ROWS, COLUMNS)
    light = assemble(array, GRID).matrix.toarray().reshape(GRID.rows, GRID.cols, -1)
    y, z = (np.degrees(np.arctan(each.numpy())) for each in GRID.tangents())
    for j, (h, v) in enumerate(EXPECTED_CENTRES):
        total = light[:, :, j].sum()
        centre = -(light[:, :, j].sum(0) @ y) / total, (light[:, :, j].sum(1) @ z) / total
        assert centre == pytest.approx((h, v), abs=0.05)  # a texel is 0.15 deg
        assert light[:, :, j].max() == pytest.approx(120 * (j + 1), rel=0.1)  # the nearest texel lies up to 0.1 deg from the peak


def write_folder(folder: Path, name: Callable[[int], str]) -> None:
    folder.mkdir()
    for j, each in enumerate(candela()):
        lm63.write(folder / name(j), Distribution("A", V, H, each.T))


def test_folder_in_natural_order(tmp_path):
    write_folder(tmp_path / "p", lambda j: f"Pixel{j + 7}.IES")
    (tmp_path / "p" / "readme.txt").write_text("not photometry")
    check(FolderSource(path=tmp_path / "p", rows=ROWS, columns=COLUMNS).pixels())


@pytest.mark.parametrize("first", [0, 1])
def test_folder_by_pattern(tmp_path, first):
    write_folder(tmp_path / "p", lambda j: f"c{j % COLUMNS + first:03}_r{j // COLUMNS + first:02}.ies")
    check(FolderSource(path=tmp_path / "p", rows=ROWS, columns=COLUMNS, pattern="c{column}_r{row}.ies").pixels())


def copied(name: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes((folder / "r00_c00.ies").read_bytes())


@pytest.mark.parametrize(
    ("change", "with_pattern", "without"),
    [
        (
            lambda folder: (folder / "r01_c02.ies").unlink(),
            "has no file for row 1 column 2, rows counted from 0 and columns from 0",
            "holds 5 photometric files, from r00_c00.ies to r01_c01.ies, but 2 x 3 pixels need 6",
        ),
        (copied("r02_c00.ies"), "has more than 2 x 3 pixels: r02_c00.ies", "holds 7 photometric files"),
        (copied("r0_c00.ies"), "is the same pixel as", "holds 7"),
        (copied("spare.ies"), "spare.ies: does not fit the pattern", "holds 7"),
        (lambda folder: (folder / "r01_c01.ies").write_text(PLAIN[:-9]), "r01_c01.ies, line", "r01_c01.ies, line"),
    ],
)
def test_what_is_wrong_in_a_folder_is_named(tmp_path, change, with_pattern, without):
    write_folder(tmp_path / "p", lambda j: f"r{j // COLUMNS:02}_c{j % COLUMNS:02}.ies")
    change(tmp_path / "p")
    for pattern, words in (("r{row}_c{column}.ies", with_pattern), (None, without)):
        with sentence(words):
            FolderSource(path=tmp_path / "p", rows=ROWS, columns=COLUMNS, pattern=pattern).pixels()
    with refusal("is not a folder"):
        FolderSource(path=tmp_path / "q", rows=1, columns=1).pixels()


def test_patterns_and_pitches_that_cannot_work_are_refused(tmp_path):
    with pytest.raises(ValidationError, match=r"needs \{row\} and \{column\} once each"):
        FolderSource(path=tmp_path, rows=1, columns=1, pattern="p{row}.ies")
    with pytest.raises(ValidationError, match="need the angle between neighbours"):
        FileSource(path=tmp_path / "p.ies", rows=2, columns=2)
    for number, words in (
        ({"rows": 12, "columns": 40}, "40 columns 8 deg apart span 320 deg; a texture reaches ±80 deg"),
        ({"rows": 21}, "21 rows"),
    ):
        with pytest.raises(ValidationError, match=words):
            FileSource(path=tmp_path / "p.ies", pitch_deg=8, **number)
    for key, value in (("rows", 10**10), ("columns", 4097), ("aspect", 1e-9)):
        with pytest.raises(ValidationError, match=key):
            FileSource(path=tmp_path / "p.ies", pitch_deg=1, **{key: value})


@pytest.mark.parametrize("four", [False, True])
def test_npz(tmp_path, four):
    tensor = candela().astype(np.float32)
    path = tmp_path / "t.npz"
    np.savez(path, candela=tensor.reshape(ROWS, COLUMNS, *tensor.shape[1:]) if four else tensor, horizontal_deg=H, vertical_deg=V)
    check(TableSource(path=path, columns=None if four else COLUMNS).pixels())


def test_npz_colours(tmp_path):
    tensor = candela()
    rgb = np.ones((*tensor.shape, 3)) * [4.0, 2.0, 0.0]
    np.savez(tmp_path / "t.npz", candela=tensor, horizontal_deg=H, vertical_deg=V, rgb=rgb)
    chroma = assemble(TableSource(path=tmp_path / "t.npz", rows=2).pixels(), GRID).chroma
    share = np.array([2.0, 1.0, 0.0]) / (0.2126 * 2 + 0.7152)
    np.testing.assert_allclose(chroma, np.broadcast_to(share[:, None], chroma.shape), rtol=1e-9, atol=1e-12)


def test_a_table_whose_angles_begin_at_zero_is_not_mirrored(tmp_path):
    np.savez(tmp_path / "t.npz", candela=np.full((1, 3, 3), 9.0), horizontal_deg=[0.0, 1, 2], vertical_deg=[0.0, 1, 2])
    grid = TexelGrid.from_degrees(20, 20, 2, -2, -2, 2)
    light = assemble(TableSource(path=tmp_path / "t.npz", rows=1, columns=1).pixels(), grid).matrix.toarray().reshape(20, 20)
    assert light[:10, 10:].min() == pytest.approx(9)
    assert light[10:].max() == light[:, :10].max() == 0


def csv_lines(first: int, by_place: bool, dark: bool) -> list[list[float]]:
    lines = []
    for j, v, h in np.ndindex(ROWS * COLUMNS, len(V), len(H)):
        cd = candela_of[j, v, h]
        if cd > 0 or dark or j == 0:  # the first pixel tells all angles
            number = [j // COLUMNS + first, j % COLUMNS + first] if by_place else [j + first]
            lines.append([*number, H[h], V[v], round(cd, 6)])
    return lines


candela_of = candela()


@pytest.mark.parametrize(("first", "by_place", "dark", "german"), [(0, False, True, False), (1, True, False, True)])
def test_csv(tmp_path, first, by_place, dark, german):
    head = ["row", "column"] if by_place else ["pixel"]
    rows = [[*head, "horizontal_deg", "vertical_deg", "candela"], *csv_lines(first, by_place, dark)]
    text = "\n".join(",".join(str(each) for each in row) for row in rows)
    path = tmp_path / "t.csv"
    path.write_text(text.replace(",", ";").replace(".", ",") if german else text)
    check(TableSource(path=path, rows=None if by_place else ROWS).pixels())


def npz(**arrays: object) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        defaults = {"candela": candela(), "horizontal_deg": H, "vertical_deg": V}
        np.savez(folder / "t.npz", **{key: value for key, value in {**defaults, **arrays}.items() if value is not None})  # type: ignore[arg-type]
        return folder / "t.npz"

    return write


def csv(text: str, name: str = "t.csv", encoding: str = "utf-8") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_text(text, encoding)
        return folder / name

    return write


HEAD = "pixel,horizontal_deg,vertical_deg,candela\n"


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (npz(candela=None), "has no array 'candela'"),
        (npz(candela=np.ones((6, 3, 3))), "candela has the shape (6, 3, 3)"),
        (npz(candela=np.ones((3, 2, 13, 25))), "holds 6 pixels in 3 rows, not in 2"),
        (npz(rgb=np.ones((6, 13, 25))), "rgb has the shape"),
        (npz(vertical_deg=V[::-1]), "vertical angles of type A must ascend"),
        (npz(candela=np.full((6, 13, 25), "x")), "candela holds <U1, not real numbers"),
        (npz(rgb=-np.ones((6, 13, 25, 3))), "pixel 0: colours must be finite and not negative"),
        (npz(horizontal_deg=1.0), "must be lists of angles"),
        (npz(candela=np.ones((0, 13, 25))), "candela must not be empty"),
        (csv(HEAD), "has a first line only"),
        (csv("row,column,horizontal_deg,vertical_deg,candela\n0,0,1,1,1\n1000000,1000000,2,2,1\n"), "row goes up to 1e+06 in 2 lines"),
        (csv("row,column,horizontal_deg,vertical_deg,candela\n0,0,1,1,1\n1,1,2,2,1\n"), "names 2 x 2 pixels in 2 lines"),
        (csv("nothing", "t.txt"), "neither .npz nor .csv"),
        (csv("a,b\n1,2\n"), "has the columns a, b"),
        (csv(HEAD + "2,0,0,1\n"), "from 0 or 1"),
        (csv(HEAD + "0,0,0,1\n0,0,0,1\n1,1,1,1\n"), "two lines for the same angles"),
        (csv(HEAD + "0,0,0,1\n0,1,1,1\n0,0,1,1\n3,1,1,1\n"), "pixel 0, 1, counted from 0, has no lines"),
    ],
)
def test_what_is_wrong_in_a_table_is_named(tmp_path, write, words):
    path = write(tmp_path)
    with sentence(words, path.name):
        TableSource(path=path, rows=2).pixels()


def test_a_missing_table_is_named(tmp_path):
    for name in ("gone.npz", "gone.csv"):
        with refusal(f"{name}: cannot be read"):
            TableSource(path=tmp_path / name, rows=1).pixels()
