"""Sources of a module's pixels in a lamp description: a folder of files, a file, a table (T 5.2).

Tables hold all pixels of a module: `.npz` tensors and `.csv` lists; angles to the right and up positive (type A).
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray
from pydantic import Field, model_validator

from luxloop.world.arrays import read_npz
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import reading, regular
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.headlight.parametric import MOST_PIXELS, PixelCount
from luxloop.world.headlight.pixels import Pixel, PixelArray
from luxloop.world.params import Params
from luxloop.world.photometry import read_all
from luxloop.world.photometry.distribution import EDGE_DEG, Aim, Array, Distribution
from luxloop.world.texels import LARGEST_ANGLE_DEG

ANGLES = ("horizontal_deg", "vertical_deg")
CHANNELS = ("red", "green", "blue")
KNOWN = (*ANGLES, "candela", "pixel", "row", "column", *CHANNELS)
CSV_FORM = "pixel,horizontal_deg,vertical_deg,candela, or row,column in place of pixel"


def _read_npz(path: Path, rows: int | None, columns: int | None) -> PixelArray:
    with reading(path, "is no readable .npz file", "save it with numpy.savez"):
        arrays = read_npz(path)
    for name in ("candela", *ANGLES):
        if name not in arrays:
            raise LuxloopError(
                f"{path}: has no array {name!r}, only {', '.join(arrays)}; it needs candela, horizontal_deg and vertical_deg"
            )
    for name in {"candela", "rgb", *ANGLES} & arrays.keys():
        if arrays[name].dtype.kind not in "iuf":
            raise LuxloopError(f"{path}: {name} holds {arrays[name].dtype}, not real numbers; save it as float64")
    candela, h, v = (arrays[name] for name in ("candela", *ANGLES))
    rgb = arrays.get("rgb")
    if candela.size == 0 or h.ndim != 1 or v.ndim != 1:
        raise LuxloopError(f"{path}: candela must not be empty, and horizontal_deg and vertical_deg must be lists of angles")
    if candela.ndim not in (3, 4) or candela.shape[-2:] != (len(v), len(h)):
        raise LuxloopError(
            f"{path}: candela has the shape {candela.shape}; it must be (pixels, {len(v)}, {len(h)}) or (rows, columns, {len(v)}, {len(h)})"
        )
    if rgb is not None and rgb.shape != (*candela.shape, 3):
        raise LuxloopError(f"{path}: rgb has the shape {rgb.shape}; it must be that of candela with a 3 behind, {(*candela.shape, 3)}")
    if candela.ndim == 4:
        shape = _same_shape(path, candela.shape[:2], rows, columns)
        candela = candela.reshape(-1, len(v), len(h))
        rgb = None if rgb is None else rgb.reshape(-1, len(v), len(h), 3)
    else:
        shape = _shape(path, len(candela), rows, columns)
    pixels = [_pixel(path, str(i), v, h, each, None if rgb is None else rgb[i]) for i, each in enumerate(candela)]
    return PixelArray(pixels, *shape)


def _read_csv(path: Path, rows: int | None, columns: int | None) -> PixelArray:
    table = _csv_columns(path)
    if not len(table["candela"]):
        raise LuxloopError(f"{path}: has a first line only; add a line for each value")
    if "pixel" in table:
        number = _numbers(path, table, "pixel")
        shape = _shape(path, int(number.max()) + 1, rows, columns)
    else:
        row, column = (_numbers(path, table, name) for name in ("row", "column"))
        shape = _same_shape(path, (int(row.max()) + 1, int(column.max()) + 1), rows, columns)
        number = row * shape[1] + column
    if shape[0] * shape[1] > len(number):
        raise LuxloopError(f"{path}: names {shape[0]} x {shape[1]} pixels in {len(number)} lines; add a line for each, 0 cd if it is dark")
    order = np.argsort(number, kind="stable")
    bounds = np.searchsorted(number[order], np.arange(shape[0] * shape[1] + 1))
    nodes = {name: np.unique(table[name]) for name in ANGLES}
    rgb = np.stack([table[name] for name in CHANNELS], -1) if set(CHANNELS) <= table.keys() else None
    pixels = []
    for i in range(shape[0] * shape[1]):
        lines = order[bounds[i] : bounds[i + 1]]
        name = f"{i // shape[1]}, {i % shape[1]}, counted from 0,"
        if not len(lines):
            raise LuxloopError(f"{path}: pixel {name} has no lines; add it, with 0 cd if it is dark")
        (h, at_h), (v, at_v) = (_box(nodes[each], table[each][lines]) for each in ANGLES)
        if len(np.unique(at_v * len(h) + at_h)) < len(lines):
            raise LuxloopError(f"{path}: pixel {name} has two lines for the same angles; remove one")
        candela = np.zeros((len(v), len(h)))
        candela[at_v, at_h] = table["candela"][lines]
        colours = None
        if rgb is not None:
            colours = np.ones((len(v), len(h), 3))
            colours[at_v, at_h] = rgb[lines]
        pixels.append(_pixel(path, name, v, h, candela, colours))
    return PixelArray(pixels, *shape)


def _csv_columns(path: Path) -> Mapping[str, Array]:
    """Required and optional columns by name, float64; others, such as notes, are ignored."""
    delimiter, decimal_point = separators(path)
    try:
        table = pyarrow.csv.read_csv(
            path,
            parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter),
            convert_options=pyarrow.csv.ConvertOptions(decimal_point=decimal_point),
        )
        names = [name.strip().lower() for name in table.column_names]
        columns = {name: table.column(i).cast(pa.float64()).to_numpy() for i, name in enumerate(names) if name in KNOWN}
    except (pa.ArrowException, UnicodeDecodeError) as error:
        reason = str(error).split("\n")[0]
        raise LuxloopError(f"{path}: is not a table of numbers ({reason}); the first line must name {CSV_FORM}") from error
    twice = next((name for name in columns if names.count(name) > 1), None)
    if twice is not None:
        raise LuxloopError(f"{path}: has two columns {twice}; remove one")
    needed = {"pixel"} <= columns.keys() or {"row", "column"} <= columns.keys()
    if not needed or not {*ANGLES, "candela"} <= columns.keys():
        raise LuxloopError(f"{path}: has the columns {', '.join(names)}; the first line must name {CSV_FORM}")
    return columns


def separators(path: Path) -> tuple[str, str]:
    """Delimiter and decimal point of a .csv by its first line; some spreadsheets write semicolon and comma."""
    with reading(path), regular(path).open("rb") as stream:
        return (";", ",") if b";" in stream.readline() else (",", ".")


def _numbers(path: Path, table: Mapping[str, Array], name: str) -> NDArray[np.int64]:
    """Numbers of pixels, rows or columns, counted from 0."""
    given = table[name]
    first = given.min()
    if first not in (0, 1) or (given != np.floor(given)).any():
        raise LuxloopError(f"{path}: {name} must be whole numbers from 0 or 1 on; the first is {first:g}")
    if given.max() > len(given):
        raise LuxloopError(f"{path}: {name} goes up to {given.max():g} in {len(given)} lines; add a line for each, 0 cd if it is dark")
    return (given - first).astype(np.int64)


def _box(nodes: Array, given: Array) -> tuple[Array, NDArray[np.int64]]:
    """The range of table angles around a pixel's light, with one dark angle on each side, and the pixel's indices in it."""
    at = np.searchsorted(nodes, given)
    start = max(int(at.min()) - 1, 0)
    return nodes[start : int(at.max()) + 2], at - start


def _same_shape(path: Path, shape: tuple[int, int], rows: int | None, columns: int | None) -> tuple[int, int]:
    """The table's own shape; raises LuxloopError if it differs from the given one."""
    for what, told, asked in (("rows", shape[0], rows), ("columns", shape[1], columns)):
        if asked not in (None, told):
            raise LuxloopError(f"{path}: holds {shape[0] * shape[1]} pixels in {told} {what}, not in {asked}; leave {what} out")
    return shape


