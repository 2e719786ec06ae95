"""Tables that hold all pixels of a module: `.npz` tensors and `.csv` lists; angles to the right and up positive (type A)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from luxloop.world.arrays import read_npz
from luxloop.world.errors import LuxloopError
from luxloop.world.files import reading, regular
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.headlight.pixels import Pixel, PixelArray
from luxloop.world.photometry.distribution import EDGE_DEG, Array, Distribution

ANGLES = ("horizontal_deg", "vertical_deg")
CHANNELS = ("red", "green", "blue")
KNOWN = (*ANGLES, "candela", "pixel", "row", "column", *CHANNELS)
CSV_FORM = "pixel,horizontal_deg,vertical_deg,candela, or row,column in place of pixel"


def read_table(path: Path, rows: int | None = None, columns: int | None = None) -> PixelArray:
    """Pixels of a table; rows and columns where it numbers its pixels in one dimension.

    `.npz`: `candela` `[n_p, V, H]` or `[rows, columns, V, H]`, `horizontal_deg` `[H]`, `vertical_deg` `[V]`, optionally `rgb`
    `[..., V, H, 3]`, linear sRGB of any scale. `.csv`: a line a value, with the columns pixel (or row and column), horizontal_deg,
    vertical_deg, candela, optionally red, green and blue; what is left out is dark. Numbers count from 0 or 1.

    Raises: LuxloopError that names the file and what is wrong in it.
    """
    readers = {".npz": _read_npz, ".csv": _read_csv}
    if path.suffix.lower() not in readers:
        raise LuxloopError(f"{path}: is neither .npz nor .csv; save the table as one of them")
    try:
        return readers[path.suffix.lower()](path, rows, columns)
    except OSError as error:
        raise LuxloopError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error


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
    """Delimiter and decimal point of a .csv: semicolon and comma where spreadsheets write them so, told by the first line."""
    with regular(path).open("rb") as stream:
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
    """The angles that hold a pixel's own, and one more on each side where it is dark; and where the pixel's are among them."""
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
    try:
        if rgb is None:
            return Pixel(_distribution(v, h, candela))
        if not (np.isfinite(rgb).all() and (rgb >= 0).all()):
            raise LuxloopError("colours must be finite and not negative")
        luminance = rgb @ np.array(LUMINANCE)
        white = luminance <= 0
        share = np.where(white[..., None], 1.0, rgb / np.where(white, 1.0, luminance)[..., None])
        red, green, blue = (_distribution(v, h, candela * each) for each in np.moveaxis(share, -1, 0))
        return Pixel(_distribution(v, h, candela), rgb=(red, green, blue))
    except LuxloopError as error:
        raise LuxloopError(f"{path}: pixel {name}: {str(error).removeprefix('distribution: ')}") from error


def _distribution(v: Any, h: Any, candela: Any) -> Distribution:
    """A table as it stands: type A would mirror one whose angles begin at 0, so it is given an edge there."""
    v, h, candela = (np.asarray(each, np.float64) for each in (v, h, candela))
    if len(h) < 2:
        raise LuxloopError("give at least 2 horizontal angles")
    if len(v) and v[0] == 0:
        v, candela = np.insert(v, 0, -EDGE_DEG), np.insert(candela, 0, 0, axis=0)
    if h[0] == 0:
        h, candela = np.insert(h, 0, -EDGE_DEG), np.insert(candela, 0, 0, axis=1)
    return Distribution("A", v, h, np.ascontiguousarray(candela.T))
