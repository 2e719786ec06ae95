"""`luxloop optimise-beam`: optimise a beam at a scenario's start (T fig. 9.3); writes utilisations to play, and figures.

The objective is a detector's confidence or an image metric, less the cost of light.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import optuna
import torch
from matplotlib.colors import LogNorm
from pydantic import Field
from torch import Tensor
from torch.nn.functional import interpolate

from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.recording.manifest import write_json
from luxloop.loop.recording.record import schema
from luxloop.loop.report import terminal as tables
from luxloop.loop.report.picture import WALL_DEG, Mark, readable, wall_light
from luxloop.loop.report.style import NIGHT, drawing
from luxloop.loop.run import torch_device
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.overrides import toml_key
from luxloop.loop.simulation.lamps import flux_by_side
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import LitScene
from luxloop.perception.camera import expose, luminance_of, noise_std
from luxloop.perception.detection.build import detector
from luxloop.perception.detection.detector import SAME, Detector, NetworkParams, TruthParams, overlaps
from luxloop.perception.detection.network import Network, NetworkDetector, boxes_of, middles, network_input
from luxloop.perception.metrics import edge_definition, unevenness, weber_contrast
from luxloop.perception.noise import FrameNoise
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import atomic_write, output_folder, whole
from luxloop.world.params import Params

Metric = Literal["detector", "weber_contrast", "edges"]
FAINTEST = 1e-6  # least score, for a finite logarithm
DAZZLING_LX = 1.0  # illuminance of eyes from which on light is glare
SEEN, LEAST_PX = 0.3, 60  # least visible share and pixels of an evaluated object


class BeamGoal(Params):
    """Weights of the loss, the negative mean logarithm of the objects' scores plus the cost of light."""

    metric: Metric = Field("detector", description="metric of the objects, to be maximised")
    energy: float = Field(2.0, ge=0, description="weight of the lamps' flux relative to all pixels on")
    unevenness: float = Field(0.0, ge=0, description="weight of the unevenness of light on objects, standard deviation over mean")
    glare: float = Field(0.1, ge=0, description="weight per lx above 1 lx on heads and windscreens")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Effect of a beam.

    scores: `[n]`, of the objects. loss: with the scores' logarithm. share: flux relative to all pixels on. luminance: `[height, width]`
    cd/m^2.
    """

    scores: Tensor
    loss: Tensor
    share: Tensor
    luminance: Tensor


@dataclass(frozen=True, eq=False)
class BeamEvaluator:
    """A still scene for evaluating beams. detector: None for image metrics."""

    simulation: Simulation
    goal: BeamGoal
    detector: Detector | None
    scene: LitScene

    @classmethod
    def prepare(cls, simulation: Simulation, goal: BeamGoal, detector: Detector | None) -> "BeamEvaluator":
        """Scene at a simulation's start. Raises LuxloopError if no object that counts is in view."""
        evaluator = cls(simulation, goal, detector, simulation.world.lit(0.0))
        if not evaluator.masks:
            raise LuxloopError("objects: none with a category that counts is in the camera's view at the start; put one there")
        return evaluator

    @cached_property
    def masks(self) -> dict[str, Tensor]:
        """Pixels of the evaluated objects by name: those in sight whose class the detector knows."""
        ids, classes = self.scene.surfaces.object_id, None if self.detector is None else self.detector.classes
        return {
            each.name: ids == each.object_id
            for each in self.scene.objects
            if each.visible >= SEEN and each.pixels >= LEAST_PX and (classes is None or each.category in classes)
        }

    def frame(self, luminance: Tensor, step: int, quantise: bool = False) -> Tensor:
        """Digital numbers as shares of the largest, with the noise of a step."""
        camera, seed = self.simulation.scenario.camera, self.simulation.scenario.seed
        return expose(luminance, camera, FrameNoise.of(seed, step, 0), quantise=quantise) / (2**camera.bits - 1)

    def evaluate(self, lights: Sequence[Tensor], step: int = 0) -> Evaluation:
        """Effect of utilisations `[n_p]`, one per module; differentiable for image metrics and luxloop's own network."""
        illuminance, luminance = self.scene.light(lights)
        luminance = luminance + self.scene.base + self.scene.backscattered([Utilisation(u) for u in lights])
        scores = self.scores(luminance, step)
        share = sum((u * module.flux).sum() for u, module in zip(lights, self.simulation.modules, strict=True)) / self._most_lm
        loss = -scores.clamp(min=FAINTEST).log().mean() + self.goal.energy * share
        if self.goal.unevenness:
            loss = loss + self.goal.unevenness * torch.stack([unevenness(illuminance, mask, 1.0) for mask in self.masks.values()]).mean()
        if self.goal.glare and bool(self.scene.eyes.any()):
            loss = loss + self.goal.glare * (illuminance[self.scene.eyes] - DAZZLING_LX).clamp(min=0).mean()
        return Evaluation(scores, loss, torch.as_tensor(share), luminance)

    def scores(self, luminance: Tensor, step: int) -> Tensor:
        """Scores of the objects, `[n]`."""
        camera = self.simulation.scenario.camera
        if self.goal.metric != "detector":
            measure: Callable[[Tensor, Tensor, float], Tensor] = weber_contrast if self.goal.metric == "weber_contrast" else edge_definition
            seen = luminance_of(expose(luminance.clone(), camera, quantise=False), camera)
            black = float(noise_std(torch.zeros(1), camera))
            return torch.stack([measure(seen, mask, black) for mask in self.masks.values()])
        if isinstance(self.detector, NetworkDetector) and luminance.requires_grad:
            return self._likeliest(self.detector.network, self.frame(luminance, step))
        return self.confidences(self.frame(luminance.detach(), step, quantise=True))

    def confidences(self, frame: Tensor) -> Tensor:
        """Confidence of the detector in the objects, `[n]`: the best score of their class among boxes on them, 0 without one."""
        assert self.detector is not None
        found = self.detector.detect(frame[None])[0]
        boxes, scores = found.boxes.double().cpu(), found.scores.double().cpu()
        shows = overlaps(self.boxes, boxes) >= SAME
        of_class = scores[:, self._labels].T
        return torch.where(shows, of_class, 0.0).amax(1) if len(boxes) else torch.zeros(len(self.masks), dtype=torch.float64)

    def _likeliest(self, network: Network, frame: Tensor) -> Tensor:
        """Differentiable confidence before suppression: the best score of cells whose boxes lie on an object."""
        logits, sides = network(network_input(frame[None]))
        scores = logits[0].flatten(1).sigmoid()
        boxes = boxes_of(sides)[0].flatten(1).T.detach().double().cpu()
        shows = overlaps(self.boxes, boxes) >= SAME
        rows, columns = logits.shape[-2:]
        x, y = middles(rows, columns, boxes.device).flatten(1)
        left, top, right, bottom = self.boxes.T[..., None]
        within = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)  # cells inside an object, for objects without a box
        shows = torch.where(shows.any(1, keepdim=True), shows, within).to(scores.device)
        return torch.where(shows, scores[self._labels.to(scores.device)], 0.0).amax(1)

    @cached_property
    def boxes(self) -> Tensor:
        """Boxes of the evaluated objects, `[n, 4]` px."""
        return torch.stack([box for each, box in zip(self.scene.objects, self.scene.boxes, strict=True) if each.name in self.masks])

    @cached_property
    def _labels(self) -> Tensor:
        assert self.detector is not None
        classes = list(self.detector.classes)
        return torch.tensor([classes.index(each.category) for each in self.scene.objects if each.category and each.name in self.masks])

    @cached_property
    def _most_lm(self) -> float:
        return float(sum(module.flux.sum() for module in self.simulation.modules))


