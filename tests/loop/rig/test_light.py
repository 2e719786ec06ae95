"""Light as a device gets it: order of pixels, limits, files."""

import json

import cv2
import numpy as np
import pytest

from luxloop.loop.rig.light import Shine, limit, places
from luxloop.loop.rig.lights import FilesLight
from luxloop.loop.rig.params import FilesLightParams, LimitParams, ScanParams
from luxloop.world.headlight.lamp import ModuleCommand
from tests.refusal import refusal


def test_pixels_go_out_in_the_order_of_the_device():
    # rows of the picture: 0 1 2 / 3 4 5
    assert places(ScanParams(), 2, 3).tolist() == [0, 1, 2, 3, 4, 5]
    assert places(ScanParams(columns_first=True), 2, 3).tolist() == [0, 3, 1, 4, 2, 5]
    assert places(ScanParams(from_bottom=True, from_right=True), 2, 3).tolist() == [5, 4, 3, 2, 1, 0]
    assert places(ScanParams(serpentine=True), 2, 3).tolist() == [0, 1, 2, 5, 4, 3]


def test_power_in_watts_dims_and_module_intensity_counts():
    shine = Shine(0, (np.ones((2, 4), np.float32), np.ones((2, 4), np.float32)), (ModuleCommand(), ModuleCommand(intensity=0.5)))
    assert shine.share == 0.75
    given = limit(shine, None, 1.0, LimitParams(power_w=30.0, full_w=80.0))
    assert given.dimmed == pytest.approx(0.5) and given.shine.share == pytest.approx(0.375)


def test_a_fast_change_is_made_in_part_and_arrives():
    limits, stands = LimitParams(change_per_s=1.0), None
    shares = []
    for number in range(5):
        given = limit(Shine(number, (np.full((4, 4), 0.9, np.float32),)), stands, 0.25, limits)
        stands = given.shine.net_pictures
        shares.append(given.shine.share)
    assert shares == pytest.approx([0.25, 0.5, 0.75, 0.9, 0.9])


def test_light_goes_into_files_whole_with_commands_and_dark(tmp_path):
    light = FilesLight(FilesLightParams(kind="files", folder=tmp_path, bits=16))
    pictures = (np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4), np.ones((1, 2), np.float32))
    assert light.show(Shine(7, pictures, (ModuleCommand(swivel_deg=3.0), ModuleCommand()))) is None
    codes = cv2.imread(str(tmp_path / "light.png"), cv2.IMREAD_UNCHANGED)
    assert codes.dtype == np.uint16 and codes.shape == (4, 4) and codes[3].tolist() == [65535, 65535, 0, 0]
    about = json.loads((tmp_path / "light.json").read_text())
    assert about["number"] == 7 and about["modules"][0]["swivel_deg"] == 3.0
    light.dark()
    assert not cv2.imread(str(tmp_path / "light.png"), cv2.IMREAD_UNCHANGED).any()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["light.json", "light.png"]
    with refusal("make it"):
        FilesLight(FilesLightParams(kind="files", folder=tmp_path / "none"))
