"""Intrinsic calibration: lens from views of a ChArUco board, vignetting from frames of an evenly bright surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image as Picture
from pydantic import Field

from luxloop.loop.rig.arrays import Array, Image, Indices
from luxloop.loop.rig.calibration.geometry import HALF, MOST_PX, CameraModel, Pose, covariance_of, rms_of
from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole
from luxloop.world.params import Params

PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}  # mm
DPI = 300
INCH_MM = 25.4
MARGIN_MM = 10.0  # unprintable border of a page
MARKER = 0.75  # side of a marker as a share of a square's
FEWEST_CORNERS = 6  # corners of a view
LEAST_CONTRAST = 0.02  # brightest less darkest part of a picture, as a share of the brightest
THIN = 0.5  # squares, second singular value of corners that lie in one line, but for one corner
SCALES = (1, 2)  # enlargements of the picture; markers of a distant board have too few pixels per bit without


class BoardParams(Params):
    """A ChArUco board with markers of 5 x 5 bits."""

    columns: int = Field(8, ge=3, le=30, description="squares in a row")
    rows: int = Field(11, ge=3, le=30, description="squares in a column")
    square_mm: float = Field(23.0, gt=1, le=500, description="side of a square as printed; measure it on the paper")


@dataclass(frozen=True, eq=False)
class Corners:
    """Detected corners of a board.

    board: `[n, 2]` m on the board. pixels: `[n, 2]` px in the picture, pixel centres at integer + 0.5. name: of the picture.
    """

    board: Array
    pixels: Array
    name: str = "a view"


def _board(params: BoardParams) -> Any:
    side = params.square_mm / 1000
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
    return cv2.aruco.CharucoBoard((params.columns, params.rows), side, MARKER * side, words)


def picture(params: BoardParams, dpi: float) -> Image:
    """Drawing of the board without margin, grey `[height, width]`. dpi: approximate resolution in px per inch."""
    px = round(params.square_mm / INCH_MM * dpi)
    drawn: Image = _board(params).generateImage((px * params.columns, px * params.rows), marginSize=0, borderBits=1)
    return drawn


def print_board(path: Path, params: BoardParams, paper: str) -> None:
    """Write a page, .pdf or .png, with the board in its middle, true to scale if printed at 100 %.

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
    """Board corners detected in a frame `[height, width]`, or the reason why there are none: too little contrast, no marker of the board,
    fewer than six corners, or corners in one line. Boards of OpenCV before 4.6 with an even number of rows are detected as well.
    """
    low, peak = (float(each) for each in np.percentile(frame, (0.5, 99.5)))
    if peak - low <= LEAST_CONTRAST * peak:
        return f"has a contrast of {peak - low:.2g} of {peak:.3g}; light the board, or expose longer"
    grey = np.clip((frame.astype(float) - low) * (255 / (peak - low)), 0, 255).astype(np.uint8)
    board = _board(params)
    places = board.getChessboardCorners()[:, :2].astype(float)
    found, ids, markers = _best(grey, board)
    if len(ids) < FEWEST_CORNERS:
        board.setLegacyPattern(True)
        found, ids, markers = max((found, ids, markers), _best(grey, board), key=lambda each: (len(each[1]), each[2]))
    if not markers:
        return "shows no marker of the board; check that it is one of `luxloop rig board`, sharpness and light"
    if len(ids) < FEWEST_CORNERS:
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


def _best(grey: Image, board: Any) -> tuple[Array, Indices, int]:
    """The detection with most corners over all enlargements."""
    return max((_detect(grey, board, scale) for scale in SCALES), key=lambda each: (len(each[1]), each[2]))


def _detect(grey: Image, board: Any, scale: int) -> tuple[Array, Indices, int]:
    """Corners `[n, 1, 2]` px relative to the first pixel's centre, their numbers `[n]`, and the number of markers, detected in the enlarged
    picture.
    """
    large = grey if scale == 1 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    found, ids, markers, _ = cv2.aruco.CharucoDetector(board).detectBoard(large)
    if ids is None:
        return np.zeros((0, 1, 2)), np.zeros(0, int), len(markers or ())
    return (np.asarray(found, float) + 0.5) / scale - 0.5, np.asarray(ids, np.intp).ravel(), len(markers)


