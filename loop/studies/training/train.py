"""`luxloop train-detector`: render scenes, train the network, test it on held-out scenes, and write weights, a page of Markdown, and
confidence against illuminance as a picture.
"""

import datetime
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from rich.table import Table
from scipy.optimize import minimize
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from luxloop.loop.recording.manifest import write_json
from luxloop.loop.report import terminal as tables
from luxloop.loop.report.style import FOUR, drawing
from luxloop.loop.report.terminal import number
from luxloop.loop.studies.jobs import Executor, Job, Results, digest_of, local, run
from luxloop.loop.studies.training import scenes, widening
from luxloop.loop.studies.training.evaluate import (
    AGREE,
    ALONE_LX,
    AROUND_LX,
    FOUND_IOU,
    HEIGHT_PX,
    REFERENCE_LX,
    VISIBLE,
    boxes_right,
    evaluate,
    expose_scene,
    light_on_objects,
)
from luxloop.loop.studies.training.fit import BATCH, fit
from luxloop.loop.studies.training.scenes import CLASSES, Row, read
from luxloop.perception.detection.detector import NetworkParams
from luxloop.perception.detection.network import Network, NetworkDetector, save
from luxloop.world.errors import LuxloopError
from luxloop.world.files import atomic_write, output_folder, whole

PAGE, PICTURE = "report.md", "confidence.jpg"
Report = Mapping[str, Any]


def goals(report: Report) -> list[tuple[str, str, float | None, bool]]:
    """Goal, limit in words, value reached (None if no object counts), and whether the goal is reached."""
    found, all_ = report["well_lit"], report["confidence"]["all"]["median"]
    at = dict(zip(report["confidence"]["lx"], all_, strict=True))
    change = None if at[40.0] is None else round(abs(at[40.0] - at[20.0]), 3)
    asked: list[tuple[str, Literal["≥", "≤"], float, float | None]] = [
        (f"recall at {REFERENCE_LX:g} lx", "≥", 0.9, found["recall"]),
        (f"false positives a frame at {REFERENCE_LX:g} lx", "≤", 0.3, found["false_a_frame"]),
        ("median confidence at 0.1 lx, without other light", "≤", 0.1, at[0.1]),
        (f"median confidence at {REFERENCE_LX:g} lx", "≥", 0.5, at[REFERENCE_LX]),
        ("its change from 20 to 40 lx", "≤", 0.05, change),
        (f"objects as sure in object-based light, within {AGREE:g}", "≥", 0.8, report["alone"]["kept"]),
    ]
    return [
        (name, f"{sign} {limit:g}", value, value is not None and (value >= limit if sign == "≥" else value <= limit))
        for name, sign, limit, value in asked
    ]


def overview(report: Report) -> Table:
    """The goals for the terminal."""
    rows = ((name, limit, number(value), "yes" if reached else "[bold]no[/]") for name, limit, value, reached in goals(report))
    return tables.plain((f"{report['scenes']} scenes held out", "goal", "reached", ""), rows)


