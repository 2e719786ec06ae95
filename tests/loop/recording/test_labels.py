"""Labels beside frames: read by the programs that they are made for, and true to the pixel."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pycocotools.coco import COCO

from luxloop import Scenario, Utilisation, prepare, run, validate
from luxloop.loop.recording.frames import FrameRecorder
from luxloop.loop.recording.labels import LabelRecorder, Labels
from luxloop.loop.simulation.result import StepResult
from tests.loop.conftest import assert_refused
from tests.refusal import refusal

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation")  # of pycocotools

STREET: dict[str, Any] = tomllib.loads("""
name = "street"
steps = 4
rate_hz = 10
renderer = "raycast"
camera = { width_px = 320, height_px = 160, hfov_deg = 40.0, oversampling = 1, bits = 8, gamma = 2.2 }
surface.grain = 0.0
headlight.model = "ssl-hd-lores"
lighting.base.beam = "low"
vehicle.course = [{ speed_m_s = 8.0 }]
[[objects]]
kind = "car"
name = "parked"
track = [{ position_m = [25.0, 2.0, 0.0] }]
[[objects]]
kind = "pedestrian"
name = "walker"
track = [{ position_m = [12.0, -1.5, 0.0], yaw_deg = 90.0 }]
[[objects]]
kind = "box"
name = "bin"
size_m = [0.4, 0.4, 0.9]
track = [{ position_m = [11.0, -1.4, 0.0] }]
""")


def street(**changes: Any) -> Scenario:
    return validate({**STREET, **changes}, "street")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[StepResult]]:
    """All labels of a drive, and its steps."""
    folder, results = tmp_path_factory.mktemp("drive"), list[StepResult]()
    kept = {"labels": "coco", "masks": True, "depth": True, "lux": True}
    run(street(), folder, video=False, report=False, on_step=results.append, **kept)  # type: ignore[arg-type]
    return folder, results


def test_pycocotools_reads_boxes_classes_and_masks(drive):
    folder, _ = drive
    coco = COCO(str(folder / "labels" / "coco.json"))
    assert [coco.cats[k]["name"] for k in coco.getCatIds()][:2] == ["car", "truck"]
    assert len(coco.imgs) == 4
    for image in coco.loadImgs(coco.getImgIds()):
        frame, instances, parts = (cv2.imread(str(folder / image[key]), -1) for key in ("file_name", "instances", "parts"))
        assert frame.shape == instances.shape == (image["height"], image["width"]) == (160, 320)
        assert (frame.dtype, instances.dtype, parts.dtype) == (np.uint8, np.uint16, np.uint16)
        found = {each["name"]: each for each in coco.loadAnns(coco.getAnnIds(image["id"]))}
        assert {name: coco.cats[each["category_id"]]["name"] for name, each in found.items()} == {"parked": "car", "walker": "pedestrian"}
        for name, each in found.items():
            mask = coco.annToMask(each).astype(bool)
            assert coco.dataset["instances"][each["instance"]] == name and np.array_equal(mask, instances == each["instance"])
            rows, columns = np.nonzero(mask)
            x, y, width, height = each["bbox"]
            assert (x, y, x + width, y + height) == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
            assert each["area"] == mask.sum() and not each["iscrowd"]
        assert found["parked"]["visible"] == 1.0 and found["walker"]["visible"] < 0.95, "the bin stands before the walker's legs"
        of_walker = {coco.dataset["parts"][k] for k in np.unique(parts[instances == found["walker"]["instance"]])}
        assert "head" in of_walker and not parts[instances <= 1].any()


def test_depth_and_light_are_those_of_the_scene(drive):
    folder, results = drive
    document = json.loads((folder / "labels" / "coco.json").read_text())
    camera = document["camera"]
    for image, result in zip(document["images"], results, strict=True):
        depth, lux = (np.load(folder / image[key])[key] for key in ("depth", "lux"))
        assert depth.dtype == lux.dtype == np.float32
        assert np.array_equal(lux, np.asarray(result.illuminance)) and lux.max() > 1
        u = (np.arange(camera["width"]) + 0.5 - camera["cx"]) / camera["fx"]
        v = (np.arange(camera["height"]) + 0.5 - camera["cy"]) / camera["fy"]
        rays = np.stack([*np.meshgrid(u, v), np.ones_like(depth), 1 / np.where(depth > 0, depth, 1)], -1)
        T = np.array(image["T_world_camera"]).reshape(4, 4)
        points = (rays * depth[..., None]) @ T.T
        instances = cv2.imread(str(folder / image["instances"]), -1)
        assert np.abs(points[..., 2][instances == 1]).max() < 1e-3, (
            "the road is flat; single precision of positions 100 m away, and of depths"
        )
        assert (depth[instances == 0] == 0).all()
        assert image["ego"]["speed_m_s"] == pytest.approx(8) and image["time_s"] == result.time_s
        assert image["ego"]["T_world_body"][3] == pytest.approx(8 * result.time_s, abs=0.01)
        assert (folder / image["light"]).is_file()


def test_light_on_an_object_and_its_contrast(drive):
    folder, _ = drive
    document = json.loads((folder / "labels" / "coco.json").read_text())
    for each in document["annotations"]:
        image = next(image for image in document["images"] if image["id"] == each["image_id"])
        own = cv2.imread(str(folder / image["instances"]), -1) == each["instance"]
        assert each["lux"] == pytest.approx(np.load(folder / image["lux"])["lux"][own].mean(), rel=1e-5)
        light, background = each["luminance_cd_m2"], each["background_cd_m2"]
        assert each["contrast"] == (pytest.approx(light / background - 1) if background else None)
        assert light > (10 if each["name"] == "parked" else 0) * background, "a number plate sends light back"


def test_small_and_hidden_objects_are_ignored_in_each_layout(drive, tmp_path):
    first = {each["name"]: each for each in json.loads((drive[0] / "labels" / "coco.json").read_text())["annotations"][:2]}
    between = (first["walker"]["visible"] + first["parked"]["visible"]) / 2
    for layout in ("coco", "kitti", "yolo"):
        run(street(steps=1), tmp_path / layout, video=False, report=False, labels=Labels(layout, ignore_visible=between))
    kept = {each["name"]: each["iscrowd"] for each in json.loads((tmp_path / "coco" / "labels" / "coco.json").read_text())["annotations"]}
    assert kept == {"walker": 1, "parked": 0}
    kitti, yolo = (next((tmp_path / each).glob("*.txt")).read_text() for each in ("kitti/labels/label_2", "yolo/labels/labels"))
    assert sorted(line.split()[0] for line in kitti.splitlines()) == ["Car", "DontCare"]
    label, u, v, width, height = map(float, yolo.split())
    assert label == 0 and len(list((tmp_path / "yolo" / "labels" / "images").iterdir())) == 1
    box = [320 * (u - width / 2), 160 * (v - height / 2), 320 * width, 160 * height]
    assert box == pytest.approx(first["parked"]["bbox"], abs=1e-3), "six digits of 320 px"


def test_light_is_that_which_the_frame_shows(tmp_path):
    simulation = prepare(street(steps=1), "cpu")
    (result,) = simulation.evaluations()
    reception = result.reception
    (exposure,), (before, after), (frame,) = reception.exposures, reception.arrivals, reception.frames
    dark = tuple(Utilisation(0 * each.u) for each in exposure.lights)
    other = replace(frame, shown=replace(exposure, lights=dark))
    frames = FrameRecorder(tmp_path, bits=8)
    labels = LabelRecorder(tmp_path, simulation.world, Labels("coco", lux=True), frames)
    for each in (frames, labels):
        each.begin()
        each.add(replace(reception, frames=(other,), arrivals=(before, replace(after, frames=(other,)))))
        each.write()
    (image,) = json.loads((tmp_path / "labels" / "coco.json").read_text())["images"]
    assert not np.load(tmp_path / image["lux"])["lux"].any() and not np.load(tmp_path / image["light"])["u_0"].any()


def test_kitti_boxes_lie_where_the_calibration_puts_the_objects(tmp_path):
    run(street(), tmp_path, video=False, report=False, labels="kitti")
    for number in range(4):
        picture = tmp_path / "labels" / "image_2" / f"{number:06d}.png"
        assert cv2.imread(str(picture)).shape == (160, 320, 3)
        assert picture.samefile(tmp_path / "frames" / f"frame_{number:08d}.png"), "it takes no room"
        text = (tmp_path / "labels" / "calib" / f"{number:06d}.txt").read_text()
        calibration = {line.split(":")[0]: np.array(line.split(":")[1].split(), float) for line in text.splitlines()}
        P2, to_camera = (calibration[name].reshape(3, 4) for name in ("P2", "Tr_velo_to_cam"))
        assert to_camera @ [-1.6, 0, 1.35, 1] == pytest.approx([0, 0, 0], abs=1e-9), "where the camera is on the body"
        assert (to_camera @ [10, 0, 1.35, 1])[2] == pytest.approx(11.6 * np.cos(np.radians(3.0)))
        lines = (tmp_path / "labels" / "label_2" / f"{number:06d}.txt").read_text().splitlines()
        assert [line.split()[0] for line in lines] == ["Car", "Pedestrian"]
        for line in lines:
            truncated, _, _, left, top, right, bottom, height, _, _, x, y, z, _ = map(float, line.split()[1:])
            (u, v, w), (_, upper, depth) = P2 @ [x, y, z, 1], P2 @ [x, y - height, z, 1]
            assert left <= u / w <= right and truncated == 0
            assert bottom == pytest.approx(v / w, abs=2) or "Pedestrian" in line, "its feet are behind the bin"
            assert top == pytest.approx(upper / depth, abs=3)
        assert float(lines[0].split()[-1]) == pytest.approx(-np.pi / 2, abs=0.01), "it faces as the camera does"


def test_what_cannot_be_labelled_is_said_in_a_sentence(lux, tmp_path):
    with refusal("labels = 'cocco': is no layout; choose from 'coco', 'kitti', 'yolo'"):
        run(street(), tmp_path / "drive", labels="cocco")  # type: ignore[arg-type]
    assert_refused(lux("run", "small.toml", "--depth"), "--depth: is written beside labels")
    bare = ("--no-report", "--no-video")
    assert lux("run", "small.toml", "--steps", "2", "--frames", "--out", "drive", *bare)[0] == 0
    done = lux("run", "small.toml", "--plant", "drive", "--labels", "coco", "--out", "shadow", *bare)
    assert_refused(done, "--labels coco: the plant 'recording' does not know what is true")
    assert not (tmp_path / "shadow").exists()
