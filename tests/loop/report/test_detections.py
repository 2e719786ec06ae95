"""What an ONNX network finds in pictures, by the command line."""

import cv2
import numpy as np

from tests.perception.detection.exports import FAMILIES, frame


def test_pictures_get_their_boxes(lux, tmp_path):
    params = FAMILIES["YOLOv8"].write(tmp_path / "network.onnx")
    grey = (255 * frame()[0] ** (1 / 2.2)).round().byte().numpy()
    cv2.imwrite(str(tmp_path / "road.png"), grey)
    code, told, _ = lux(
        "detect", params.file, str(tmp_path / "road.png"), "--out", str(tmp_path / "out"), "--set", "detector.threshold=0.5"
    )
    assert code == 0 and "layout yolov8" in told and "pedestrian 0.90" in told
    drawn = cv2.imread(str(tmp_path / "out" / "road-found.png"))
    changed = np.argwhere((drawn != grey[..., None]).any(2))
    assert drawn.shape == (48, 96, 3) and changed.min(0)[1] >= 18  # px; the box begins at 20

    code, told, _ = lux(
        "detect", params.file, str(tmp_path / "road.png"), "--out", str(tmp_path / "out"), "--set", "detector.threshold=0.95"
    )
    assert code == 0 and "nothing in" in told and "detector.mean" in told


def test_what_cannot_be_read_leaves_nothing_behind(lux, tmp_path):
    params = FAMILIES["YOLOv8"].write(tmp_path / "network.onnx")
    (tmp_path / "road.png").write_bytes(b"no picture")
    for picture, words in (("road.png", "road.png: is damaged or no picture"), ("none.png", "none.png: cannot be read")):
        code, _, error = lux("detect", params.file, str(tmp_path / picture), "--out", str(tmp_path / "out"))
        assert code == 2 and words in error and not (tmp_path / "out").exists()
    for more, words in (
        ((str(tmp_path / "a" / "road.jpg"),), "of equal names"),
        (("--set", "detector.kind=hog"), "leave detector.kind out"),
    ):
        code, _, error = lux("detect", params.file, str(tmp_path / "road.png"), *more, "--out", str(tmp_path / "out"))
        assert code == 2 and words in error and not (tmp_path / "out").exists()