def page(report: Report) -> str:
    """The report as Markdown."""
    training, found, alone = report["training"], report["well_lit"], report["alone"]
    kept = ", ".join(f"{name} {number(value)}" for name, value in alone["kept_by_class"].items())
    by_class = ", ".join(f"{name} {number(value)}" for name, value in found["recall_by_class"].items())
    rows = ((name, limit, number(value), "yes" if reached else "no") for name, limit, value, reached in goals(report))
    others = "; ".join(f"{number(each['recall'])} at {each['false_a_frame']:g} ({each['score']:g})" for each in report["by_score"])
    right = ", ".join(f"{number(each['right'])} of {each['boxes']} ({each['from']:g} to {each['to']:g})" for each in report["right"])
    wide = training.get("wide")
    learnt = training["scenes"] - (0 if wide else training["calibrated_on"])
    asked = f"{training['calibrated_on']} more" if learnt else "the same, since so few leave none for that"
    then = f", then on {wide['scenes']} wide scenes, {wide['epochs']} epochs ({wide['examples']} examples)" if wide else ""
    minutes = ", ".join(f"{name} {number(value)} min" for name, value in training.get("minutes", {}).items())
    lx = report["confidence"]["lx"]
    curves = {"all": report["confidence"]["all"], "all, at night": report["confidence_at_night"]["all"]}
    curves |= {name: report["confidence"][name] for name in CLASSES}
    medians = ((name, *(number(each, ".2f") for each in of["median"])) for name, of in curves.items())
    return f"""Trained on {report["date"]} on {learnt or training["scenes"]} scenes, {training["epochs"]} epochs \
({training["examples"]} examples){then}, seed {training["seed"]}{f" ({minutes})" if minutes else ""}; calibrated on {asked}; \
evaluated on {report["scenes"]} other scenes with {found["objects"]} objects, none of which occurs in the training scenes.

{tables.markdown_table(("", "goal", "measured", "reached"), rows, "llrl")}

Objects count if they are at least {HEIGHT_PX} px tall and {VISIBLE:.0%} visible. An object is found by a box with a score of at least \
{report["sure"]:g} and an IoU of {FOUND_IOU:g} or more. A box on a smaller or more occluded object counts neither way. \
Precision is {found["precision"]:g}; {number(found["class_accuracy"], ".1%")} of the found objects have the right class. \
Recall by class: {by_class}. A frame takes {report["ms_a_frame"]:g} ms of processor time.

Recall at false positives a frame, for other thresholds of the score (in brackets): {others}.

Scores estimate the probability that a box is right (slope {training["slope"]:g} and shift {training["shift"]:g} of the logits). \
Share of right boxes at {REFERENCE_LX:g} lx, by score: {right}.

*x lx* means that every surface that faces the lamps gets x lx at any distance. The curves of confidence, except those *at night*, \
are for scenes without other light: no sky, street lamps and other cars' lamps, which show many objects without the headlamps. \
An object's confidence is the best score of its class among the boxes on it, or 0.

Object-based light is {ALONE_LX:g} lx on objects amid {AROUND_LX:g} lx, with dark heads and windscreens. \
Of {alone["objects"]} objects that are found in {ALONE_LX:g} lx everywhere, \
{number(alone["kept"], ".0%")} lose no more than {AGREE:g} of confidence ({kept}); \
the median change is {number(alone["median_change"], "+g")}.

{tables.markdown_table(("median confidence at lx", *(f"{each:g}" for each in lx)), medians)}
"""


def write_report(report: Report, out: Path) -> None:
    """Write page and picture into a folder: median confidence over illuminance of each class, and quartiles of all objects.

    Raises LuxloopError on a write error.
    """
    with drawing(out / PICTURE, (7.2, 3.6)) as figure:
        axes, curves = figure.subplots(), report["confidence"]
        lower, upper = (np.array(curves["all"][key], float) for key in ("lower", "upper"))
        axes.fill_between(curves["lx"], lower, upper, color="0.85", label="middle half of all")
        for name, colour in zip(CLASSES, FOUR, strict=True):
            median = np.array(curves[name]["median"], float)
            axes.plot(curves["lx"], median, color=colour, marker="o", markersize=3, label=f"{name}, median")
        axes.set(xscale="log", xlabel="illuminance of surfaces that face the lamps in lx", ylabel="confidence", ylim=(0, 1))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower right")
    atomic_write(out / PAGE, f"# Detector\n\n{page(report)}\n![Confidence against illuminance]({PICTURE})\n")


JOBS, FOLDER, WEIGHTS = "scenes.jsonl", "scenes", "detector.pt"
LEAST_SCORE = 0.01  # of detections that are evaluated
SUREST = 1e-6  # least distance of a score to 1, where the logit diverges
CALIBRATING = 10  # one in so many scenes is kept for calibration
WIDE_EPOCHS = 11
VERSION = digest_of(scenes, widening)