RATE = 0.02  # of Adam, about the largest change of a utilisation per step
START = 0.1  # utilisation of all pixels if the scenario has no base beam
PATCHES = (3, 8)  # rows and columns of light patches for sampling
Lights = tuple[Tensor, ...]


Search = tuple[Lights, list[float]]  # utilisations `[n_p]`, one per module, and the loss of every step or trial


def begin(evaluator: BeamEvaluator) -> Lights:
    """Start utilisations: the scenario's base beam, or all pixels at START if it is off."""
    simulation = evaluator.simulation
    plan = simulation.planner.plan(simulation.situation(0.0))
    base = tuple(module.base(plan).float() for module in simulation.modules)
    return base if any(bool(u.any()) for u in base) else tuple(torch.full_like(u, START) for u in base)


def descend(evaluator: BeamEvaluator, start: Lights, steps: int, on_step: Callable[[int, float], None] = lambda step, loss: None) -> Search:
    """Adam on the utilisations of all pixels, limited to 0..1; each step has its own noise."""
    lights = [u.clone().requires_grad_(True) for u in start]
    optimiser, losses = torch.optim.Adam(lights, RATE, betas=(0.9, 0.99)), []
    for step in range(steps):
        optimiser.zero_grad()
        loss = evaluator.evaluate(lights, step).loss
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        with torch.no_grad():
            for u in lights:
                u.clamp_(0, 1)
        losses.append(loss.item())
        on_step(step, losses[-1])
    return tuple(u.detach() for u in lights), losses


