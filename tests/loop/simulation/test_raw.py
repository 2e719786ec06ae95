"""Raw utilisations: shown as they are, frame by frame, below functions and limits; what does not fit is named."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from luxloop import Simulation
from luxloop.world.lamps.utilisations import read_sequence
from luxloop.world.photometry.distribution import Array
from tests.loop.conftest import simulated, van
from tests.refusal import sentence

ROWS, COLUMNS, FRAMES = 3, 28, 4  # pixels of hd84


RAW = """
name = "raw"
rate_hz = 10
renderer = "raycast"
headlight.model = "hd84"
camera = { width_px = 160, height_px = 90 }
"""


def playing(*raw: dict[str, Any], **changes: Any) -> Simulation:
    return simulated(RAW, lighting={"raw": raw, **changes.pop("lighting", {})}, **changes)


@pytest.fixture(scope="module")
def sequence() -> Array:
    """Frames whose values are exact in 8 bits, each unlike the others and unlike itself mirrored."""
    return np.random.default_rng(3).integers(0, 256, (FRAMES, ROWS, COLUMNS)) / 255


FORMS = ("all.npy", "all.npz", "png", "png16", "csv", "png/*.png")


@pytest.fixture
def written(sequence: Array, tmp_path: Path) -> Path:
    """The sequence in every form that it may have."""
    np.save(tmp_path / "all.npy", sequence)
    np.savez(tmp_path / "all.npz", sequence)
    for folder in ("png", "png16", "csv"):
        (tmp_path / folder).mkdir()
    for k, frame in enumerate(sequence):
        cv2.imwrite(str(tmp_path / "png" / f"{k:02d}.png"), np.round(255 * frame).astype(np.uint8))
        cv2.imwrite(str(tmp_path / "png16" / f"{k:02d}.png"), np.round(65535 * frame).astype(np.uint16))
        np.savetxt(tmp_path / "csv" / f"{k:02d}.csv", frame, delimiter=",")
    return tmp_path


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_frames(form, written, sequence):
    read = read_sequence(written / form, ROWS, COLUMNS)
    assert read.rate_hz == 25.0
    torch.testing.assert_close(read.frames, torch.from_numpy(sequence).flatten(1).float(), rtol=0, atol=1e-7)  # float32


def test_both_lamps_show_the_frame_of_the_time(written, sequence):
    """At 10 steps and 5 frames a second each frame stays for two steps; then it starts over, or the last one stays."""
    raw = {"file": str(written / "png"), "rate_hz": 5.0}
    again, held = (playing(raw | {"repeat": repeat}) for repeat in (True, False))
    for step in range(10):
        frame = torch.from_numpy(sequence[step // 2 % FRAMES]).flatten().float()
        for u in again.at(step).lights:
            torch.testing.assert_close(u, frame, rtol=0, atol=1e-7)
    for u in held.at(9).lights:
        torch.testing.assert_close(u, torch.from_numpy(sequence[-1]).flatten().float(), rtol=0, atol=1e-7)


def test_functions_draw_over_them_and_limits_hold(written):
    bare, masked, limited = (
        playing({"file": str(written / "png")}, objects=[van((30.0, 3.0, 180.0))], **changes).at(0)
        for changes in ({}, {"functions": {"guard": {"kind": "glare_free"}}}, {"lighting": {"power_limit": 0.1}})
    )
    assert bare.objects["van"].lx_max > 0.5 and masked.dark_lx_max == 0.0
    for u, with_mask, dimmed in zip(bare.lights, masked.lights, limited.lights, strict=True):
        assert ((with_mask == u) | (with_mask == 0)).all() and 0 < (with_mask != u).sum() < 42
        torch.testing.assert_close(dimmed / dimmed.max(), u / u.max(), rtol=1e-5, atol=0)
    assert all(power.share == pytest.approx(0.1) for power in limited.powers.values())


WRONG: dict[str, list[dict[str, Any]]] = {
    "No such file": [{"file": "./no.npy"}],
    "there are no utilisations": [{"file": "empty/"}],
    "bring them to this size": [{"file": "curtain"}],
    "between 0 and 1": [{"file": "much.npy"}],
    "lighting.raw[0].modules": [{"file": "good.npy", "modules": ["hires"]}],
    "lighting.raw[1]": [{"file": "good.npy"}, {"file": "good.npy", "modules": ["left"]}],
}


@pytest.mark.parametrize(("words", "raw"), WRONG.items(), ids=WRONG)
def test_what_does_not_fit_is_named_in_a_sentence(words, raw, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "text.txt").write_text("0")
    np.save(tmp_path / "much.npy", np.full((ROWS, COLUMNS), 2.0))
    np.save(tmp_path / "good.npy", np.ones((ROWS, COLUMNS)))
    with sentence("lighting.raw[0]", words):
        playing(*({**each, "file": str(tmp_path / each["file"])} if each["file"] != "curtain" else each for each in raw))
