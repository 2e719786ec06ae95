"""`luxloop dataset`: scenes from seeds, each whole or not there, and labels of all of them in one place."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from pycocotools.coco import COCO

from luxloop import LuxloopError
from luxloop.loop.studies.training.dataset import JOBS, make, read
from tests.loop.conftest import assert_refused

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation")  # of pycocotools

FILE = """
labels = "coco"
masks = true
steps = 2
rate_hz = 1.0
seed = 5
vary = ["light.ambient_lx=0.01:0.3:log", "camera.pitch_deg=1:2", "camera.latency_steps=0:1"]
[set]
renderer = "raycast"
road = { kind = "flat" }
surface = { patches = 0, grain = 0.0 }
camera = { width_px = 160, height_px = 80, oversampling = 1, bits = 8 }
headlight.model = "ssl-hd-lores"
headlight.lamps = ["left"]
traffic = { pedestrians = 1, cyclists = 0, cars = 1, parked = 0, animals = 0, signs = 0, clutter = 1 }
[variants.low]
lighting.base.beam = "low"
[variants.high]
lighting.base.beam = "high"
"""


ONE_SCENE = ["dataset", "night.toml", "--scenes", "1", "--jobs", "1", "--out", "set"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "night.toml").write_text(FILE)
    return tmp_path / "night.toml"


def test_scenes_are_made_once_and_joined(lux, file, tmp_path):
    arguments = ["dataset", "night.toml", "--jobs", "1", "--out", "set"]
    code, out, _ = lux(*arguments, "--scenes", "2")
    assert code == 0 and out.startswith("set/coco.json written: 2 scenes, ")
    scenes = tmp_path / "set" / "scenes"
    first = {path: path.stat().st_mtime_ns for path in scenes.rglob("*.png")}
    journal = tmp_path / "set" / JOBS
    done, killed = journal.read_text().splitlines(keepends=True)
    journal.write_text(done + killed[: len(killed) // 2])
    half = scenes / ".000006.4711.part"
    shutil.copytree(scenes / "000006", half)
    shutil.rmtree(scenes / "000006")
    code, out, _ = lux(*arguments, "--scenes", "3")
    assert code == 0 and "3 scenes" in out and not half.exists()
    assert sorted(path.name for path in scenes.iterdir()) == ["000005", "000006", "000007"]
    assert all(path.stat().st_mtime_ns == then for path, then in first.items() if "000005" in path.parts)

    coco = COCO(str(tmp_path / "set" / "coco.json"))
    said = coco.dataset["scenes"]
    assert [each["folder"] for each in said] == ["scenes/000005", "scenes/000006", "scenes/000007"]
    assert len(coco.imgs) == sum(2 - each["drawn"]["camera.latency_steps"] for each in said), "the last frame of a late camera never comes"
    for image in coco.loadImgs(coco.getImgIds()):
        names = said[image["scene"]]["instances"]
        assert cv2.imread(str(tmp_path / "set" / image["file_name"]), -1).dtype == np.uint8
        instances = cv2.imread(str(tmp_path / "set" / image["instances"]), -1)
        for each in coco.loadAnns(coco.getAnnIds(image["id"])):
            assert names[each["instance"]] == each["name"]
            assert np.array_equal(coco.annToMask(each).astype(bool), instances == each["instance"])
    assert len(coco.anns) == len(coco.dataset["annotations"]) > 2, "no number twice"


@pytest.mark.parametrize("layout", ["kitti", "yolo"])
def test_images_of_all_scenes_are_numbered_where_programs_read_them(layout, lux, file, tmp_path):
    """Of three scenes two are for training and one is for validation."""
    text = FILE.replace('"coco"', f'"{layout}"\nsplit = {{ val = 0.4 }}').replace(', "camera.latency_steps=0:1"', "")
    file.write_text(text.replace("steps = 2", "steps = 1"))
    code, out, _ = lux("dataset", "night.toml", "--scenes", "3", "--jobs", "1", "--out", "set")
    document = json.loads((tmp_path / "set" / "images.json").read_text())
    of = [document["scenes"][image["scene"]]["split"] for image in document["images"]]
    assert code == 0 and "3 frames" in out and sorted(of) == ["train", "train", "val"]
    folder = tmp_path / "set" / layout
    if layout == "kitti":
        texts = [folder / "training" / "label_2" / f"{k:06d}.txt" for k in range(3)]
        for part in ("train", "val"):
            listed = (folder / "ImageSets" / f"{part}.txt").read_text().split()
            assert listed == [f"{k:06d}" for k in range(3) if of[k] == part]
        assert sorted(path.name for path in (folder / "training" / "calib").iterdir()) == [f"{k:06d}.txt" for k in range(3)]
        images = [each.parents[1] / "image_2" / f"{each.stem}.png" for each in texts]
    else:
        texts = [folder / "labels" / of[k] / f"{k:06d}.txt" for k in range(3)]
        assert (folder / "data.yaml").read_text().startswith("train: images/train\nval: images/val\nnames:\n  0: car\n")
        images = [each.parents[2] / "images" / of[k] / f"{each.stem}.png" for k, each in enumerate(texts)]
    for image, joined, text in zip(document["images"], images, texts, strict=True):
        assert joined.read_bytes() == (tmp_path / "set" / image["file_name"]).read_bytes()
        assert text.is_file()
    assert any(text.read_text() for text in texts)


def test_parts_of_a_data_set_are_whole_scenes(lux, file, tmp_path):
    file.write_text(FILE.replace("steps = 2", "steps = 1\nvideo = true\nsplit = { val = 0.25, test = 0.25 }\nlicence = { name = 'CC0' }"))
    many = read(file, 400).scenes
    share = {part: np.mean([each.split == part for each in many]) for part in ("train", "val", "test")}
    assert all(abs(share[part] - expected) < 0.09 for part, expected in (("train", 0.5), ("val", 0.25), ("test", 0.25))), (
        "4 standard errors"
    )
    assert [each.split for each in read(file, 5).scenes] == [each.split for each in many[:5]], "whatever their number"
    assert lux("dataset", "night.toml", "--scenes", "4", "--jobs", "1", "--out", "set")[0] == 0
    for part in ("train", "val", "test"):
        document = json.loads((tmp_path / "set" / f"coco_{part}.json").read_text())
        assert [each["seed"] for each in document["scenes"]] == [each.seed for each in many[:4] if each.split == part]
        assert document["licenses"][0]["name"] == "CC0" and "luxloop" in document["info"]["version"]
    assert all((tmp_path / "set" / "scenes" / each.name / "video.mp4").is_file() for each in many[:4])
    assert lux(*ONE_SCENE[:3], "1", "--jobs", "1", "--out", "set")[0] == 0
    file.write_text(FILE.replace("steps = 2", "steps = 1"))
    assert lux(*ONE_SCENE)[0] == 0 and [path.name for path in (tmp_path / "set").glob("*.json")] == ["coco.json"]


def test_scenes_follow_from_seeds_and_vary_as_told(file):
    scenes = read(file, 24).scenes
    assert {each.variant for each in scenes} == {"low", "high"}
    assert [each.seed for each in scenes] == [*range(5, 29)]
    for each in scenes:
        assert each.scenario.lighting.base.beam == each.variant
        assert 0.01 <= each.scenario.light.ambient_lx == each.drawn["light.ambient_lx"] <= 0.3
    assert np.median([each.scenario.light.ambient_lx for each in scenes]) < 0.12, "even in the logarithm"
    assert {each.scenario.camera.latency_steps for each in scenes} == {0, 1}
    assert len({each.scenario.traffic.seed for each in scenes if each.scenario.traffic}) == 24
    assert read(file, 3).scenes[2].scenario == scenes[2].scenario, "whatever their number"


def test_a_scene_that_fails_leaves_nothing(file, tmp_path):
    (scene,) = read(file, 1).scenes
    broken = scene.scenario.model_dump(mode="json") | {"plant": {"kind": "recording", "folder": str(tmp_path)}}
    with pytest.raises(LuxloopError):
        make(broken, {}, {"layout": "coco"}, False, str(tmp_path / "000005"), "")
    assert [path.name for path in tmp_path.iterdir()] == ["night.toml"]


WRONG = {  # by what is said, in parts
    "night.toml: vary camera.pich_deg=1:2": ('"camera.pitch_deg=1:2"', '"camera.pich_deg=1:2"'),
    "night.toml: vary | camera.pitch_deg=1:2": ("camera.pitch_deg=1:2", "camera.pitch_deg=2:1"),
    "night.toml: variants.high | beam": ('"high"', '"hihg"'),
    "night.toml: set: scene 5: ": ('model = "ssl-hd-lores"', 'model = "no-such"'),
    "night.toml: mask: unknown key | masks": ("masks", "mask"),
    "night.toml: labels: | split = { val": ('"coco"', '"yolo"'),
    "night.toml: split: | no scene for training": ("steps = 2", "steps = 2\nsplit = { val = 0.5, test = 0.5 }"),
}


@pytest.mark.parametrize("words", WRONG)
def test_a_wrong_file_is_said_in_a_sentence(words, lux, file):
    text = FILE if "scene 5" not in words else FILE.replace("[variants", "[set.x")
    file.write_text(text.replace(*WRONG[words]))
    assert_refused(lux("dataset", "night.toml", "--scenes", "2", "--out", "set"), *words.split(" | "))
    assert_refused(lux("dataset", "night.toml", "--scenes", "0", "--out", "set"), "for --scenes; must be >= 1")
    assert not (file.parent / "set").exists()


def test_what_is_there_is_what_the_file_says_now(lux, file, tmp_path):
    folder = tmp_path / "set" / "scenes" / "000005"
    assert lux(*ONE_SCENE)[0] == 0
    (tmp_path / "set").rename(tmp_path / "moved")
    code, _, error = lux(*ONE_SCENE[:-1], str(tmp_path / "moved"))
    assert code == 0 and "1 of 1 already done" in error, "wherever the folder is"
    (tmp_path / "moved").rename(tmp_path / "set")
    for masks in ("false", "true"):
        file.write_text(FILE.replace("masks = true", f"masks = {masks}"))
        assert lux(*ONE_SCENE)[0] == 0
        assert any((folder / "labels").glob("instances_*")) == (masks == "true"), "also where the file is as it was before"
    shutil.rmtree(folder)
    assert lux(*ONE_SCENE)[0] == 0 and folder.exists()


def test_joined_labels_of_scenes_that_are_replaced_do_not_outlive_them(lux, file, tmp_path):
    assert lux(*ONE_SCENE)[0] == 0
    file.write_text(FILE.replace('"coco"', '"kitti"'))
    assert lux(*ONE_SCENE)[0] == 0
    assert sorted(path.name for path in (tmp_path / "set").iterdir()) == ["images.json", "kitti", "scenes", "scenes.jsonl"]


def test_files_of_others_stay(lux, file, tmp_path):
    mine = tmp_path / "set" / "training" / "image_2" / "000000.png"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    assert_refused(lux(*ONE_SCENE), "set: holds files that are no data set of luxloop")
    assert mine.read_text() == "mine" and [path.name for path in (tmp_path / "set").iterdir()] == ["training"]