def train(out: Path, number: int, wide: int, held_out: int, epochs: int, seed: int, processes: int | None) -> dict[str, Any]:
    """Train on scenes of the first population, go on with wide ones, test on others, write weights and report into a folder; returns the
    report.

    Raises LuxloopError for scenes that cannot be rendered, a network that has learnt nothing, or a folder that cannot be written.
    """
    executor = local(processes)
    with output_folder(out), output_folder(out / FOLDER):
        started = time.monotonic()
        seen = draw_scenes(out, scenes.TRAINING, number, executor, "scenes to train on")
        wider = draw_scenes(out, scenes.TRAINING, wide, executor, "wide scenes to train on", wide=True)
        others = draw_scenes(out, scenes.HELD_OUT, held_out, executor, "scenes held out")
        drew = time.monotonic()
        try:
            detector, training = _learnt(seen, wider, epochs, seed)
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


def _learnt(seen: Sequence[Row], wider: Sequence[Row], epochs: int, seed: int) -> tuple[NetworkDetector, dict[str, Any]]:
    """Trained network as stored, and facts of its training; calibrated on the last scenes of both kinds.

    The mean of the weights before and after the wide scenes keeps what both know (Wortsman et al., "Robust fine-tuning of zero-shot
    models", 2022).
    """
    (learnt, asked), (also, wide_asked) = _split(seen), _split(wider)
    steps, more = -(-epochs * len(learnt) // BATCH), -(-WIDE_EPOCHS * len(also) // BATCH)
    with tables.progress("training", steps + more) as advance:
        network = fit(learnt, steps, seed, lambda _: advance())
        if also:
            network = mean_of(network, fit(also, more, seed, lambda _: advance(), network))
            asked = (*asked, *wide_asked)
    detector = NetworkDetector(network, scenes.CLASSES, LEAST_SCORE, NetworkParams().overlap)
    slope, shift = calibrate(detector, asked)
    network.half().float()
    return detector, {
        **{"scenes": len(learnt) if also else len(seen), "epochs": epochs, "examples": steps * BATCH * 2, "seed": seed},
        **({"wide": {"scenes": len(also), "epochs": WIDE_EPOCHS, "examples": more * BATCH * 2}} if also else {}),
        **{"calibrated_on": len(asked), "slope": round(slope, 3), "shift": round(shift, 3)},
    }


def mean_of(one: Network, other: Network) -> Network:
    """A network with the mean weights of two."""
    weights = other.state_dict()
    network = Network(len(scenes.CLASSES))
    network.load_state_dict({k: (each + weights[k]) / 2 if each.is_floating_point() else each for k, each in one.state_dict().items()})
    return network.eval()


def _split(rows: Sequence[Row]) -> tuple[Sequence[Row], Sequence[Row]]:
    """Scenes to learn from and to calibrate on; too few serve both."""
    last = len(rows) // CALIBRATING
    return (rows[:-last], rows[-last:]) if last else (rows, rows)


def draw_scenes(out: Path, first: int, number: int, executor: Executor, title: str, wide: bool = False) -> Sequence[Row]:
    """Rows of scenes from a first seed on, rendered unless they are in the folder. Raises LuxloopError if a scene cannot be rendered."""
    folder, name = (out / FOLDER / "wide", "wide scene") if wide else (out / FOLDER, "scene")
    seeds = sorted(range(first, first + number), key=scenes.road_seed)  # ordered by road
    jobs = [Job(f"{name} {seed}", {"seed": seed, "folder": str(folder), "wide": wide}) for seed in seeds]
    results: Results = run(scenes.draw, jobs, out / JOBS, version=VERSION, executor=executor, title=title)
    if results.failures:
        key, reason = next(iter(results.failures.items()))
        raise LuxloopError(f"{out}: {len(results.failures)} scenes cannot be drawn, first {key}: {reason}")
    return sorted(results.rows, key=lambda row: int(row["seed"]))


def train_detector(out: Path, number: int, wide: int, held_out: int, epochs: int, seed: int, processes: int | None) -> None:
    """Train a detector and print its goals."""
    report = train(out, number, wide, held_out, epochs, seed, processes)
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
