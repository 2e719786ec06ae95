"""One beam for a driver and a camera, in clear air and bad weather: `python benchmarks/beams.py [--weather fog] [--worlds N]`.

A share of the low beam's flux goes to the beam `camera`. Judges both ends and the shares between them in random worlds, each by the
shipped detector's recall and by the driver's revealing power; prints the tables of docs/beams_for_cameras.md. `--search N --weather fog`
samples spots and shares in other worlds instead, and prints the best by weight. Goes on where an earlier run in the same folder was.
"""

import math
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
import torch
from bench import Goal, run, show, study
from detectors import CAMERA, category_and_shape
from torch import Tensor

from luxloop import Simulation, load_lamp, validate
from luxloop.controllers.pixels.ssc import Utilisation
from luxloop.loop.report.onlooker import Onlooker
from luxloop.loop.report.style import drawing
from luxloop.loop.report.views import driver
from luxloop.loop.simulation.lamps import ShiningModule
from luxloop.loop.studies.beams import alike
from luxloop.loop.studies.training.evaluate import SURE, score_frame
from luxloop.loop.studies.training.scenes import CLASSES, SceneObject
from luxloop.perception.camera import expose
from luxloop.perception.eye import threshold_difference
from luxloop.perception.ground_truth import ground_truth
from luxloop.perception.noise import FrameNoise
from luxloop.world.headlight.lamp import direction
from luxloop.world.lamps.description import Side
from luxloop.world.lamps.fitting import fit
from luxloop.world.lamps.patterns import Pattern, pattern
from luxloop.world.light.illumination import lux_per_cd
from luxloop.world.rendering.raycast import sees
from luxloop.world.traffic.generator import random_tables

LAMP = "ssl-hd-lores"
WEATHER = {"clear": {}, "fog": {"visibility_m": 100.0}, "rain": {"rain_mm_h": 20.0}, "snow": {"snow_mm_h": 1.0}}
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the camera's beam
WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the camera in a search
LOW, BEST, CUT, LOOP, FOG_LIGHT, FULL = "low beam", "camera 50 %", "camera, cut off", "by confidence", "fog light", "full light"
ORACLE, NO_AIR = "best in each world", ", without backscatter"
STEPS, LEAST = 24, 0.15  # of the loop by confidence, and its least share
FOG = pattern("low").model_copy(  # wide, below a flat cut-off, and dark above
    update={
        "cutoff_v_deg": -1.0,
        "shoulder_deg": 0.0,
        "hot_cd": 0.0,
        "broad_cd": 2e4,
        "broad_width_deg": 35.0,
        "above_cd": 100.0,
        "rules": (),
    }
)
TARGET_M, REFLECTANCES = 0.2, (0.05, 0.1, 0.2, 0.4)
TARGETS_M = (15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0), (-3.0, -1.0, 1.0, 3.0)  # ahead and to the left
REVEALED = 7.0  # visibility level from which on a target counts
B50L = (-3.43, 0.57)  # deg, an oncoming driver's eye 50 m ahead
DEVELOPMENT = 24  # worlds of a search
DRAWS = 2000  # of the bootstrap over worlds
SEARCHED = {"v_deg": (-2.0, 2.5), "width_deg": (2.0, 12.0), "height_deg": (0.3, 3.0), "share": (0.0, 1.0)}
Lights = Sequence[Tensor]


