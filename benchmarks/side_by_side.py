"""All controllers of a symbol in one world: the job of benchmarks/symbol_control.py and places.py, and what lamp and camera allow there."""

import json
import sys
from argparse import Namespace
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import torch
from bench import show, study
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from luxloop import Scenario, Simulation, Utilisation, build_controller, prepare, validate
from luxloop.controllers.symbol.sensing.projector import DrawingModule
from luxloop.loop.recording.manifest import digests, table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.recording.summary import AXES, column, overshoot_percent, settle_step
from luxloop.loop.scenario import data
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.studies.batch.copies import Lights
from luxloop.perception.birdseye import rectify
from luxloop.perception.metrics import THRESHOLD
from luxloop.world.rendering.raycast import depths, first_hits
from luxloop.world.scene.triangles import Triangles

SMALL = "camera={width_px=640, height_px=480}"
DARK = 100.0  # %: the centroid's error where nothing is lit
OUTSIDE = 9.0  # a place that is not on the symbol, which lies from -1 to 1


@dataclass(frozen=True)
class World:
    """A world in which each controller gets its turn. facts: what its rows have of it. controllers: their tables by name."""

    key: str
    facts: Mapping[str, Any]
    scenario: Scenario
    controllers: Mapping[str, Mapping[str, Any]]
    bounded: bool = False

    @property
    def parameters(self) -> dict[str, Any]:
        """Of the job."""
        plain = self.scenario.model_dump(mode="json", exclude={"functions": {"symbol": {"controller"}}})
        return {"scenario": plain, "controllers": self.controllers, "bounded": self.bounded}


def compare_in(worlds: Iterable[World], given: Namespace) -> tuple[list[tuple[World, dict[str, Any]]], dict[str, str]]:
    """Worlds of the kinds `given.only`, by default all, with what `compare` finds there, and reasons of failures; resumes."""
    every = list(worlds)
    files = sorted({file for world in every for file in digests(world.scenario).items()})  # roads among them
    chosen = [world for world in every if not given.only or world.facts["kind"] in given.only]
    found, failures = study(compare, {world.key: world.parameters for world in chosen}, given, [sys.modules[__name__]], json.dumps(files))
    return [(world, found[world.key]) for world in chosen if world.key in found], failures


def table(title: str, rows: pd.DataFrame, field: str = "kind", measure: str = "iou") -> None:
    """Print a row for each value of the field and a column a controller: the mean of a measure, its least in brackets."""
    cells = rows.groupby([field, "controller"], sort=False)[measure].agg(lambda each: f"{each.mean():.2f} ({each.min():.2f})")
    show(title, cells.unstack(sort=False).to_dict("index"))


def road_of(scenario: Scenario) -> dict[str, Any]:
    """The road's table for a controller that knows it."""
    road = scenario.road.model_dump(mode="json")
    return road | {"file": str(data.locate(road["file"]))} if "file" in road else road


def compare(scenario: Mapping[str, Any], controllers: Mapping[str, Mapping[str, Any]], bounded: bool = False) -> dict[str, Any]:
    """A job: metrics of each controller at each step, when it settled and was lost; the bound."""
    torch.set_num_threads(1)  # wherever the job runs
    own = {name: controlled(scenario, table) for name, table in controllers.items()}
    simulation = prepare(next(iter(own.values())), "cpu")
    found = bound(simulation)[1] if bounded else {}
    found["metrics"] = {}
    for name, steps in side_by_side(simulation, own).items():
        metrics = {
            axis: [round(float(value), 4) if np.isfinite(value) else None for value in column(steps, axis)] for axis in (*AXES, "iou")
        }
        lost = [loss != "" for loss in steps["loss"].to_pylist()]
        found["metrics"][name] = {"settle_step": settle_step(steps), "overshoot_percent": overshoot_percent(steps), "lost": lost, **metrics}
    return found


def controlled(scenario: Mapping[str, Any], controller: Mapping[str, Any]) -> Scenario:
    """The scenario of plain data whose symbol lacks its controller, with a controller."""
    symbol = {**scenario["functions"]["symbol"], "controller": controller}
    return validate({**scenario, "functions": {"symbol": symbol}}, str(scenario["name"]))


