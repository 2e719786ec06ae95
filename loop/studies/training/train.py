"""`luxloop train-detector`: render scenes, train the network, test it on held-out scenes, and write weights and report."""

import datetime
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from scipy.optimize import minimize
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from luxloop.loop.recording.manifest import write_json
from luxloop.loop.report import terminal as tables
from luxloop.loop.studies.jobs import Executor, Job, Results, digest_of, local, run
from luxloop.loop.studies.training import scenes
from luxloop.loop.studies.training.evaluate import REFERENCE_LX, boxes_right, evaluate, expose_scene, light_on_objects
from luxloop.loop.studies.training.fit import BATCH, fit
from luxloop.loop.studies.training.report import overview, write_report
from luxloop.loop.studies.training.scenes import CLASSES, Row, read
from luxloop.perception.detection.detector import NetworkParams
from luxloop.perception.detection.network import NetworkDetector, save
from luxloop.world.errors import LuxloopError
from luxloop.world.files import output_folder, whole

JOBS, FOLDER, WEIGHTS = "scenes.jsonl", "scenes", "detector.pt"
LEAST_SCORE = 0.01  # of detections that are evaluated
SUREST = 1e-6  # least distance of a score to 1, where the logit diverges
CALIBRATING = 10  # one in so many scenes is kept for calibration
VERSION = digest_of(scenes)


def train(out: Path, number: int, held_out: int, epochs: int, seed: int, processes: int | None) -> dict[str, Any]:
    """Train on some scenes, test on others, write weights and report into a folder; returns the report.

    Raises LuxloopError for scenes that cannot be rendered, a network that has learnt nothing, or a folder that cannot be written.
    """
    executor = local(processes)
    with output_folder(out), output_folder(out / FOLDER):
        started = time.monotonic()
        seen = draw_scenes(out, scenes.TRAINING, number, executor, "scenes to train on")
        others = draw_scenes(out, scenes.HELD_OUT, held_out, executor, "scenes held out")
        drew = time.monotonic()
        try:
            detector, training = _learnt(seen, epochs, seed)
            training["minutes"] = {"drawing": round((drew - started) / 60, 1), "training": round((time.monotonic() - drew) / 60, 1)}
            found = evaluate(detector, others)
        except OSError as error:
            raise LuxloopError(f"{out}: a scene cannot be read ({error}); remove {out / JOBS}, so that all are drawn again") from error
        except KeyboardInterrupt as error:
            kept = f"all scenes are stored in {out}, the same command trains from its start"
            raise KeyboardInterrupt(kept) from error
        report = {"date": datetime.date.today().isoformat(), "training": training, "camera": scenes.CAMERA.model_dump(), **found}
        store(detector, report, out)
    return report


def store(detector: NetworkDetector, report: Mapping[str, Any], out: Path) -> None:
    """Write report and weights into a folder, the weights last, so that a report beside weights belongs to them.

    Raises LuxloopError on a write error.
    """
    (out / WEIGHTS).unlink(missing_ok=True)
    write_json(out / "report.json", report)
    write_report(report, out)
    with whole(out / WEIGHTS) as file:
        save(detector.network, detector.classes, file)


def _learnt(rows: Sequence[Row], epochs: int, seed: int) -> tuple[NetworkDetector, dict[str, Any]]:
    """Trained network as stored, and facts of its training. Too few scenes serve both training and calibration."""
    last = len(rows) // CALIBRATING
    learnt, asked = (rows[:-last], rows[-last:]) if last else (rows, rows)
    steps = -(-epochs * len(learnt) // BATCH)
    with tables.progress("training", steps) as advance:
        network = fit(learnt, steps, seed, lambda _: advance())
    detector = NetworkDetector(network, scenes.CLASSES, LEAST_SCORE, NetworkParams().overlap)
    slope, shift = calibrate(detector, asked)
    network.half().float()
    return detector, {
        **{"scenes": len(rows), "epochs": epochs, "examples": steps * BATCH * 2, "seed": seed},
        **{"calibrated_on": len(asked), "slope": round(slope, 3), "shift": round(shift, 3)},
    }


def draw_scenes(out: Path, first: int, number: int, executor: Executor, title: str) -> Sequence[Row]:
    """Rows of scenes from a first seed on, rendered unless they are in the folder. Raises LuxloopError if a scene cannot be rendered."""
    folder = str(out / FOLDER)
    seeds = sorted(range(first, first + number), key=scenes.road_seed)  # ordered by road
    jobs = [Job(f"scene {seed}", {"seed": seed, "folder": folder}) for seed in seeds]
    results: Results = run(scenes.draw, jobs, out / JOBS, version=VERSION, executor=executor, title=title)
    if results.failures:
        key, reason = next(iter(results.failures.items()))
        raise LuxloopError(f"{out}: {len(results.failures)} scenes cannot be drawn, first {key}: {reason}")
    return sorted(results.rows, key=lambda row: int(row["seed"]))


def train_detector(out: Path, number: int, held_out: int, epochs: int, seed: int, processes: int | None) -> None:
    """Train a detector and print its goals."""
    report = train(out, number, held_out, epochs, seed, processes)
    tables.show(overview(report))
    print(f"{out / WEIGHTS} and {out / 'report.md'} written")


def calibrate(detector: NetworkDetector, rows: Sequence[Row]) -> tuple[float, float]:
    """Calibrate the logits of the detector's network so that scores are shares of correct boxes; returns slope and shift.

    rows: of scenes not used in training, from `luxloop.loop.studies.training.scenes.draw`; each is exposed in full and in object-based
    light. Raises LuxloopError if the scores do not separate correct boxes from wrong ones.
    """
    boxes: list[tuple[float, bool]] = []
    for row in rows:
        scene = read(row)
        seed = int(row["seed"])
        full, alone = expose_scene(scene, REFERENCE_LX, seed, 0), expose_scene(scene, light_on_objects(scene), seed, 1)
        for found in detector.detect(torch.stack([full, alone])):
            boxes += boxes_right(found, scene.objects, range(len(CLASSES)))
    scores, right = torch.tensor(boxes, dtype=torch.float64).view(-1, 2).T
    slope, shift = logistic(scores.logit(eps=SUREST), right)
    if not right.any() or not (math.isfinite(slope) and math.isfinite(shift)) or slope <= 0:
        raise LuxloopError("the network's scores do not separate correct boxes from wrong ones; give more --scenes or --epochs")
    detector.network.calibrate(slope, shift)
    return slope, shift


def logistic(x: Tensor, right: Tensor) -> tuple[float, float]:
    """Slope and shift of the logistic curve for the probability of right (`[n]`, 0 or 1) over x `[n]`.

    Targets are slightly inside 0..1, so that the fit is finite (Platt 1999).
    """
    hits, misses = float(right.sum()), float((1 - right).sum())
    targets = torch.where(right > 0, (hits + 1) / (hits + 2), 1 / (misses + 2))

    def loss(parameters: list[float]) -> tuple[float, list[float]]:
        given = torch.tensor(parameters, dtype=torch.float64, requires_grad=True)
        value = binary_cross_entropy_with_logits(given[0] * x + given[1], targets, reduction="sum")
        value.backward()
        assert given.grad is not None
        return float(value.detach()), given.grad.tolist()

    slope, shift = minimize(loss, [1.0, 0.0], jac=True, method="BFGS").x
    return float(slope), float(shift)