class Driver:
    """A driver who looks for targets of 20 cm on the road."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation, self.scene = simulation, simulation.world.through(driver(640), 0.0)
        eye, medium = self.scene.eye.origin, simulation.world.scene.air_at(0.0)
        foot = torch.cartesian_prod(*(torch.tensor(each, dtype=torch.float64) for each in (*TARGETS_M, (0.0,)))).T
        middle, top = (foot + torch.tensor([[0.0], [0.0], [z]]) for z in (TARGET_M / 2, TARGET_M))
        behind = eye[:, None] + (top - eye[:, None]) * eye[2] / (eye[2] - TARGET_M)  # road over its upper edge
        (u, v), _ = self.scene.eye.project(torch.stack([foot, behind]).movedim(0, 1).flatten(1))
        inside = (u >= 0) & (u < self.scene.eye.width) & (v >= 0) & (v < self.scene.eye.height)
        pixels = torch.where(inside, v.long() * self.scene.eye.width + u.long(), 0)
        on_road = (inside & (self.scene.surfaces.object_id.flatten()[pixels] == 0)).view(2, -1).all(0)
        free = on_road & sees(self.scene.triangles, eye, middle, TARGET_M)
        self.pixels, middle = pixels.view(2, -1)[:, free], middle[:, free]
        away = (middle - eye[:, None]).norm(dim=0)
        self.size_arcmin = (60 * torch.rad2deg(2 * torch.atan(TARGET_M / 2 / away))).float()
        self.passed = torch.ones(1) if medium is None else medium.transmittance(middle - eye[:, None]).float()
        self.haze = 0.0 if medium is None else (1 - self.passed) * medium.horizon(simulation.scenario.light.ambient_lx)
        self.rays = [self._ray(each.T_body_headlight.double(), middle) for each in self.scene.modules]
        dark = [torch.zeros_like(each.flux) for each in simulation.modules]
        self.veil = self._at(Onlooker.of(simulation, driver(640)).glare(self.scene, dark)[1])

    def _ray(self, T: Tensor, middle: Tensor) -> tuple[Tensor, Tensor]:
        """Directions `[3, n]` from a module to the targets, and lx for each cd there on an upright surface that faces the car."""
        away, medium = T[:3, 3:] - middle, self.simulation.world.scene.air_at(0.0)
        per_cd = lux_per_cd(away, torch.tensor([[-1.0], [0.0], [0.0]], dtype=torch.float64))
        seen = sees(self.scene.triangles, T[:3, 3], middle, TARGET_M)
        return T[:3, :3].T @ -away, per_cd * seen * (1.0 if medium is None else medium.transmittance(away))

    def _at(self, image: Tensor) -> Tensor:
        """Mean `[n]` of a picture at the road before and behind each target."""
        return image.flatten()[self.pixels].mean(0)

    def levels(self, lights: Lights) -> Tensor:
        """Visibility levels `[reflectances, n]`."""
        air = self.scene.backscattered([Utilisation(u) for u in lights])
        air = self._at(air) if isinstance(air, Tensor) else 0.0
        background = self._at(self.scene.light(lights)[1] + self.scene.base) + air
        lx = sum(
            each.headlight.intensity(each.headlight.light_texture(u), ray) * per_cd
            for each, u, (ray, per_cd) in zip(self.scene.modules, lights, self.rays, strict=True)
        )
        lx = torch.as_tensor(lx).float() + self.simulation.scenario.light.ambient_lx / 2  # half of the sky
        target = self.passed * torch.tensor(REFLECTANCES)[:, None] * lx / math.pi + self.haze + air
        adapted = (background + self.veil).clamp(min=1e-4).expand_as(target)
        return (target - background).abs() / threshold_difference(adapted, self.size_arcmin.expand_as(target), target < background)


class Scene:
    """A random street that stands, with a detector and a driver."""

    def __init__(self, seed: int, weather: str) -> None:
        tables = random_tables(seed)
        traffic = tables["traffic"] | {"on_road": True, "moving": False}
        tables["traffic"] = traffic | {key: traffic[key] + 1 for key in ("pedestrians", "cyclists")}
        world = {"camera": CAMERA, "detector": {"kind": "network"}, "headlight": {"model": LAMP}, "air": [WEATHER[weather]]}
        scenario = validate({"name": "judged", "steps": 1, "lighting": {}, **world, **tables}, f"seed {seed}")
        self.seed, self.simulation = seed, Simulation.prepare(scenario)
        self.view, self.driver = self.simulation.world.lit(0.0), Driver(self.simulation)
        known = [category_and_shape(item)[0] for item in scenario.all_objects]
        size = (CAMERA["width_px"], CAMERA["height_px"]) * 2
        self.objects = [
            SceneObject(
                each.object_id, CLASSES.index(each.category), tuple(np.clip(each.whole, 0.0, size).tolist()), each.visible, each.inside
            )
            for each in ground_truth(self.view.surfaces, self.view.triangles, self.view.view, known)
            if each.category in CLASSES and each.inside > 0
        ]

    def figures(self, lights: Lights, air: bool = True) -> dict[str, float]:
        """Of a beam: numbers of objects, of found ones and of false boxes, the sum of confidences, and the driver's revealing power.

        air: whether the air scatters light of the lamps into the camera.
        """
        shown, camera = tuple(Utilisation(u) for u in lights), self.simulation.scenario.camera
        luminance = self.view.light(lights)[1] + self.view.base
        if air:
            drops = self.simulation.world.drops(0.0, shown, (), np.random.default_rng(self.seed))
            luminance = luminance + self.view.backscattered(shown) + (0.0 if drops is None else drops)
        frame = expose(luminance.float(), camera, FrameNoise.of(self.seed, 0, 0)) / (2**camera.bits - 1)
        classes = [CLASSES.index(each) for each in self.simulation.pipeline.classes]
        scores = score_frame(self.simulation.pipeline.find(frame, self.view), self.objects, classes)
        revealed = float((self.driver.levels(lights) >= REVEALED).double().mean())
        found = {"objects": len(scores.right), "right": sum(scores.right), "false": scores.false, "confidence": sum(scores.confidences)}
        return found | {"revealed": revealed}

    def low(self) -> Lights:
        return [each.lamp.beam("low")[0] for each in self.simulation.modules]

    def mixed(self, of: Pattern, share: float) -> Lights:
        """The low beam, a share of whose flux is in another pattern."""
        low, modules = self.low(), self.simulation.modules
        flux = [each.flux for each in modules]
        other = alike([fitted(each.side, of) for each in modules], flux, lumens(low, modules))
        return [torch.lerp(a, b, share) for a, b in zip(low, other, strict=True)]

    def by_confidence(self) -> Lights:
        """The light after STEPS of a detector's loop, which begins with the beam for the camera."""
        ambient = {"doubtful": SURE, "least": LEAST}
        tables = {
            "steps": STEPS,
            "rate_hz": 20.0,
            "lighting": {"base": {"beam": "camera", "rest": "low"}},
            "functions": {"loop": {"kind": "object_based", "method": "ambient", "ambient": ambient}},
        }
        plain = self.simulation.scenario.model_dump(mode="json", exclude_unset=True)
        simulation = Simulation.prepare(validate(plain | tables, "by confidence"), before=self.simulation)
        state = simulation.start()
        for _ in range(STEPS):
            state, result = simulation.step(state)
        return [light.u for light in result.exposures[-1].lights]

    def beams(self, weights: Sequence[Sequence[float]]) -> dict[str, Lights]:
        """The judged beams by name, all but the full light with the low beam's flux."""
        camera = pattern("camera")
        cut = camera.model_copy(update={"cutoff_v_deg": -0.57, "hot_v_deg": camera.hot_v_deg + 0.57})
        mixed = {f"camera {100 * share:.0f} %": self.mixed(camera, share) for share in SHARES[1:]}
        searched = {f"weight {weight:g}": self.mixed(spot(*of), share) for weight, *of, share in weights}
        others = {CUT: cut, FOG_LIGHT: FOG, "adverse": pattern("adverse")}
        full = [torch.ones_like(each.flux) for each in self.simulation.modules]
        alone = {name: self.mixed(each, 1.0) for name, each in others.items()}
        return {LOW: self.low(), **mixed, **searched, LOOP: self.by_confidence(), **alone, FULL: full}


