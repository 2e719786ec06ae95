"""The ChArUco board: printed at its size, and its corners found in a frame."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from PIL import Image as Picture
from pydantic import Field

from luxloop.loop.rig.calibration.bench import Array, Image, Indices
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole
from luxloop.world.params import Params

PAPERS: Final = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}  # mm
DPI: Final = 300
INCH_MM: Final = 25.4
MARGIN_MM: Final = 10.0  # that printers leave white
MARKER: Final = 0.75  # of a square's side
FEWEST: Final = 6  # corners of a view
LEAST_CONTRAST: Final = 0.02  # of the darkest part of a picture to the brightest, relative to that
THIN: Final = 0.5  # squares, second singular value of corners that lie in a line, but for one
SCALES: Final = (1, 2)  # of the picture: a far board's markers have too few pixels a bit in the first


class BoardParams(Params):
    """Squares of a ChArUco board with markers of 5 x 5 bits."""

    columns: int = Field(8, ge=3, le=30, description="squares in a row")
    rows: int = Field(11, ge=3, le=30, description="squares in a column")
    square_mm: float = Field(23.0, gt=1, le=500, description="side of a square as printed; measure it on the paper")


@dataclass(frozen=True, eq=False)
class Corners:
    """The detected corners of a board. board: `[n, 2]` m on the board. pixels: `[n, 2]` px, pixel centres at integer + 0.5. name: of the
    picture.
    """

    board: Array
    pixels: Array
    name: str = "a view"


def _board(params: BoardParams) -> Any:
    side = params.square_mm / 1000
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    return cv2.aruco.CharucoBoard((params.columns, params.rows), side, MARKER * side, words)


def picture(params: BoardParams, dpi: float) -> Image:
    """A picture of the board without margin, grey `[height, width]`. dpi: approximate resolution in px per inch."""
    px = round(params.square_mm / INCH_MM * dpi)
    drawn: Image = _board(params).generateImage((px * params.columns, px * params.rows), marginSize=0, borderBits=1)
    return drawn


def print_board(path: Path, params: BoardParams, paper: str) -> None:
    """Write a page, .pdf or .png, with the board in its middle, to scale if printed at 100 %.

    Raises LuxloopError if the board is larger than the paper.
    """
    if path.suffix not in (".pdf", ".png"):
        raise LuxloopError(f"{path}: a board is a .pdf or a .png; name one of them")
    size_mm = PAPERS[paper]
    needed = params.columns * params.square_mm, params.rows * params.square_mm
    if any(need + 2 * MARGIN_MM > has for need, has in zip(needed, size_mm, strict=True)):
        raise LuxloopError(
            f"the board has {needed[0]:g} x {needed[1]:g} mm, but {paper} has {size_mm[0]:g} x {size_mm[1]:g} mm with 10 mm of margin; "
            "take smaller or fewer squares, or --paper a3"
        )
    drawn = picture(params, DPI)
    dpi = drawn.shape[1] / needed[0] * INCH_MM  # of whole pixels a square
    page = np.full([round(each / INCH_MM * dpi) for each in size_mm[::-1]], 255, np.uint8)
    top, left = ((a - b) // 2 for a, b in zip(page.shape, drawn.shape, strict=True))
    page[top : top + drawn.shape[0], left : left + drawn.shape[1]] = drawn
    note = f"{params.columns} x {params.rows} squares of {params.square_mm:g} mm, DICT_5X5_1000; print at 100 %, measure a square"
    cv2.putText(page, note, (left, top + drawn.shape[0] + 60), cv2.FONT_HERSHEY_SIMPLEX, 1.0, 0, 2, cv2.LINE_AA)
    with whole(path) as part:
        Picture.fromarray(page).save(part, format=path.suffix[1:].upper(), resolution=dpi, dpi=(dpi, dpi))


def corners(frame: Image, params: BoardParams, name: str = "a view") -> Corners | str:
    """The corners detected in a frame `[height, width]`, or why it cannot be used: too little contrast, no marker of the board, fewer
    than six corners, or corners in a line. Boards of OpenCV before 4.6 with an even number of rows are read as well.
    """
    low, peak = (float(each) for each in np.percentile(frame, (0.5, 99.5)))
    if peak - low <= LEAST_CONTRAST * peak:
        return f"has a contrast of {peak - low:.2g} of {peak:.3g}; light the board, or expose longer"
    grey = np.clip((frame.astype(float) - low) * (255 / (peak - low)), 0, 255).astype(np.uint8)
    board = _board(params)
    places = board.getChessboardCorners()[:, :2].astype(float)
    found, ids, markers = max((_detected(grey, board, scale) for scale in SCALES), key=_count)
    if len(ids) < FEWEST:
        board.setLegacyPattern(True)
        found, ids, markers = max(((found, ids, markers), *(_detected(grey, board, scale) for scale in SCALES)), key=_count)
    if not markers:
        return "shows no marker of the board; check that it is one of `luxloop rig board`, sharpness and light"
    if len(ids) < FEWEST:
        wanted = f"{params.columns} x {params.rows} squares"
        return f"shows {markers} markers, but only {len(ids)} corners of {wanted}; check --columns, --rows, and sharpness"
    at = places[ids]
    if (
        min(np.linalg.svd(rest - rest.mean(0), compute_uv=False)[1] for rest in (np.delete(at, k, 0) for k in range(len(at))))
        < THIN * params.square_mm / 1000
    ):
        return "shows corners in one line only; show more of the board"
    sharp = cv2.cornerSubPix(
        grey, found.astype(np.float32), (5, 5), (-1, -1), (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    )
    return Corners(at, sharp.reshape(-1, 2).astype(float) + 0.5, name)


def _detected(grey: Image, board: Any, scale: int) -> tuple[Array, Indices, int]:
    """Corners `[n, 1, 2]` px, from the centre of the first pixel, their numbers `[n]`, and the number of markers, seen in a picture that
    many times as large.
    """
    large = grey if scale == 1 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    found, ids, markers, _ = cv2.aruco.CharucoDetector(board).detectBoard(large)
    if ids is None:
        return np.zeros((0, 1, 2)), np.zeros(0, int), len(markers or ())
    return (np.asarray(found, float) + 0.5) / scale - 0.5, np.asarray(ids, np.intp).ravel(), len(markers)


def _count(found: tuple[Array, Indices, int]) -> tuple[int, int]:
    return len(found[1]), found[2]