def _shape(path: Path, n_pixels: int, rows: int | None, columns: int | None) -> tuple[int, int]:
    if rows is None and columns is None:
        raise LuxloopError(f"{path}: holds {n_pixels} pixels in one list; say how many rows and columns they make")
    rows = rows or n_pixels // (columns or 1)
    columns = columns or n_pixels // rows
    if rows * columns != n_pixels:
        raise LuxloopError(f"{path}: holds {n_pixels} pixels, which are not {rows} rows of {columns} columns; correct rows and columns")
    return rows, columns


def _pixel(path: Path, name: str, v: Any, h: Any, candela: Any, rgb: Any | None) -> Pixel:
    """A pixel of `[V, H]` cd, coloured `[V, H, 3]`."""
    with locate(f"{path}: pixel {name}"):
        if rgb is None:
            return Pixel(_distribution(v, h, candela))
        if not (np.isfinite(rgb).all() and (rgb >= 0).all()):
            raise LuxloopError("colours must be finite and not negative")
        luminance = rgb @ np.array(LUMINANCE)
        white = luminance <= 0
        share = np.where(white[..., None], 1.0, rgb / np.where(white, 1.0, luminance)[..., None])
        red, green, blue = (_distribution(v, h, candela * each) for each in np.moveaxis(share, -1, 0))
        return Pixel(_distribution(v, h, candela), rgb=(red, green, blue))