@cache
def fitted(side: Side, of: Pattern) -> Tensor:
    return fit(load_lamp(LAMP, side=side), of)[0]


def lumens(lights: Lights, modules: Sequence[ShiningModule]) -> float:
    return sum(float(u @ each.flux) for u, each in zip(lights, modules, strict=True))


def judge(seed: int, weather: str, weights: Sequence[Sequence[float]]) -> dict[str, Any]:
    """A job: figures of all beams in one world."""
    torch.set_num_threads(1)
    scene = Scene(seed, weather)
    beams = scene.beams(weights)
    modules = scene.simulation.modules
    found = {name: scene.figures(lights) for name, lights in beams.items()}
    found |= {name + NO_AIR: scene.figures(beams[name], air=False) for name in (LOW, BEST, FULL)}
    for name, lights in beams.items():
        found[name]["lm"] = lumens(lights, modules)
        found[name]["B50L cd"] = float(modules[0].lamp.intensity((lights[0],), direction(*torch.tensor(B50L)[:, None])))
    return found


def table_of(found: Sequence[Mapping[str, Mapping[str, float]]]) -> dict[str, dict[str, Any]]:
    """Figures by beam, with 95 % intervals of a bootstrap over worlds: recall, and revealing power, each also less the low beam's; and of
    the beam of as much flux at most that finds most in each world, which is a bound for all of them.
    """
    most_lm = 1.01 * found[0][LOW]["lm"]
    worlds = [
        {**world, ORACLE: max((each for each in world.values() if each.get("lm", math.inf) < most_lm), key=lambda each: each["right"])}
        for world in found
    ]
    rows = pd.DataFrame([{"world": k, "beam": name, **each} for k, world in enumerate(worlds) for name, each in world.items()])
    by = {key: rows.pivot(index="world", columns="beam", values=key)[[*worlds[0]]] for key in rows.columns.drop(["world", "beam"])}
    draws = np.random.default_rng(0).integers(len(worlds), size=(DRAWS, len(worlds)))
    objects = by["objects"][LOW].to_numpy()
    shares = {
        "recall": lambda at: by["right"].to_numpy()[at].sum(-2) / objects[at].sum(-1)[..., None],
        "revealing power": lambda at: by["revealed"].to_numpy()[at].mean(-2),
    }
    columns = {key: by[of].mean() for key, of in (("lm", "lm"), ("B50L cd", "B50L cd"), ("false a frame", "false"))}
    columns["confidence"] = by["confidence"].sum() / objects.sum()
    for key, of in shares.items():
        value, drawn = of(np.arange(len(worlds))), of(draws)
        for name, each, sample in ((key, value, drawn), (f"{key} - low", value - value[:1], drawn - drawn[:, :1])):
            interval = np.quantile(sample, (0.025, 0.975), axis=0).T.round(3).tolist()
            columns |= {name: pd.Series(each, [*worlds[0]]), f"{name}, 95 %": pd.Series(interval, [*worlds[0]])}
    return pd.DataFrame(columns).loc[[*worlds[0]]].to_dict("index")


