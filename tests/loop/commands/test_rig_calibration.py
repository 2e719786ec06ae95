"""From the command line: a board, a calibration from nothing but a distance, a lamp file that a scenario takes, values fitted to frames."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from luxloop import Lamp, Module, idealised
from luxloop.loop.rig.calibration.calibrate import load
from luxloop.loop.rig.calibration.intrinsics import BoardParams, Corners, _board, corners
from luxloop.loop.rig.simulated.board import BoardView
from luxloop.loop.rig.simulated.faults import BoardFaultParams, FaultParams
from luxloop.loop.rig.simulated.scene import RigScene
from luxloop.loop.scenario.model import load as load_scenario
from luxloop.world.lamps import archive
from tests.loop.conftest import Lux, assert_refused

WALL = """
name = "wall"
steps = 2
renderer = "raycast"
[headlight]
model = "nominal.npz"
lamps = ["left"]
distance_m = 0.0
[surface]
grain = 0.0
[camera]
x_m = -0.3
y_m = 0.25
z_m = 1.0
pitch_deg = 3.0
yaw_deg = -1.0
width_px = 160
height_px = 120
hfov_deg = 12.0
exposure_s = 0.004
sensitivity_e_per_cd_s_m2 = 5e3
saturation_e = 10_000.0
[[objects]]
kind = "box"
name = "screen"
albedo = 0.8
size_m = [0.1, 6.0, 4.0]
track = [{ position_m = [6.0, 0.0, -1.0] }]
"""


@pytest.fixture
def wall(lux: Lux) -> Lux:
    light = idealised(12, 24, (4, 2), 3.5, 1.8, -1.8)
    archive.save(Path("nominal.npz"), Lamp("nominal", (Module("matrix", light),)))
    Path("wall.toml").write_text(WALL)
    return lux


def test_rig_is_calibrated_and_its_lamp_digitised(wall):
    code, out, err = wall("rig", "calibrate", "wall.toml", "--screen-m", "5.95", "--set", "camera.yaw_deg=-1.3")
    assert (code, err) == (0, "")
    assert "camera.hfov_deg=12" in out and "located, left matrix" in out
    assert load(Path("rig.npz")).rms["module left matrix"] < 0.1
    # E = I / d^2 of 50,000 cd, ahead of the lamp.
    code, out, err = wall("rig", "digitise", "wall.toml", "--calibration", "rig.npz", "--lux", "1412@82,53")
    assert (code, err) == (0, "")
    light = archive.load(Path("digitised.npz")).module("matrix").headlight
    texture = light.light_texture(torch.ones(light.n_pixels))
    assert float(texture[20:28, 20:28].mean()) == pytest.approx(50_000, rel=0.05)
    told = json.loads(Path("digitised.json").read_text())["left matrix"]
    assert told["dead_count"] == told["stuck_count"] == 0 and told["checked"]["full"] < 0.1
    with np.load("digitised_pixels.npz") as pixels:
        assert pixels["0_intensity"].shape == (12, 24)
    assert Path("digitised.png").read_bytes().startswith(b"\x89PNG")
    assert wall("check", "wall.toml", "--set", "headlight.model=digitised.npz")[0] == 0
    before = {file: file.read_bytes() for file in [*Path("digitised_frames").iterdir(), Path("digitised_pixels.npz")]}
    for file in [*before][::2]:
        file.unlink()
    assert wall("rig", "digitise", "wall.toml", "--calibration", "rig.npz", "--lux", "1412@82,53")[0] == 0
    assert all(file.read_bytes() == data for file, data in before.items())  # as it was without an interruption


def test_a_board_on_the_screen_tells_how_far_it_is(wall):
    keys = ["camera.width_px=320", "camera.height_px=240"]
    rig_scene = RigScene(load_scenario("wall.toml", keys), FaultParams())
    laid = BoardView.of(BoardFaultParams(columns=5, rows=7, square_mm=120), rig_scene).image(None)
    cv2.imwrite("screen.png", (laid / laid.max() * 60_000).astype(np.uint16))
    code, out, err = wall(
        "rig", "calibrate", "wall.toml", "--on-screen", "screen.png", "--columns", "5", "--rows", "7", "--square-mm", "120", "--set", *keys
    )
    assert (code, err) == (0, "")
    found = dict(re.findall(r"camera\.(\w+)=(\S+)", out))
    # The board's corners are found to 0.1 px of its height of 210 px, so its tilt to half a degree: 5 cm at 6 m. Two standard deviations.
    true = {"x_m": -0.3, "y_m": 0.25, "z_m": 1.0}
    assert {name: float(found[name]) for name in true} == pytest.approx(true, abs=0.1)
    assert float(found["pitch_deg"]) == pytest.approx(3.0, abs=1.0) and float(found["yaw_deg"]) == pytest.approx(-1.0, abs=1.0)


BOARD = (BoardParams(), BoardParams(columns=8, rows=10))
SQUARE_PX = 40


def page(board: BoardParams = BOARD[0], legacy: bool = False, rows: int | None = None) -> np.ndarray:
    """A board on white paper in 640 x 480 px. rows: of squares that are not covered."""
    charuco = _board(board)
    charuco.setLegacyPattern(legacy)
    drawn = charuco.generateImage((SQUARE_PX * board.columns, SQUARE_PX * board.rows))
    found = np.full((480, 640), 255, np.uint8)
    found[20 : 20 + len(drawn), 20 : 20 + drawn.shape[1]] = drawn
    if rows is not None:
        found[20 + SQUARE_PX * rows :] = 255
    return found


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.zeros((480, 640), np.uint8), "contrast"),
        (np.indices((480, 640))[1].astype(np.uint8), "no marker"),
        (page(BoardParams(columns=6, rows=9)), "--columns"),
        (page(rows=2), "one line"),
    ],
)
def test_a_picture_that_cannot_be_used_is_named_with_the_reason(wall, picture, words):
    cv2.imwrite("screen.png", picture)
    assert_refused(wall("rig", "calibrate", "wall.toml", "--on-screen", "screen.png"), "screen.png: ", words)
    assert not list(Path().glob("rig*"))


def test_boards_of_low_contrast_and_of_old_opencv_are_read():
    dim, old = corners((100 + page() / 20).astype(np.uint8), BOARD[0]), corners(page(BOARD[1], legacy=True), BOARD[1])
    assert isinstance(dim, Corners) and len(dim.board) == 70
    assert isinstance(old, Corners) and len(old.board) == 63


def test_frontal_boards_determine_no_lens(wall):
    Path("boards").mkdir()
    for k in range(6):
        cv2.imwrite(f"boards/{k}.png", np.roll(page(), (5 * k, 50 * k), (0, 1)))
    cv2.imwrite("boards/line.png", page(rows=2))
    done = wall("rig", "calibrate", "wall.toml", "--screen-m", "5.95", "--boards", "boards")
    assert "left out: boards/line.png" in done[1]
    assert_refused(done, "the 6 views do not determine the lens (", "left, right, top, bottom of the board tilted")
    assert not list(Path().glob("rig*"))


def test_values_are_fitted_to_a_recording(wall):
    fewer = ["--set", "camera.oversampling=1", "headlight.model=hd84", "camera.hfov_deg=40", "camera.exposure_s=0.02"]
    code, *_ = wall("run", "wall.toml", "--frames", "--no-video", "--no-report", "--out", "taken", *fewer, "objects[0].albedo=0.7")
    assert code == 0
    code, out, err = wall("rig", "fit", "wall.toml", "taken", "--vary", "objects[0].albedo=0.1", *fewer)
    assert (code, err) == (0, "")
    found = float(out.split("--set objects[0].albedo=")[1].split()[0])
    assert found == pytest.approx(0.7, rel=0.02)


def test_board_is_written(lux):
    assert lux("rig", "board")[0] == 0
    assert Path("board.pdf").stat().st_size > 1000


CALIBRATED = "digitise wall.toml --calibration rig.npz"
FIT = "fit wall.toml nowhere --vary camera.pitch_deg"
MISTAKES = {
    "board --columns 2": "columns",
    "board --square-mm 60": "--paper",
    "calibrate wall.toml": "--screen-m",
    "calibrate wall.toml --screen-m -3": "for --screen-m; must be > 0",
    "calibrate wall.toml --boards nowhere": "nowhere",
    "calibrate wall.toml --screen-m 5.95 --out rig.toml": "ends in .npz",
    "digitise wall.toml --calibration nowhere.npz": "nowhere.npz",
    f"{CALIBRATED} --lux much": "LUX@U,V",
    f'{CALIBRATED} --set headlight.lamps=["left","right"]': "one lamp",
    f"{CALIBRATED} --lux 820@nan,3": "finite places",
    FIT: "KEY=SPAN",
    f"{FIT}=0.1 --exposures 0": "for --exposures; must be >= 1",
    f"{FIT}=0.1": "nowhere",
}


@pytest.mark.parametrize(("line", "words"), MISTAKES.items())
def test_mistakes_are_told_in_a_sentence(wall, line, words):
    assert_refused(wall("rig", *line.split()), words)
    assert not [each for name in ("rig", "board", "digitised") for each in Path().glob(f"{name}*")]