def _distribution(v: Any, h: Any, candela: Any) -> Distribution:
    """A distribution of type A. A table that begins at 0 deg gets a dark edge there, as it would be mirrored otherwise."""
    v, h, candela = (np.asarray(each, np.float64) for each in (v, h, candela))
    if len(h) < 2:
        raise LuxloopError("give at least 2 horizontal angles")
    if len(v) and v[0] == 0:
        v, candela = np.insert(v, 0, -EDGE_DEG), np.insert(candela, 0, 0, axis=0)
    if h[0] == 0:
        h, candela = np.insert(h, 0, -EDGE_DEG), np.insert(candela, 0, 0, axis=1)
    return Distribution("A", v, h, np.ascontiguousarray(candela.T))


SUFFIXES = (".ies", ".ldt")
SHOWN = 5  # names in a message
AIM = 'type C and EULUMDAT: turn nadir into the beam axis ("beam"), or leave the file as the luminaire hangs ("nadir")'


class FolderSource(Params):
    """One photometric file per pixel."""

    kind: Literal["folder"] = "folder"
    path: Path = Field(examples=["pixels"], description="folder with one .ies or .ldt file per pixel")
    rows: PixelCount = Field(examples=[16], description="pixel rows")
    columns: PixelCount = Field(examples=[64], description="pixels in a row")
    pattern: str | None = Field(
        None,
        description="file names with the pixel's row and column, such as r{row}_c{column}.ies, from 0 or 1; left out: natural order",
    )
    aim: Aim = Field("beam", description=AIM)

    @model_validator(mode="after")
    def _whole_pattern(self) -> Self:
        if self.pattern is not None and any(self.pattern.count(mark) != 1 for mark in ("{row}", "{column}")):
            raise ValueError(f"pattern = {self.pattern!r}: needs {{row}} and {{column}} once each, such as r{{row}}_c{{column}}.ies")
        return self

    def pixels(self) -> PixelArray:
        """Read all files. Raises LuxloopError that names the folder, and the file that is missing, one too many or broken."""
        if not os.path.isdir(self.path):
            raise LuxloopError(f"{self.path}: is not a folder; give one that holds a photometric file for each pixel")
        files = sorted((path for path in self.path.iterdir() if path.suffix.lower() in SUFFIXES), key=_natural)
        files = self._in_order(files) if self.pattern is None else self._by_place(files, self.pattern)
        return PixelArray([Pixel(each.distribution) for each in read_all(files)], self.rows, self.columns, self.aim)

    def _in_order(self, files: list[Path]) -> list[Path]:
        wanted = self.rows * self.columns
        if len(files) != wanted:
            span = f", from {files[0].name} to {files[-1].name}" if files else ""
            raise LuxloopError(
                f"{self.path}: holds {len(files)} photometric files{span}, but {self.rows} x {self.columns} pixels need {wanted}; correct "
                "rows and columns, or give `pattern` to learn which are missing"
            )
        return files

    def _by_place(self, files: list[Path], pattern: str) -> list[Path]:
        form = re.compile(re.escape(pattern).replace(r"\{row\}", r"(?P<row>\d+)").replace(r"\{column\}", r"(?P<column>\d+)"), re.I)
        places: dict[tuple[int, int], Path] = {}
        for path in files:
            match = form.fullmatch(path.name)
            if match is None:
                raise LuxloopError(f"{path}: does not fit the pattern {pattern}; rename it or move it out of the folder")
            place = int(match["row"]), int(match["column"])
            if place in places:
                raise LuxloopError(f"{path}: is the same pixel as {places[place].name}; remove one of them")
            places[place] = path
        first_row, first_column = (min((place[i] for place in places), default=0) for i in (0, 1))
        if max(first_row, first_column) > 1:
            first_row = first_column = 0
        wanted = [(first_row + row, first_column + column) for row in range(self.rows) for column in range(self.columns)]
        missing = [f"row {row} column {column}" for row, column in wanted if (row, column) not in places]
        extra = [path.name for place, path in places.items() if place not in set(wanted)]
        for names, what in ((missing, "has no file for"), (extra, f"has more than {self.rows} x {self.columns} pixels:")):
            if names:
                more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
                raise LuxloopError(
                    f"{self.path}: {what} {', '.join(names[:SHOWN])}{more}, rows counted from {first_row} and columns from {first_column}; "
                    "correct the folder, or rows and columns"
                )
        return [places[place] for place in wanted]


