"""Symbols from all kinds of files, and what is said of bad ones."""

import gzip
import os
import struct
import tracemalloc
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch
from PIL import ExifTags, Image, ImageOps
from torch.testing import assert_close

from luxloop.world.images import LONGEST, decode
from luxloop.world.symbols import DRAWN_PX, Frames, load, load_still
from tests.refusal import refusal

SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 40 20"><rect x="10" width="20" height="10" fill="{}"/></svg>'


def write_video(path: Path, frames: list[np.ndarray], rate: int = 10) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.height, stream.width = frames[0].shape
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.repeat(frame[..., None], 3, -1), "rgb24")))
        container.mux(stream.encode())


def write(folder: Path, image: np.ndarray, name: str = "functions.symbol.png") -> Path:
    path = folder / name
    cv2.imencode(path.suffix, image)[1].tofile(path)
    return path


def test_pictures_become_grey_in_0_to_1(tmp_path):
    def loaded(image: np.ndarray) -> torch.Tensor:
        symbol = load_still(write(tmp_path, image))
        assert (symbol.dtype, symbol.shape) == (torch.float32, (2, 2))
        return symbol

    grey = np.array([[0, 51], [102, 255]], np.uint8)
    expected = torch.tensor([[0.0, 0.2], [0.4, 1.0]])
    assert_close(loaded(grey), expected)
    assert_close(loaded(grey.astype(np.uint16) * 257), expected)
    assert_close(loaded(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)), expected)
    half_transparent = np.dstack([np.full((2, 2, 3), 255, np.uint8), grey])
    assert_close(loaded(half_transparent), expected)
    assert loaded(np.full((2, 2), 51, np.uint8)).max().item() == pytest.approx(0.2)  # a dim picture stays dim


def test_what_moves_is_no_symbol_under_control(tmp_path):
    for path in (tmp_path, tmp_path / "a.mp4"):
        with refusal("moves, but a symbol under control stands still: give a picture or an SVG"):
            load_still(path)


def test_an_svg_is_drawn_where_its_shapes_are(tmp_path):
    (tmp_path / "a.SVG").write_text(SVG.format("white"))
    image = load(tmp_path / "a.SVG").at(0)
    assert image.shape == (DRAWN_PX // 2, DRAWN_PX)
    expected = torch.zeros_like(image)
    expected[: DRAWN_PX // 4, DRAWN_PX // 4 : 3 * DRAWN_PX // 4] = 1
    assert_close(image, expected)


def test_a_folder_is_a_sequence_in_the_order_of_names(tmp_path):
    for i in (2, 0, 1):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.full((2, 3), 100 * i, np.uint8))
    held, repeated = load(tmp_path, rate_hz=10, repeat=False), load(tmp_path, rate_hz=10)
    shown = [round(255 * float(held.at(t)[0, 0])) for t in (-1, 0, 0.1, 0.25, 0.3, 9)]
    assert shown == [0, 0, 100, 200, 200, 200]
    assert round(255 * float(repeated.at(0.4)[0, 0])) == 100


def test_a_video_plays_at_its_own_rate(tmp_path):
    write_video(tmp_path / "a.mp4", [np.full((32, 48), v, np.uint8) for v in (0, 128, 255)])
    symbol = load(tmp_path / "a.mp4", repeat=False)
    assert isinstance(symbol, Frames) and symbol.rate_hz == 10
    levels = [255 * symbol.at(t).mean().item() for t in (0, 0.1, 0.2, 5)]
    np.testing.assert_allclose(levels, [0, 128, 255, 255], atol=4)  # H.264 is lossy; black read as 16 would be 12 off
    write_video(tmp_path / "large.mp4", [np.full((64, 2 * DRAWN_PX), 255, np.uint8)])
    assert load(tmp_path / "large.mp4").at(0).shape == (32, DRAWN_PX)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.png", b"no picture", "cannot be read as a picture"),
        ("a.png", b"", "cannot be read as a picture"),
        ("a.svg", b"<svg", "is not a valid SVG"),
        ("a.svgz", gzip.compress(SVG.encode(), mtime=0)[:-9], "is not a valid SVG"),
        ("a.svg", gzip.compress(SVG.encode(), mtime=0)[:40] + b"0123", "is not a valid SVG"),
        ("a.svgz", gzip.compress(SVG.encode(), mtime=0)[:-8] + bytes(8), "is not a valid SVG"),
        ("a.svg", SVG.format("black").encode(), "all black"),
        ("a.mp4", b"no video", "convert it to H.264"),
        ("a.txt", b"hello", "cannot be read as a picture"),
    ],
)
def test_bad_files_are_named_in_one_sentence(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with refusal(says) as error:
        load(tmp_path / name)
    assert name in str(error.value) and "\n" not in str(error.value)


def test_missing_files_and_bad_folders(tmp_path):
    with refusal("cannot be read as a picture of 8 or 16 bits"):
        load(write(tmp_path, np.ones((2, 2), np.float32), "float.tiff"))
    (tmp_path / "float.tiff").unlink()
    with refusal("does not exist"):
        load(tmp_path / "a.png")
    with refusal("holds no pictures"):
        load(tmp_path)
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((2, 2), np.uint8))
    with refusal("all black"):
        load(tmp_path)
    cv2.imwrite(str(tmp_path / "1.png"), np.ones((2, 3), np.uint8))
    with refusal(r"1\.png is of another size than 0\.png \(2 x 2 and 3 x 2 px\)"):
        load(tmp_path)