def spot(v_deg: float, width_deg: float, height_deg: float) -> Pattern:
    """Light about one direction straight ahead."""
    sides = {f"hot_{side}_deg": width_deg for side in ("left", "right")} | {f"hot_{side}_deg": height_deg for side in ("up", "down")}
    return pattern("camera").model_copy(update={"hot_v_deg": v_deg, **sides})


def search(given: Namespace) -> dict[str, Any]:
    """Samples spots and shares for both goals at once, and shows the best for each weight."""
    weather, folder = given.weather[0], Path(given.out)
    scenes = [Scene(given.developed + k, weather) for k in range(DEVELOPMENT)]
    folder.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    trials = optuna.create_study(
        study_name=weather,
        storage=f"sqlite:///{folder}/search.db",
        load_if_exists=True,
        directions=["maximize", "maximize"],
        sampler=optuna.samplers.TPESampler(seed=0, multivariate=True),
    )

    def both(trial: optuna.Trial) -> tuple[float, float]:
        of = {key: trial.suggest_float(key, *bounds) for key, bounds in SEARCHED.items()}
        share = of.pop("share")
        lights = scenes[0].mixed(spot(**of), share)
        found = pd.DataFrame([scene.figures(lights) for scene in scenes])
        return float(found["confidence"].sum() / found["objects"].sum()), float(found["revealed"].mean())

    trials.optimize(both, n_trials=max(given.search - len(trials.trials), 0))
    best = {
        f"weight of the camera {w}": max(trials.trials, key=lambda each: w * each.values[0] + (1 - w) * each.values[1]) for w in WEIGHTS
    }
    rows = {name: each.params | dict(zip(("confidence", "revealing power"), each.values, strict=True)) for name, each in best.items()}
    show(f"Best of {len(trials.trials)} trials, {weather}", rows)
    return {"best": rows}


def draw(tables: Mapping[str, Mapping[str, Mapping[str, Any]]], file: Path) -> None:
    """The fronts of recall over revealing power with their 95 % intervals, a panel for each weather."""
    groups = {
        "share of the camera's beam": [LOW, *(f"camera {100 * share:.0f} %" for share in SHARES[1:])],
        "searched, by weight": [f"weight {weight:g}" for weight in WEIGHTS],
        **{name: [name] for name in (LOOP, CUT, FOG_LIGHT, "adverse")},
    }
    with drawing(file, (5.2 * len(tables), 4.4)) as figure:
        for k, (weather, table) in enumerate(tables.items()):
            axes = figure.add_subplot(1, len(tables), k + 1)
            for number, (label, names) in enumerate(groups.items()):
                x, y = (np.array([table[name][key] for name in names]) for key in ("revealing power", "recall"))
                ends = (np.array([table[name][f"{key}, 95 %"] for name in names]).T for key in ("revealing power", "recall"))
                errors = [np.abs(end - value) for end, value in zip(ends, (x, y), strict=True)]
                axes.errorbar(x, y, errors[1], errors[0], fmt="o-", label=label, elinewidth=0.3, markersize=4)
                places = dict(zip(zip(x, y, strict=True), names, strict=True)) if len(names) > 1 else {}
                for at, name in places.items():
                    text, below = name.removeprefix("camera ").removeprefix("weight "), (4, 5 - 16 * number)
                    axes.annotate(text, at, below, textcoords="offset points", fontsize=7, color=f"C{number}")
            axes.set(title=weather, xlabel="driver: revealing power", ylabel="camera: recall")
        axes.legend(fontsize=7)


def measure(given: Namespace) -> dict[str, Any]:
    if given.search:
        return search(given)
    jobs = {
        f"{weather}, seed {seed}": {"seed": seed, "weather": weather, "weights": given.weights}
        for weather in given.weather
        for seed in range(given.first, given.first + given.worlds)
    }
    found, failures = study(judge, jobs, given, [sys.modules[__name__]])
    tables, goals = {}, []
    for weather in given.weather:
        worlds = [
            {name: of for name, of in each.items() if isinstance(of, Mapping)} for key, each in found.items() if key.startswith(weather)
        ]
        tables[weather] = table_of(worlds)
        show(f"{weather}, {len(worlds)} worlds", tables[weather])
    if "fog" in tables:
        goals.append(Goal("Recall in fog over the low beam at equal flux", tables["fog"][BEST]["recall - low"], 0.1, True))
    draw(tables, Path(given.out) / "front.png")
    return {"tables": tables, "goals": goals, "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "worlds", "first", "weather", "out", "jobs", "search")