class FileSource(Params):
    """The photometric file of one pixel, used once or repeated over a grid."""

    kind: Literal["file"] = "file"
    path: Path = Field(examples=["pixel.ies"], description=".ies or .ldt file of one pixel")
    rows: PixelCount = Field(1, description="pixel rows")
    columns: PixelCount = Field(1, description="pixels in a row")
    pitch_deg: float | None = Field(None, ge=1e-4, le=90, description="angle between neighbours in a row; required for several pixels")
    aspect: float = Field(1.0, ge=0.01, le=100, description="width over height of the grid's cells: rows are pitch_deg / aspect apart")
    aim: Aim = Field("beam", description=AIM)

    @model_validator(mode="after")
    def _pitch_fits(self) -> Self:
        if self.pitch_deg is None and self.rows * self.columns > 1:
            raise ValueError(f"pitch_deg: is missing; {self.rows} x {self.columns} pixels need the angle between neighbours")
        for number, what, step in (
            (self.columns, "columns", self.pitch_deg or 0.0),
            (self.rows, "rows", (self.pitch_deg or 0.0) / self.aspect),
        ):
            if number > 1 and number * step > 2 * LARGEST_ANGLE_DEG:
                raise ValueError(
                    f"pitch_deg: {number} {what} {step:g} deg apart span {number * step:g} deg; a texture reaches "
                    f"±{LARGEST_ANGLE_DEG:g} deg, so give a smaller pitch or fewer pixels"
                )
        return self

    def pixels(self) -> PixelArray:
        """The pixel, turned rigidly to each place of a grid whose middle is the beam axis. Raises LuxloopError where the file is broken."""
        distribution = read_all([self.path])[0].distribution
        if self.pitch_deg is None:
            return PixelArray([Pixel(distribution)], 1, 1, self.aim)
        up = (0.5 * (self.rows - 1) - np.arange(self.rows)) * self.pitch_deg / self.aspect
        left = (0.5 * (self.columns - 1) - np.arange(self.columns)) * self.pitch_deg
        pixels = [Pixel(distribution, _turn(each_left, each_up)) for each_up in up for each_left in left]
        return PixelArray(pixels, self.rows, self.columns, self.aim)


class TableSource(Params):
    """All pixels measured in one table; rows and columns where it numbers its pixels in one dimension.

    `.npz`: `candela` `[n_p, V, H]` or `[rows, columns, V, H]`, `horizontal_deg` `[H]`, `vertical_deg` `[V]`, optionally `rgb` `[..., V, H,
    3]`, linear sRGB of any scale. `.csv`: a line a value, with the columns pixel (or row and column), horizontal_deg, vertical_deg,
    candela, optionally red, green and blue; missing angles are dark. Numbers count from 0 or 1.
    """

    kind: Literal["table"] = "table"
    path: Path = Field(examples=["pixels.csv"], description="table of all pixels, .npz or .csv")
    rows: int | None = Field(None, gt=0, le=MOST_PIXELS, description="pixel rows, if the table does not say")
    columns: int | None = Field(None, gt=0, le=MOST_PIXELS, description="pixels per row, if the table does not say")

    def pixels(self) -> PixelArray:
        """Read the table. Raises LuxloopError that names the file and what is wrong in it."""
        readers = {".npz": _read_npz, ".csv": _read_csv}
        if (suffix := self.path.suffix.lower()) not in readers:
            raise LuxloopError(f"{self.path}: is neither .npz nor .csv; save the table as one of them")
        return readers[suffix](self.path, self.rows, self.columns)


def _turn(left_deg: float, up_deg: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return pose_from_degrees((0.0, 0.0, 0.0), 0.0, -up_deg, left_deg)[:3, :3].double().numpy()


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort p2 before p10."""
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in re.split(r"(\d+)", path.name)]
