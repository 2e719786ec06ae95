"""Raw utilisations: shown as they are, frame by frame, below functions and limits; what does not fit is named."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from luxloop.loop.scenario.model import Scenario, validate
from luxloop.world.lamps.utilisations import read_sequence
from luxloop.world.photometry.distribution import Array
from tests.loop.conftest import simulation_of
from tests.refusal import sentence

ROWS, COLUMNS, FRAMES = 3, 28, 4  # pixels of hd84
MASK = {"kind": "glare_free"}
VAN = {"kind": "box", "name": "van", "category": "car", "size_m": [4.5, 1.8, 1.9], "track": [{"position_m": [30, 3, 0], "yaw_deg": 180}]}


def scenario(raw: Any, **changes: Any) -> Scenario:
    lighting = {"raw": raw, **changes.pop("lighting", {})}
    camera = {"width_px": 160, "height_px": 90}
    given = {"name": "raw", "rate_hz": 10, "headlight": {"model": "hd84"}, "camera": camera, "renderer": "raycast", "lighting": lighting}
    return validate(given | changes, "raw")


@pytest.fixture(scope="module")
def sequence() -> Array:
    """Frames whose values are exact in 8 bits, each unlike the others and unlike itself mirrored."""
    return np.random.default_rng(3).integers(0, 256, (FRAMES, ROWS, COLUMNS)) / 255


@pytest.fixture
def written(sequence: Array, tmp_path: Path) -> dict[str, Path]:
    """The sequence in every form that it may have."""
    np.save(tmp_path / "all.npy", sequence)
    np.savez(tmp_path / "all.npz", sequence)
    for folder in ("png", "png16", "csv"):
        (tmp_path / folder).mkdir()
    for k, frame in enumerate(sequence):
        cv2.imwrite(str(tmp_path / "png" / f"{k:02d}.png"), np.round(255 * frame).astype(np.uint8))
        cv2.imwrite(str(tmp_path / "png16" / f"{k:02d}.png"), np.round(65535 * frame).astype(np.uint16))
        np.savetxt(tmp_path / "csv" / f"{k:02d}.csv", frame, delimiter=",")
    return {
        "array": tmp_path / "all.npy",
        "archive": tmp_path / "all.npz",
        "folder": tmp_path / "png",
        "16 bits": tmp_path / "png16",
        "tables": tmp_path / "csv",
        "pattern": tmp_path / "png" / "*.png",
    }


@pytest.mark.parametrize("form", ["array", "archive", "folder", "16 bits", "tables", "pattern"])
def test_every_form_gives_the_same_frames(form: str, written: dict[str, Path], sequence: Array) -> None:
    read = read_sequence(written[form], ROWS, COLUMNS)
    assert read.rate_hz == 25.0
    torch.testing.assert_close(read.frames, torch.from_numpy(sequence).flatten(1).float(), rtol=0, atol=1e-7)  # float32


def test_both_lamps_show_the_frame_of_the_time(written: dict[str, Path], sequence: Array) -> None:
    """At 10 steps and 5 frames a second each frame stays for two steps; then it starts over, or the last one stays."""
    raw = {"file": str(written["folder"]), "rate_hz": 5.0}
    again, held = (simulation_of(scenario([raw | {"repeat": repeat}])) for repeat in (True, False))
    for step in range(10):
        frame = torch.from_numpy(sequence[step // 2 % FRAMES]).flatten().float()
        for u in again.at(step).lights:
            torch.testing.assert_close(u, frame, rtol=0, atol=1e-7)
    for u in held.at(9).lights:
        torch.testing.assert_close(u, torch.from_numpy(sequence[-1]).flatten().float(), rtol=0, atol=1e-7)


def test_functions_draw_over_them_and_limits_hold(written: dict[str, Path]) -> None:
    raw = [{"file": str(written["folder"])}]
    bare, masked, limited = (
        simulation_of(scenario(raw, objects=[VAN], **changes)).at(0)
        for changes in ({}, {"functions": {"guard": MASK}}, {"lighting": {"power_limit": 0.1}})
    )
    assert bare.objects["van"].lx_max > 0.5 and masked.dark_lx_max == 0.0
    for u, with_mask, dimmed in zip(bare.lights, masked.lights, limited.lights, strict=True):
        assert ((with_mask == u) | (with_mask == 0)).all() and 0 < (with_mask != u).sum() < 42
        torch.testing.assert_close(dimmed / dimmed.max(), u / u.max(), rtol=1e-5, atol=0)
    assert all(power.share == pytest.approx(0.1) for power in limited.powers.values())


WRONG: dict[str, tuple[list[dict[str, Any]], list[str]]] = {
    "missing": ([{"file": "./no.npy"}], ["lighting.raw[0].file", "no.npy", "No such file", "check the path"]),
    "empty folder": ([{"file": "empty/"}], ["lighting.raw[0].file", "empty", "no utilisations", ".png"]),
    "other size": ([{"file": "curtain"}], ["lighting.raw[0].file", "'left matrix'", "64 x 256", "3 x 28", "bring them to this size"]),
    "above one": ([{"file": "much.npy"}], ["lighting.raw[0].file", "much.npy", "between 0 and 1", "2", "divide"]),
    "unknown module": ([{"file": "good.npy", "modules": ["hires"]}], ["lighting.raw[0].modules", "'hires'", "matrix"]),
    "two for one": (
        [{"file": "good.npy"}, {"file": "good.npy", "modules": ["left"]}],
        ["lighting.raw[0]", "lighting.raw[1]", "'left matrix'"],
    ),
}


@pytest.mark.parametrize(("raw", "words"), WRONG.values(), ids=WRONG.keys())
def test_what_does_not_fit_is_named_in_a_sentence(raw: list[dict[str, Any]], words: list[str], tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("0")
    np.save(tmp_path / "much.npy", np.full((ROWS, COLUMNS), 2.0))
    np.save(tmp_path / "good.npy", np.ones((ROWS, COLUMNS)))
    np.savez(tmp_path / "two.npz", np.ones(84), np.ones(84))
    given = [each | ({"file": str(tmp_path / each["file"])} if set("/.") & set(each["file"]) else {}) for each in raw]
    with sentence(*words):
        simulation_of(scenario(given))