def sample(evaluator: BeamEvaluator, start: Lights, trials: int, on_step: Callable[[int, float], None] = lambda step, loss: None) -> Search:
    """Optuna's tree-structured Parzen estimator on the levels of the start beam and of light patches, for any detector."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=evaluator.simulation.scenario.seed, multivariate=True))
    names = [f"patch {row} {column}" for row in range(PATCHES[0]) for column in range(PATCHES[1])]
    study.enqueue_trial(dict.fromkeys(names, 0.0) | {"start": 1.0})
    losses = []

    def lights_of(levels: dict[str, float]) -> Lights:
        patches = torch.tensor([levels[name] for name in names]).view(1, 1, *PATCHES)
        return tuple(
            (levels["start"] * u + interpolate(patches, (of.pixel_rows, of.pixel_cols), mode="bilinear").flatten().to(u)).clamp(0, 1)
            for u, of in zip(start, (module.headlight for module in evaluator.simulation.modules), strict=True)
        )

    for number in range(trials):
        trial = study.ask()
        levels = {name: trial.suggest_float(name, 0.0, 1.0) for name in (*names, "start")}
        with torch.no_grad():
            losses.append(float(evaluator.evaluate(lights_of(levels), number).loss))
        study.tell(trial, losses[-1])
        on_step(number, losses[-1])
    return lights_of(study.best_params), losses


def alike(lights: Sequence[Tensor], flux: Sequence[Tensor], lm: float) -> Lights:
    """Beam scaled to a luminous flux in lm: utilisations `[n_p]` of each module, limited to 1."""
    total = float(sum((u * f).sum() for u, f in zip(lights, flux, strict=True)))
    return tuple((u * (lm / max(total, 1e-9))).clamp(max=1) for u in lights)


WALL_COLUMNS = 360
FAINTEST_LX = 0.1  # on the wall, drawn black
CHARACTERS = 250  # of marks, over the width of all pictures
BRIGHT = 0.995  # quantile of the optimised luminance drawn white


@torch.no_grad()
def write_picture(
    file: Path, evaluator: BeamEvaluator, beams: Mapping[str, Lights], losses: Sequence[float], summary: dict[str, Any]
) -> None:
    """Draw camera pictures and wall light of the beams, and the loss. Raises LuxloopError on a write error."""
    camera = evaluator.simulation.scenario.camera
    images = [evaluator.frame(evaluator.evaluate(lights).luminance, 0, True) * (2**camera.bits - 1) for lights in beams.values()]
    seen = [luminance_of(image, camera).cpu() for image in images]
    modules, mount = evaluator.simulation.modules, evaluator.simulation.scenario.headlight
    walls = [wall_light(modules, lights, mount, WALL_COLUMNS).cpu() for lights in beams.values()]
    white = float(torch.quantile(seen[-1].flatten()[::7], BRIGHT)) * 1.3
    scale = LogNorm(FAINTEST_LX, max(1.0, *(float(wall.max()) for wall in walls)))  # one for all, so that they can be compared
    side, down, up = WALL_DEG
    with drawing(file, (13.0, 6.4)) as figure:
        grid = figure.add_gridspec(3, len(beams), height_ratios=(4.2, 2.4, 1.5))
        for k, name in enumerate(beams):
            figures = summary["beams"][name]
            axes = figure.add_subplot(grid[0, k])
            axes.imshow((seen[k].numpy() / white).clip(0, 1) ** 0.5, cmap=NIGHT, vmin=0, vmax=1)
            named = []
            for (each, score), (left, top, right, bottom) in zip(figures["scores"].items(), evaluator.boxes.tolist(), strict=True):
                axes.plot([left, right, right, left, left], [top, top, bottom, bottom, top], color="#4fd17a", linewidth=0.7)
                named.append(Mark((), text=f"{each} {score:.2f}", at=(round(left), round(top))))
            for mark in readable(named, camera.width_px * len(beams) / CHARACTERS, camera.width_px):
                axes.annotate(mark.text, mark.at, (0, 2), textcoords="offset points", color="#4fd17a", fontsize=6, clip_on=True)
            axes.set(xticks=[], yticks=[], xlim=(-0.5, camera.width_px - 0.5), ylim=(camera.height_px - 0.5, -0.5))
            axes.set_title(f"{name}: {figures['flux_lm']:.0f} lm, mean score {figures['score_mean']:.2f}")
            axes.grid(False)
            wall = figure.add_subplot(grid[1, k])
            light = walls[k].clamp(min=FAINTEST_LX).numpy()
            shown = wall.imshow(light, cmap="inferno", norm=scale, extent=(-side, side, -down, up), aspect="auto")
            title = f"Both lamps on a wall at 25 m: {float(walls[k].max()):.3g} lx at most"
            wall.set(title=title, xlabel="to the right in deg", ylabel="up in deg" if k == 0 else "")
            wall.grid(False)
            figure.colorbar(shown, ax=wall, label="lx", pad=0.01, format="{x:g}")
        course = figure.add_subplot(grid[2, :])
        course.plot(losses)
        course.set(xlabel="step", title=f"Loss, {summary['method']}, {summary['metric']}")


Method = Literal["auto", "gradient", "sampling"]
STEPS: Mapping[str, int] = {"gradient": 80, "sampling": 150}
FRAMES = 8  # frames with different noise for mean scores
RAW, PICTURE, SUMMARY = "raw.toml", "beam.png", "beam.json"


def optimise_beam(
    scenario: Scenario, goal: BeamGoal, method: Method, steps: int | None, out: Path, device: str, played_by: str
) -> dict[str, Any]:
    """Optimise a beam, write and print it; returns its figures. played_by: arguments of `luxloop run`, `--set` last.

    Raises LuxloopError for scenarios without objects in sight, and, before the search, for a folder that cannot be made.
    """
    scenario = scenario.model_copy(update={"functions": {}})
    simulation = Simulation.prepare(scenario, torch_device(device))
    with locate(scenario.source):
        evaluator = BeamEvaluator.prepare(simulation, goal, _detector(scenario, goal.metric, simulation.device))
    method = _method(method, evaluator)
    start, number = begin(evaluator), steps or STEPS[method]
    search = descend if method == "gradient" else sample
    with output_folder(out), tables.progress("searching", number) as advance:
        lights, losses = search(evaluator, start, number, lambda step, loss: advance())
        lm = sum(flux_by_side(simulation.modules, lights).values())
        as_dim = alike(start, [module.flux for module in simulation.modules], lm)
        beams = {"before": start, "before, as much flux": as_dim, "found": lights}
        summary = _summary(evaluator, method, losses, beams)
        _write(out, evaluator, losses, beams, summary)
    _tell(summary, f"{played_by} {shlex.quote(str(out / RAW))}")
    return summary


def _detector(scenario: Scenario, metric: Metric, device: torch.device) -> Detector | None:
    if metric != "detector":
        return None
    given = scenario.detector
    return detector(NetworkParams() if given is None or isinstance(given, TruthParams) else given, device)


def _method(asked: Method, evaluator: BeamEvaluator) -> Literal["gradient", "sampling"]:
    smooth = evaluator.detector is None or isinstance(evaluator.detector, NetworkDetector)
    if asked == "gradient" and not smooth:
        raise LuxloopError(
            "--method gradient: only luxloop's own network can be differentiated; take --method sampling for other detectors"
        )
    if asked != "auto":
        return asked
    return "gradient" if smooth else "sampling"


def _summary(evaluator: BeamEvaluator, method: str, losses: Sequence[float], beams: Mapping[str, Lights]) -> dict[str, Any]:
    return {
        "metric": evaluator.goal.metric,
        "method": method,
        "weights": evaluator.goal.model_dump(exclude={"metric"}),
        "steps": len(losses),
        "loss_first": losses[0],
        "loss_last": min(losses) if method == "sampling" else losses[-1],
        "beams": {name: _figures(evaluator, lights) for name, lights in beams.items()},
    }


@torch.no_grad()
def _figures(evaluator: BeamEvaluator, lights: Lights) -> dict[str, Any]:
    seen = [evaluator.evaluate(lights, step) for step in range(FRAMES)]
    scores = torch.stack([each.scores.double().cpu() for each in seen]).mean(0).tolist()
    eyes = evaluator.scene.light(lights)[0][evaluator.scene.eyes]
    return {
        "flux_lm": sum(flux_by_side(evaluator.simulation.modules, lights).values()),
        "scores": dict(zip(evaluator.masks, scores, strict=True)),
        "score_mean": sum(scores) / len(scores),
        "eyes_lx_max": float(eyes.max()) if len(eyes) else None,
    }


def _write(out: Path, evaluator: BeamEvaluator, losses: Sequence[float], beams: Mapping[str, Lights], summary: dict[str, Any]) -> None:
    entries = []
    for module, u in zip(evaluator.simulation.modules, beams["found"], strict=True):
        file = out / f"{module.name.replace(' ', '-')}.npz"
        with whole(file) as part, part.open("wb") as stream:
            np.savez_compressed(stream, u=u.cpu().numpy().reshape(module.headlight.pixel_rows, module.headlight.pixel_cols))
        entries.append(f'  {{ file = "./{file.name}", modules = ["{module.name}"] }},\n')
    cleared = "".join(f"{toml_key(key)} = {{}}\n" for key in _gone(evaluator.simulation))
    atomic_write(out / RAW, f"{cleared}\n[lighting]\nraw = [\n{''.join(entries)}]\n")
    write_json(out / SUMMARY, summary)
    write_picture(out / PICTURE, evaluator, beams, losses, summary)


def _gone(simulation: Simulation) -> list[str]:
    """Scenario keys without effect in a simulation without functions."""
    scenario, known = simulation.scenario, set(schema(simulation).names) - {"dark_lx_max"}
    spells = {key: getattr(scenario.disturbances, key) for key in ("oncoming", "ambient")}
    return [
        *("functions", "off_share", "detector_frames"),
        *(f"checks.{name}" for name, each in scenario.checks.items() if each.metric not in known or each.compare == "open_loop"),
        *(f"disturbances.{key}[{k}]" for key, each in spells.items() for k, spell in enumerate(each) if spell.frames == "off"),
    ]


def _tell(summary: dict[str, Any], played_by: str) -> None:
    beams = summary["beams"]
    rows = [("flux", *(f"{each['flux_lm']:.0f} lm" for each in beams.values()))]
    rows += (
        (f"{summary['metric']}: {key}", *(f"{each['scores'][key]:.2f}" for each in beams.values())) for key in beams["found"]["scores"]
    )
    rows += [("on eyes", *(tables.number(each["eyes_lx_max"], ".2f", " lx") for each in beams.values()))]
    tables.show(tables.plain(("", *beams), rows))
    print(f"to see it: luxloop run {played_by}")
