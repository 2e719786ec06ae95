"""Tone-mapped pictures, and videos of pictures."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import av
import numpy as np
import torch
from torch import Tensor

from luxloop.world.errors import LuxloopError
from luxloop.world.files import part_of

NOISY_CRF = 26  # finer would spend megabytes on the camera's noise
Picture = np.ndarray  # [H, W, 3] uint8, RGB


def tone_map(image: Tensor, white: Tensor) -> Picture:
    """Grey picture `[H, W, 3]` of an image `[H, W]` >= 0, by its square root, which shows dark and bright alike; values above white
    saturate.
    """
    grey = (255 * (image / white.to(image)).clamp(0, 1).sqrt()).round().to(torch.uint8).cpu().numpy()
    return np.repeat(grey[..., None], 3, -1)


class VideoWriter:
    """Writes an H.264 video, whole or not at all; use it in a `with` statement.

    Pictures are cut to even sizes, which 4:2:0 chroma requires. Leaving the block closes the file, after Ctrl-C too. Without pictures no
    file is written.
    """

    def __init__(self, path: Path, fps: float, size: tuple[int, int], crf: int = NOISY_CRF) -> None:
        """size: width and height in px. crf: H.264's constant rate factor, lower is finer. Raises LuxloopError where the file cannot be
        written.
        """
        self.path = path
        self._part = part_of(path)
        with self._writing():
            self._file = self._part.open("wb")
        self._container = av.open(self._file, "w", format="mp4")
        options = {"crf": str(crf), "preset": "veryfast"}
        self._stream = self._container.add_stream("h264", Fraction(fps).limit_denominator(1000), options)
        self._stream.width, self._stream.height = (n - n % 2 for n in size)
        self._stream.pix_fmt = "yuv420p"
        self._stream.thread_count = 1  # the file does not depend on the number of cores

    def __enter__(self) -> Self:
        return self

    def add(self, picture: Picture) -> None:
        """Append a picture `[H, W, 3]` uint8, RGB, of the video's size. Raises LuxloopError where it cannot be written."""
        even = np.ascontiguousarray(picture[: self._stream.height, : self._stream.width])
        with self._writing():
            self._container.mux(self._stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")))

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            with self._writing():
                self._container.mux(self._stream.encode(None))
                self._container.close()
                self._file.close()
                if self._part.stat().st_size:
                    os.replace(self._part, self.path)
        except LuxloopError:
            if not isinstance(error, Exception):  # else the first error is raised
                raise
        finally:
            self._part.unlink(missing_ok=True)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, av.FFmpegError) as error:
            raise LuxloopError(f"{self.path}: cannot be written ({error.strerror or error}); name another file or directory") from error