INSIDE = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:x="http://www.w3.org/1999/xlink" viewBox="0 0 40 20">{}{}</svg>'
RECTANGLE = '<rect id="r" x="10" width="20" height="10" fill="white"/>'


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ('<image x:href="/dev/zero" width="9" height="9"/>', "outside of itself"),
        ('<image href="https://example.org/a.png" width="9" height="9"/>', "outside of itself"),
        ('<image href="data:image/png;base64,AAAA" width="9" height="9"/>', "embeds a picture"),
        ('<rect width="9Q" height="9"/>', "lengths in Q"),
        ('<rect style="x:3; stroke-width: 2.5rem" height="9"/>', "lengths in rem"),
        ('<rect fill="url( file:///a.svg#b )" width="9" height="9"/>', "outside of itself"),
        ("<style>@import 'a.css';</style>", "outside of itself"),
        ("<g>" * 3000 + "</g>" * 3000, "nested deeper"),
    ],
)
def test_an_svg_stands_for_itself(extra, words, tmp_path):
    file = tmp_path / "a.svg"
    file.write_text(INSIDE.format(RECTANGLE, extra))
    with refusal(words):
        load_still(file)
    file.write_text('<!DOCTYPE svg [<!ENTITY lol "lol">]>' + INSIDE.format(RECTANGLE, ""))
    with refusal("entity 'lol'"):
        load_still(file)
    file.write_text(INSIDE.format(RECTANGLE, '<use x:href="#r"/><a href="https://example.org"/>'))
    assert load_still(file).any()


@pytest.mark.parametrize(
    ("unit", "px"), [("mm", 96 / 25.4), ("cm", 96 / 2.54), ("in", 96), ("pt", 96 / 72), ("pc", 16), ("px", 1), ("", 1)]
)
def test_units_of_an_svg_are_those_of_css(unit, px, tmp_path):
    """CSS Values and Units 4, 6.2: 96 px an inch, of the page and of parts within a drawing's own coordinates."""
    side = 200 / px  # in the unit
    page = f'width="{side}{unit}" height="{side / 2}{unit}" viewBox="0 0 400 200"'
    parts = f'<rect x="{side}{unit}" width="{side / 2}{unit}" height="200" fill="white"/>'
    (tmp_path / "a.svg").write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {page}>{parts}</svg>')
    image = load_still(tmp_path / "a.svg")
    expected = torch.zeros(256, 512)
    expected[:, 256:384] = 1
    assert_close(image, expected, atol=0.01, rtol=0)  # borders fall on pixels but for rounding in the file


@pytest.mark.parametrize("kind", ["jpeg", "png", "webp", "tiff", "avif"])
def test_pictures_are_upright_by_their_exif_orientation(kind, tmp_path):
    picture = np.zeros((40, 64), np.uint8)
    picture[8:32, 8:16] = picture[24:32, 8:56] = 255
    file = tmp_path / f"a.{kind}"
    for orientation in range(1, 9):
        image = Image.fromarray(picture)
        image.getexif()[ExifTags.Base.Orientation] = orientation
        upright = np.asarray(ImageOps.exif_transpose(image))
        image.save(file, exif=image.getexif(), lossless=True)  # whose AVIF has a transformation in its place
        for flags in (cv2.IMREAD_UNCHANGED, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH):
            read = decode(file.read_bytes(), "it", flags)
            assert read is not None and read.shape[:2] == upright.shape
            assert np.abs(read.reshape(*upright.shape, -1)[..., 0].astype(int) - upright).max() < 16  # JPEG is lossy


def test_half_a_jpeg_a_pipe_and_utf_16_are_refused(tmp_path):
    data = write(tmp_path, np.random.default_rng(0).integers(0, 255, (64, 64), np.uint8), "a.jpg").read_bytes()
    (tmp_path / "half.jpg").write_bytes(data[: len(data) // 2] + b"\xff\xd9")
    os.mkfifo(tmp_path / "pipe.png")
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "wide.svg").write_text(INSIDE.format(RECTANGLE, ""), "utf-16")
    for name, words in {
        "half.jpg": "8 or 16 bits",
        "pipe.png": "no regular file",
        "pipe.mp4": "no regular",
        "wide.svg": "save it as UTF-8",
    }.items():
        with refusal(words):
            load(tmp_path / name)


def test_a_video_is_turned_as_its_matrix_says(tmp_path):
    picture = np.zeros((32, 64), np.uint8)
    picture[:16, :16] = 255
    file = tmp_path / "a.mp4"
    write_video(file, [picture])
    data = bytearray(file.read_bytes())
    matrix = data.index(b"tkhd") + 44  # ISO/IEC 14496-12, 8.3.2, in 16.16
    data[matrix : matrix + 36] = struct.pack(">9i", 0, 1 << 16, 0, -1 << 16, 0, 0, 0, 0, 1 << 30)  # a quarter clockwise
    file.write_bytes(data)
    np.testing.assert_allclose(load(file).at(0) * 255, np.rot90(picture, -1), atol=4)  # H.264 is lossy


def test_an_svgz_is_unpacked_no_further_than_it_may_be_long(tmp_path):
    (tmp_path / "a.svgz").write_bytes(gzip.compress(bytes(4 * LONGEST), mtime=0))
    tracemalloc.start()
    with refusal(r"a\.svgz .*longer than"):
        load(tmp_path / "a.svgz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * LONGEST  # the text, and the pieces that it is joined from


def test_a_picture_with_damaged_exif_stays_as_it_is(tmp_path):
    file = write(tmp_path, np.full((2, 3), 255, np.uint8), "a.jpg")
    data = file.read_bytes()
    exif = b"Exif\0\0MM\0*\xff\xff\xff\xff"
    file.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:])
    assert load_still(file).shape == (2, 3)
