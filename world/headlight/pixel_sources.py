"""Sources of a module's pixels in a lamp description: a folder of files, a file, a table (T 5.2)."""

import os
import re
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from luxloop.world.errors import LuxloopError
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight.parametric import MOST_PIXELS
from luxloop.world.headlight.pixel_tables import read_table
from luxloop.world.headlight.pixels import Pixel, PixelArray
from luxloop.world.params import Params
from luxloop.world.photometry.distribution import Aim
from luxloop.world.photometry.files import read_all
from luxloop.world.texels import LARGEST_ANGLE_DEG

SUFFIXES = (".ies", ".ldt")
SHOWN = 5  # names in a message
AIM = 'type C and EULUMDAT: turn nadir into the beam axis ("beam"), or leave the file as the luminaire hangs ("nadir")'


class FolderSource(Params):
    """One photometric file per pixel."""

    kind: Literal["folder"] = "folder"
    path: Path = Field(examples=["pixels"], description="folder with one .ies or .ldt file per pixel")
    rows: int = Field(gt=0, le=MOST_PIXELS, examples=[16], description="pixel rows")
    columns: int = Field(gt=0, le=MOST_PIXELS, examples=[64], description="pixels in a row")
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
    rows: int = Field(1, gt=0, le=MOST_PIXELS, description="pixel rows")
    columns: int = Field(1, gt=0, le=MOST_PIXELS, description="pixels in a row")
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
    """All pixels measured in one table."""

    kind: Literal["table"] = "table"
    path: Path = Field(examples=["pixels.csv"], description="table of all pixels, .npz or .csv")
    rows: int | None = Field(None, gt=0, le=MOST_PIXELS, description="pixel rows, if the table does not say")
    columns: int | None = Field(None, gt=0, le=MOST_PIXELS, description="pixels per row, if the table does not say")

    def pixels(self) -> PixelArray:
        """Read the table. Raises LuxloopError that names the file and what is wrong in it."""
        return read_table(self.path, self.rows, self.columns)


def _turn(left_deg: float, up_deg: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return pose_from_degrees((0.0, 0.0, 0.0), 0.0, -up_deg, left_deg)[:3, :3].double().numpy()


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort p2 before p10."""
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in re.split(r"(\d+)", path.name)]