def side_by_side(simulation: Simulation, own: Mapping[str, Scenario]) -> dict[str, pa.Table]:
    """What recordings have of the symbol in the steps of each controller.

    All go through the same world step by step, so each view of it is rendered once, and their frames have the same noise.
    """
    controllers = (build_controller(each.symbol.controller, simulation.symbol.sensor) for each in own.values())
    runs = [
        replace(simulation.with_controller(each), scenario=own[name]).evaluations() for name, each in zip(own, controllers, strict=True)
    ]
    rows = {name: [] for name in own}
    for results in zip(*runs, strict=True):
        for name, result in zip(own, results, strict=True):
            rows[name].append(row(result))
    columns = schema(simulation)
    return {name: of_one(table_of(each, columns), "symbol") for name, each in rows.items()}


def series(metrics: Mapping[str, Any], name: str, missing: float) -> NDArray[np.float64]:
    """Values of all steps, `[steps]`."""
    return pd.Series(metrics[name], dtype=float).fillna(missing).to_numpy()


def bound(simulation: Simulation) -> tuple[Lights, dict[str, float]]:
    """The symbol as an appearance that this lamp and camera can have on the true road of a standing world; its value is a share, u_abs.

    Returns utilisations, one a module that draws the symbol, its IoU, and the share of the target's cells that it lights.

    A texel takes what of the symbol lies where the camera sees its light on the plane z = 0, a pixel the mean of its texels weighted by
    its light: `u = A^T s / A^T 1`.
    """
    world = simulation.world
    triangles = world.scene.at(0.0, world.motion.at(0.0).T_world_ground)
    lights = tuple(_draw(simulation, triangles, module) for module in simulation.symbol.projector.modules)
    evaluator, all_lights = simulation.symbol.evaluator, simulation.of_all(simulation.symbol, lights)
    lit = rectify(evaluator.plane, world.lit(0.0).luminance(all_lights)) > THRESHOLD * evaluator.goal.median
    visible = (lit & evaluator.goal.mask).sum() / evaluator.goal.mask.sum()
    return lights, {"iou_bound": evaluator.metrics(all_lights, 0.0).iou.item(), "visible": visible.item()}


def _draw(simulation: Simulation, triangles: Triangles, module: DrawingModule) -> Utilisation:
    headlight = module.pixel_controller.headlight
    view = headlight.view(module.T_body_headlight, headlight.cols, headlight.rows)
    where = _on_symbol(simulation, triangles, view.origin, view.rays().flatten(1))
    symbol = grid_sample(simulation.symbol.projector.symbol.double()[None, None], where[None, None], align_corners=False).flatten().numpy()
    matrix = headlight.matrix.to_scipy()
    share = (matrix.T @ symbol) / (matrix.T @ np.ones_like(symbol)).clip(1e-12)
    value = simulation.scenario.symbol.value / len(simulation.symbol.projector.modules)
    return Utilisation(torch.from_numpy(value * share).float())  # without a band, outside of which light would be hidden


def _on_symbol(simulation: Simulation, triangles: Triangles, origin: Tensor, rays: Tensor) -> Tensor:
    """Where on the symbol `[N, 2]` (right and down, -1 to 1 over it) the camera sees light of rays `[3, N]` from a place `[3]` m.

    Light on the true road is seen on the plane z = 0 behind it; far off the symbol where a ray or the line of sight meets nothing.
    """
    params, eye = simulation.scenario.symbol, simulation.world.view.origin[:, None]
    face = first_hits(triangles, origin, rays)
    met = face >= 0
    road = origin[:, None] + rays[:, met] * depths(triangles, face[met], origin, rays[:, met])
    down = eye[2] - road[2]
    x, y = (road if params.target == "place" else eye + (road - eye) * eye[2] / down)[:2]
    on_symbol = torch.stack([2 * (params.y_m - y) / params.width_m, 2 * (params.x_m - x) / params.length_m], -1)
    where = torch.full((rays.shape[1], 2), OUTSIDE, dtype=torch.float64)
    where[met] = torch.where((down > 0)[:, None], on_symbol, OUTSIDE)
    return where