FEWEST_VIEWS = 5
LARGEST_STD = 0.03  # of a determined lens, relative to focal length and picture size
TILTED = 0.94  # foreshortening of a tilted board, by 20 deg or more; the lens adds some
SLANTED = 0.38  # component of a direction that counts as one to that side: 22.5 deg
CORNER = 0.3  # share of the picture's width and height that is its corner
PLACES = {"top left": (0, 0), "top right": (1, 0), "bottom left": (0, 1), "bottom right": (1, 1)}
_CENTRED = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_ZERO_TANGENT_DIST
# Unknowns are freed one by one: all at once, a long lens with barrel distortion ends in another minimum.
STAGES = (_CENTRED | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2, _CENTRED | cv2.CALIB_FIX_K2, _CENTRED, 0)
PRECISE = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-14)  # focal length and distance converge slowly


def lens(views: Sequence[Corners], width: int, height: int) -> tuple[CameraModel, float]:
    """Lens camera from views of a board by least squares, with its covariance, and the rms of the residuals in px.

    Raises LuxloopError for fewer than five views, if one does not fit the others, or if the views do not determine the lens.
    """
    if len(views) < FEWEST_VIEWS:
        raise LuxloopError(
            f"{len(views)} views show the board; take at least {FEWEST_VIEWS}, tilted by 20 to 45 deg to all sides, and into corners"
        )
    points = [np.concatenate([each.board, np.zeros((len(each.board), 1))], 1).astype(np.float32) for each in views]  # [n, 3]
    places = [(each.pixels - 0.5).astype(np.float32)[:, None] for each in views]
    matrix: Any = np.eye(3)
    distortion: Any = np.zeros(5)
    guess = 0
    try:
        for fixed in STAGES:
            found = cv2.calibrateCameraExtended(
                points, places, (width, height), matrix, distortion, flags=fixed | guess | cv2.CALIB_FIX_K3, criteria=PRECISE
            )
            _, matrix, distortion, turns, moves, *_ = found
            guess = cv2.CALIB_USE_INTRINSIC_GUESS
    except cv2.error as error:
        raise LuxloopError(f"the {len(views)} views do not determine the lens ({error.err}); {_missing(views, width, height)}") from error
    camera = CameraModel(width, height, matrix + HALF, np.ravel(distortion)[:5])
    poses = [Pose(np.ravel(turn), np.ravel(move)) for turn, move in zip(turns, moves, strict=True)]
    left = [camera.project(pose.points(each)) - view.pixels for pose, each, view in zip(poses, points, views, strict=True)]
    rms = [rms_of(each) for each in left]
    covariance = _covariance(camera, poses, points, left)
    std, limit = np.sqrt(np.diag(covariance))[:4], LARGEST_STD * np.array([*np.abs(camera.values[:2]), width, height])
    if not (std < limit).all():
        told = ", ".join(f"{name} {a:.4g} ± {b:.2g}" for name, a, b in zip(("fx", "fy", "cx", "cy"), camera.values, std, strict=False))
        raise LuxloopError(f"the {len(views)} views do not determine the lens ({told} px); {_missing(views, width, height)}")
    worst = int(np.argmax(rms))
    if not rms[worst] < MOST_PX:
        raise LuxloopError(
            f"{views[worst].name}: its corners are {rms[worst]:.3g} px rms from where the lens shows them; check --columns and --rows, "
            "keep the board flat, or take the picture out"
        )
    return replace(camera, covariance=covariance), float(np.sqrt(np.mean(np.square(rms))))


