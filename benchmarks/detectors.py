"""How good the detectors that are shipped are: `python benchmarks/detectors.py` judges them and writes the shipped weights' report,
and docs/detectors.md with its figures and pictures.

Scenes are those of `luxloop train-detector --out runs/detector`, drawn if they are not there.
"""

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
import torch

from luxloop.loop.studies.jobs.executors import local
from luxloop.loop.studies.training.judge import SURE, judge
from luxloop.loop.studies.training.light import luminance
from luxloop.loop.studies.training.report import confidence_figure, page
from luxloop.loop.studies.training.scenes import CAMERA, HELD_OUT, DarkScene, read
from luxloop.loop.studies.training.train import LEAST_SCORE, drawn
from luxloop.perception.camera import expose
from luxloop.perception.detection.build import WEIGHTS, detector
from luxloop.perception.detection.detector import Detector, HogParams, NetworkParams
from luxloop.perception.noise import FrameNoise

ROOT = Path(__file__).parents[1]
REPORT = (ROOT / "perception" / "detection" / WEIGHTS).with_suffix(".json")
HEAD = (Path(__file__).parent / "detectors_page.md").read_text("utf-8")
SHOWN = 8  # of the scenes held out, counted from 0
HOG_SCENES = 15  # since it takes long
COLOURS = {"pedestrian": (80, 220, 80), "cyclist": (255, 200, 60), "car": (80, 120, 255), "animal": (230, 120, 255)}  # blue, green, red
CPU = torch.device("cpu")


def main() -> None:
    parser = argparse.ArgumentParser(description="Judge the detectors that are shipped and write docs/detectors.md.")
    parser.add_argument("--out", type=Path, default=Path("runs/detector"), help="folder with the scenes")
    parser.add_argument("--jobs", type=int, help="processes that draw scenes, by default one a core")
    given = parser.parse_args()
    stored = json.loads(REPORT.read_text("utf-8"))
    rows = drawn(given.out, HELD_OUT, stored["scenes"], local(given.jobs), "scenes held out")
    report = stored | judge(detector(NetworkParams(threshold=LEAST_SCORE), CPU), rows)
    REPORT.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", "utf-8")
    images = ROOT / "docs" / "images"
    confidence_figure(report).savefig(images / "detector-confidence.jpg")
    cv2.imwrite(str(images / "detector-boxes.jpg"), picture(read(rows[SHOWN])), [cv2.IMWRITE_JPEG_QUALITY, 80])
    hog = judge(detector(HogParams(), CPU), rows[:HOG_SCENES])
    measured = f"{page(report)}\n{CURVES}\n{SEEN}\n{hog_page(hog)}"
    (ROOT / "docs" / "detectors.md").write_text(HEAD + measured, "utf-8")
    REPORT.with_suffix(".md").write_text(f"# Detector\n\n{page(report)}", "utf-8")
    print("written: docs/detectors.md")


CURVES = """![Confidence against illuminance](images/detector-confidence.jpg)
"""
SEEN = f"""![One scene in three lights, with boxes](images/detector-boxes.jpg)

*A held-out scene with 10 lx and with 0.5 lx everywhere, and with 10 lx on its objects alone amid 0.05 lx; boxes with a score of at least
{SURE:g}.*
"""


def hog_page(found: dict) -> str:
    """What is measured of HOG, as Markdown."""
    lit, curves = found["well_lit"], found["confidence"]
    medians = ", ".join(
        f"{value:.2f} at {lx:g} lx" for lx, value in zip(curves["lx"], curves["pedestrian"]["upper"], strict=True) if lx >= 1
    )
    people, riders = (f"{lit['recall_by_class'][name]:.0%}" for name in ("pedestrian", "cyclist"))
    return f"""On {found["scenes"]} of the same scenes, at 10 lx and with a score of at least {found["sure"]:g}, HOG finds {people} of the \
pedestrians and {riders} of the cyclists, at {lit["false_a_frame"]:g} false positives a frame; a frame takes {found["ms_a_frame"]:g} ms. \
Its score for pedestrians (upper quartile): {medians}.
"""


def picture(scene: DarkScene) -> np.ndarray:
    """One scene in three lights below each other, with the network's boxes, uint8 BGR."""
    alone = torch.full(scene.shape, 0.05)
    for each in scene.objects:
        u0, v0, u1, v1 = (int(value) for value in each.box)
        alone[v0:v1, u0:u1] = 10.0
    network = detector(NetworkParams(threshold=SURE), CPU)
    return np.concatenate([with_boxes(scene, light, network) for light in (10.0, 0.5, alone)])


def with_boxes(scene: DarkScene, lx: torch.Tensor | float, finder: Detector) -> np.ndarray:
    frame = expose(luminance(scene, lx), CAMERA, FrameNoise.of(0, 0, 0)) / (2**CAMERA.bits - 1)
    (found,) = finder.detect(frame[None])
    shown = cv2.cvtColor((255 * frame.sqrt()).byte().numpy(), cv2.COLOR_GRAY2BGR)[60:300]
    for box, scores in zip(found.boxes, found.scores, strict=True):
        name = finder.classes[int(scores.argmax())]
        u0, v0, u1, v1 = (round(value) for value in box.tolist())
        cv2.rectangle(shown, (u0, v0 - 60), (u1, v1 - 60), COLOURS[name], 1)
        text = f"{name} {float(scores.max()):.2f}"
        cv2.putText(shown, text, (u0, v0 - 63), cv2.FONT_HERSHEY_SIMPLEX, 0.35, COLOURS[name], 1, cv2.LINE_AA)
    return shown


if __name__ == "__main__":
    main()
