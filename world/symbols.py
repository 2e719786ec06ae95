"""Symbols to project: pictures, drawings, image sequences and videos behind one protocol (T 7.2.2).

Everything that comes from a file is grey, white is light, and transparent parts are dark.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import resvg_py
import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.files import afford, content, reading, regular
from luxloop.world.images import decode, svg_text

DRAWN_PX = 512  # longer side of a drawn SVG, and the greatest of a video: finer than any lamp's pixels
CSS_DPI = 96.0  # px an inch in an SVG (CSS Values and Units 4, 6.2)
FOLDER_HZ = 25.0  # default rate of a folder of pictures
FRAME_BYTES = 2  # of a video's pixel: a grey level, and a copy while frames are joined
DECODED_BYTES = 16  # of a pixel of the frame at work, in the video's own size
# Formats that are opened; playlists are not, as they name other files.
CONTAINERS = {"protocol_whitelist": "file", "format_whitelist": "mov,mp4,matroska,webm,avi,gif"}
DRAWINGS = (".svg", ".svgz")
PICTURES = (".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".gif")


class SymbolSource(Protocol):
    """A symbol image over time."""

    def at(self, time_s: float) -> Tensor:
        """`[h, w]` in 0..1, image row 0 at the symbol's far end."""
        ...


@dataclass(frozen=True, eq=False)
class Still:
    """One image `[h, w]` at all times."""

    image: Tensor

    def at(self, time_s: float) -> Tensor:
        return self.image


@dataclass(frozen=True, eq=False)
class Frames:
    """Images `[n, h, w]` uint8 one after the other. rate_hz: images a second. repeat: start over at the end, or hold the last."""

    images: Tensor
    rate_hz: float
    repeat: bool = True

    def at(self, time_s: float) -> Tensor:
        return self.images[frame_at(len(self.images), time_s, self.rate_hz, self.repeat)].float() / 255


def frame_at(n: int, time_s: float, rate_hz: float, repeat: bool) -> int:
    """Index of the frame of n at a time; with `repeat` the sequence starts over at its end, else its last frame stays."""
    index = int(max(time_s, 0.0) * rate_hz + 1e-6)  # rounding may put a frame's own time just before it
    return index % n if repeat else min(index, n - 1)


def load(path: Path, rate_hz: float | None = None, repeat: bool = True) -> SymbolSource:
    """Load a symbol by its suffix: a picture, an SVG, a video, or a folder of pictures in the order of their names.

    rate_hz: images a second; by default a video's own, 25 for a folder. Raises LuxloopError if it cannot be read or is all black.
    """
    if os.path.isdir(path):
        return _lit(Frames(_sequence(path), rate_hz or FOLDER_HZ, repeat), path)
    if not os.path.exists(path):
        raise LuxloopError(
            f"symbol {path} does not exist: give the path of a picture, SVG, video or folder, or the name of a shipped symbol"
        )
    if path.suffix.lower() in VIDEOS:
        images, own_hz = video(path)
        return _lit(Frames(images, rate_hz or own_hz, repeat), path)
    return _lit(Still(_picture(path)), path)


def load_still(path: Path) -> Tensor:
    """Image `[h, w]` in 0..1 of a picture or an SVG. Raises LuxloopError for sequences and videos, and as `load` does."""
    if os.path.isdir(path) or path.suffix.lower() in VIDEOS:
        raise LuxloopError(f"symbol {path} moves, but a symbol under control stands still: give a picture or an SVG")
    return load(path).at(0.0)


def _picture(path: Path) -> Tensor:
    """Grey image `[h, w]` float32 in 0..1 of a picture of 8 or 16 bits, or of an SVG, drawn so that its longer side has DRAWN_PX."""
    coded = content(path)
    if path.suffix.lower() in DRAWINGS:
        try:
            coded = resvg_py.svg_to_bytes(svg_string=svg_text(coded), width=DRAWN_PX, height=DRAWN_PX, dpi=CSS_DPI)
        except ValueError as error:
            raise LuxloopError(f"symbol {path} is not a valid SVG ({error}): export it again as plain SVG, or save it as a PNG") from error
    image = decode(coded, f"symbol {path}")
    if image is None or image.dtype.kind != "u":
        raise LuxloopError(f"symbol {path} cannot be read as a picture of 8 or 16 bits: save it as an 8-bit PNG")
    grey = image.astype(np.float32) / (2 ** (8 * image.itemsize) - 1)
    if grey.ndim == 3:
        alpha = grey[..., 3] if grey.shape[2] == 4 else 1.0
        grey = cv2.cvtColor(grey[..., :3], cv2.COLOR_BGR2GRAY) * alpha
    return torch.from_numpy(np.ascontiguousarray(grey))


def _sequence(folder: Path) -> Tensor:
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in PICTURES)
    if not files:
        raise LuxloopError(f"symbol folder {folder} holds no pictures ({', '.join(PICTURES)}): put a numbered sequence of PNGs into it")
    images = [_picture(file) for file in files]
    for file, image in zip(files, images, strict=True):
        if image.shape != images[0].shape:
            sizes = " and ".join(f"{w} x {h}" for h, w in (images[0].shape, image.shape))
            raise LuxloopError(f"symbol {file} is of another size than {files[0].name} ({sizes} px): save all pictures of a sequence alike")
    return torch.stack([(255 * image).round().to(torch.uint8) for image in images])


def video(path: Path, largest_px: int | None = DRAWN_PX) -> tuple[Tensor, float]:
    """All frames of a video `[n, h, w]` uint8 and their rate in Hz. largest_px: greatest side after shrinking, None for the video's own
    size.
    """
    import av

    frames: list[Tensor] = []
    sound = reading(path, "is no video that can be read", "convert it to H.264 in an .mp4 file")
    with sound, av.open(str(regular(path)), options=CONTAINERS) as container:
        stream = container.streams.video[0]
        afford(f"video {path}: a frame", DECODED_BYTES * stream.width * stream.height, "shrink it")
        rate_hz = float(stream.average_rate or 25)
        for frame in container.decode(stream):
            shrink = 1.0 if largest_px is None else min(1.0, largest_px / max(frame.width, frame.height))
            width, height = (max(round(side * shrink), 1) for side in (frame.width, frame.height))
            n_bytes = FRAME_BYTES * width * height * (len(frames) + 1)
            afford(f"video {path}: its frames", n_bytes, "cut it to the part that shall be shown")
            rgb = frame.to_ndarray(width=width, height=height, format="rgb24")  # full range: a video's own black may be 16 of 255
            grey = np.rot90(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), frame.rotation // 90)
            frames.append(torch.from_numpy(np.ascontiguousarray(grey)))
    if not frames:
        raise LuxloopError(f"video {path} has no frames: export it again")
    return torch.stack(frames), rate_hz


def _lit(source: Still | Frames, path: Path) -> Still | Frames:
    image = source.images if isinstance(source, Frames) else source.image
    if not image.any():
        raise LuxloopError(f"symbol {path} is all black: draw the symbol in white, since white is light")
    return source