def _missing(views: Sequence[Corners], width: int, height: int) -> str:
    """Remedy: the tilts and places of the board that the views lack."""
    """What views to add: the sides of the board that are tilted away in none, and the corners of the picture that none reaches."""
    sides = dict.fromkeys(("left", "right", "top", "bottom"), False)
    for view in views:
        H, _ = cv2.findHomography(view.board - view.board.mean(0), view.pixels)
        if H is None:
            continue
        J = (H[:2, :2] - np.outer(H[:2, 2], H[2, :2]) / H[2, 2]) / H[2, 2]  # of the picture by the board, at its middle
        long, short = np.linalg.svd(J, compute_uv=False)
        if short < TILTED * long:
            x, y = J @ H[2, :2] * np.sign(H[2, 2]) / np.linalg.norm(J @ H[2, :2])  # to where the board is farther away
            sides = {name: sides[name] or part > SLANTED for name, part in zip(sides, (-x, x, -y, y), strict=True)}
    corners = np.concatenate([view.pixels for view in views]) / (width, height)
    no_side = [name for name, there in sides.items() if not there]
    no_place = [name for name, place in PLACES.items() if not (np.abs(corners - place) < CORNER).all(1).any()]
    add = [f"with the {', '.join(no_side)} of the board tilted away by 20 to 45 deg"] * bool(no_side)
    add += [f"with the board in the {', '.join(no_place)} of the picture"] * bool(no_place)
    return f"add views {', and '.join(add) or 'tilted by 20 to 45 deg to all sides, sharp, and large in the picture'}"


def _covariance(camera: CameraModel, poses: Sequence[Pose], points: Sequence[Array], left: Sequence[Array]) -> Array:
    """Covariance `[9, 9]` of fx, fy, cx, cy and distortion with unknown poses; residuals are correlated within a view."""
    normals, gradients = [], []
    for pose, each, off in zip(poses, points, left, strict=True):
        _, by = cv2.projectPoints(each.astype(float), pose.turn, pose.place, camera.matrix, camera.distortion)
        by_pose, by_lens = by[:, :6], by[:, 6:14]  # k3 stays 0
        cross = by_lens.T @ by_pose
        normals.append(by_lens.T @ by_lens - cross @ np.linalg.pinv(by_pose.T @ by_pose) @ cross.T)
        gradients.append(by_lens.T @ off.ravel())
    every = np.concatenate(left)
    freedom = max(every.size - 8 - 6 * len(poses), 1)
    return np.pad(covariance_of(np.stack(normals), np.stack(gradients), float((every**2).sum() / freedom)), (0, 1))


def vignetting(flats: Sequence[Array]) -> tuple[Array, float]:
    """Vignetting of the lens from the linear light `[height, width]` of evenly bright surfaces, such as a diffuser in front of the lens.

    Returns coefficients `[3]` of r^2, r^4 and r^6, r being 1 in the corner, and the relative rms of the residuals.
    """
    rows, right = [], []
    for flat in flats:
        height, width = flat.shape
        r2 = radius(height, width).ravel() ** 2
        some = slice(None, None, max(1, flat.size // 50_000))
        mean = float(
            np.median(flat[height // 2 - height // 10 : height // 2 + height // 10, width // 2 - width // 10 : width // 2 + width // 10])
        )
        rows.append(np.stack([np.ones_like(r2), r2, r2**2, r2**3], -1)[some])
        right.append(flat.ravel()[some] / mean)
    design, values = np.concatenate(rows), np.concatenate(right)
    solved, *_ = np.linalg.lstsq(design, values, rcond=None)
    left = float(np.sqrt(((design @ solved - values) ** 2).mean()))
    return solved[1:] / solved[0], left


def radius(height: int, width: int) -> Array:
    """Distance of each pixel from the image centre, `[height, width]`, 1 in the corners."""
    v, u = np.indices((height, width)) + 0.5
    return np.asarray(np.hypot(u - width / 2, v - height / 2) / np.hypot(width / 2, height / 2))


def brightness(coefficients: Array, height: int, width: int) -> Array:
    """Transmission of the lens at each pixel by vignetting, `[height, width]`, 1 in the centre."""
    r2 = radius(height, width) ** 2
    return np.asarray(1 + r2 * (coefficients[0] + r2 * (coefficients[1] + r2 * coefficients[2])))
