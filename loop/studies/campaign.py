"""`luxloop campaign`: a grid or list of runs from a TOML file into one table, resumable, on one machine or many."""

import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
import pyarrow as pa
from pydantic import Field, model_validator

from luxloop.loop.recording.manifest import digests, write_table
from luxloop.loop.recording.sources import digest_of_code
from luxloop.loop.scenario.model import Scenario, load, only, validate
from luxloop.loop.scenario.overrides import INDEX, resolve_paths
from luxloop.loop.simulation.columns import of_one
from luxloop.loop.studies import ranges
from luxloop.loop.studies.jobs import ALL_CORES, Executor, Job, Results, run
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import output_folder
from luxloop.world.params import Params, Seed
from luxloop.world.plugin import load as load_class
from luxloop.world.plugin import own_names, refuse_code
from luxloop.world.validation import read_toml, validate_model

if TYPE_CHECKING:
    from luxloop.loop.studies.runs import Run as Done

MOST_RUNS = 100_000
LIMITS = re.compile("_(range|rate)_|^highest_m$")  # in keys of controllers
JOBS, TABLE, TRAJECTORIES = "jobs.jsonl", "runs.parquet", "trajectories.parquet"
Row = dict[str, Any]


class RunParams(Params):
    """A single run of a campaign."""

    scenario: str = Field(min_length=1, examples=["snowflake"], description="shipped scenario, or file relative to the campaign file")
    controller: str | None = Field(None, description="controller; left out: the scenario's own")
    variant: str | None = Field(None, description="name of a variant; left out: none")
    seed: Seed = Field(0, description="seed of all noise")


class CampaignParams(Params):
    """A campaign: all combinations of scenarios, controllers, variants and seeds, and single runs."""

    scenarios: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        (), description="shipped scenarios, or files relative to the campaign file"
    )
    controllers: tuple[str | dict[str, Any], ...] = Field(
        (),
        description="controllers with each scenario's settings, or tables of keys with a `label` for the report; left out: each "
        "scenario's own controller",
    )
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...] = Field((0,), min_length=1, description="seeds of all noise")
    set: dict[str, Any] = Field({}, description="changed keys of all scenarios, written as in a scenario file")
    draw: dict[str, Any] = Field(
        {},
        examples=[{"road": {"seed": "1:100000"}}],
        description="keys with a value drawn for each seed, the same for all controllers and variants: from a range `low:high` or "
        "`low:high:log`, or from a list",
    )
    trajectories: bool = Field(False, description="whether to write the steps of all runs into trajectories.parquet")
    variants: dict[str, dict[str, Any]] = Field({}, description="named tables of further changed keys; left out: one variant, unchanged")
    runs: tuple[RunParams, ...] = Field((), description="single runs in addition to the grid")

    @model_validator(mode="after")
    def _named_controllers(self) -> Self:
        if not all(isinstance(each, str) or each.get("name") for each in self.controllers):
            raise ValueError(
                'controllers: a table lacks the name; write for example { name = "thesis_pid", label = "slow", x_rate_m = 0.5 }'
            )
        if len(self.tables) < len(self.controllers):
            raise ValueError("controllers: two have the same name or label; give each table a label of its own")
        return self

    @property
    def tables(self) -> Mapping[str, Mapping[str, Any]]:
        """Keys of each controller by its label."""
        given = ({"name": each} if isinstance(each, str) else each for each in self.controllers)
        return {each.get("label", each["name"]): {key: value for key, value in each.items() if key != "label"} for each in given}


@dataclass(frozen=True)
class Run:
    """A run of a campaign: its parameters, its scenario with all changes, drawn values by key, and whether its steps are written."""

    params: RunParams
    scenario: Scenario
    drawn: Mapping[str, Any]
    trajectory: bool

    @property
    def controller(self) -> str | None:
        """Label or name of the only symbol's controller, of one's own that of its class; None without one."""
        if len(self.scenario.symbols) != 1 or (held := self.scenario.symbol.controller) is None:
            return None
        own, given = held.name.rpartition(":")[-1], self.params.controller or held.name
        return own if given.rpartition(":")[-1] == own else given

    @property
    def row(self) -> Row:
        """Columns that identify the run."""
        held = self.scenario.symbol.controller if len(self.scenario.symbols) == 1 else None
        return {
            "scenario": Path(self.params.scenario).stem,
            "controller": self.controller,
            "variant": self.params.variant or "",
            "seed": self.params.seed,
            **{f"draw.{key}": value for key, value in self.drawn.items()},
            **({} if held is None else {f"limit.{key}": str(value) for key, value in held if LIMITS.search(key)}),
            "steps": self.scenario.steps,
            "scenario_sha256": self.scenario.digest,
        }

    @property
    def key(self) -> str:
        row = self.row
        names = (row[name] for name in ("scenario", "controller", "variant"))
        return ", ".join([*filter(None, names), f"seed {self.params.seed}"])


def read(file: Path, *, allow_code: bool = False) -> list[Run]:
    """Runs of a campaign file. allow_code: whether Python modules named there or in its scenarios may run.

    Raises LuxloopError with the file, the key and the remedy.
    """
    data = read_toml(file)
    with locate(str(file)):
        params = validate_model(CampaignParams, data, "docs/campaigns.md has an example")
    n_runs = math.prod(map(len, (params.scenarios, params.controllers or [0], params.variants or [0], params.seeds))) + len(params.runs)
    if n_runs > MOST_RUNS:
        raise LuxloopError(f"{file}: names {n_runs:,} runs, more than {MOST_RUNS:,}; split it into several campaigns")
    resolve_paths(params.set, file.parent)
    runs, draws = dict[str, Run](), cache(lambda name: _draws(file, params, name))
    for each in (_run(file, params, one, draws, allow_code) for one in _all(params)):
        if runs.setdefault(each.key, each).scenario.digest != each.scenario.digest:
            raise LuxloopError(f"{file}: two different runs are both called {each.key!r}; rename a scenario's file, or give variants")
    if not runs:
        raise LuxloopError(f'{file}: names no runs; give scenarios = ["snowflake"], or [[runs]]')
    return list(runs.values())


def run_campaign(file: Path, out: Path, *, device: str = "cpu", executor: Executor = ALL_CORES, allow_code: bool = False) -> Results:
    """Run what `out` does not hold yet, and write the table of all runs: rows in the order of the file, each with identity, metrics, and
    `error`, empty on success; with `trajectories` also the table of their steps.

    Raises as `read`, `luxloop.world.plugin.load`, `luxloop.loop.studies.jobs.run` and `luxloop.world.files.output_folder`.
    """
    runs = read(file, allow_code=allow_code)
    with locate(str(file)):
        for key, name in dict.fromkeys(found for each in runs for found in own_names(each.scenario)):
            load_class(name, key, ())
    jobs = [
        Job(
            each.key,
            {
                "scenario": each.scenario.model_dump(mode="json"),
                "inputs": digests(each.scenario),
                "device": device,
                "trajectory": each.trajectory,
            },
        )
        for each in runs
    ]
    if out.is_dir() and any(out.iterdir()) and not (out / JOBS).exists():
        raise LuxloopError(f"{out}: holds files that are no campaign; give an empty or a new folder with --out")
    with output_folder(out):
        results = run(figures_of, jobs, out / JOBS, version=digest_of_code(), executor=executor, title="runs", kind=kind_of)
        given = {"scenario", "inputs", "device", "trajectory", "controller"}  # parameters of a job; the last is a figure of a symbol
        steps = {row["key"]: row.pop("steps_of", {}) for row in results.rows}
        found = {row["key"]: {name: value for name, value in row.items() if name not in {"key", *given}} for row in results.rows}
        rows = [{"key": each.key, **each.row, **found.get(each.key, {}), "error": results.failures.get(each.key, "")} for each in runs]
        columns = list(dict.fromkeys(name for row in rows for name in row))
        results = Results([{name: row.get(name) for name in columns} for row in rows], results.failures)
        results.write(out / TABLE)
        if any(steps.values()):
            write_table(out / TRAJECTORIES, _trajectories(runs, steps))
    return results


def _trajectories(runs: Sequence[Run], steps: Mapping[str, Mapping[str, Mapping[str, Sequence[Any]]]]) -> pa.Table:
    """Steps of all runs, one after the other, with the columns that identify a run. steps: columns by key of a run and held symbol."""
    parts = []
    for each in runs:
        identity = {name: value for name, value in each.row.items() if name in ("scenario", "controller", "variant", "seed")}
        for name, columns in steps.get(each.key, {}).items():
            shown = pa.table(columns)
            same = {key: pa.array([value] * shown.num_rows) for key, value in {**identity, "function": name}.items()}
            parts.append(pa.table({**same, **{key: shown[key] for key in shown.column_names}}))
    table = pa.concat_tables(parts, promote_options="permissive")
    return table.cast(pa.schema([pa.field(each.name, pa.float64() if pa.types.is_null(each.type) else each.type) for each in table.schema]))


def kind_of(parameters: Mapping[str, Any]) -> str | None:
    """Kind of a job, for batches (`luxloop.loop.studies.runs.kind`); jobs of one kind also share files and device."""
    from luxloop.loop.studies.runs import kind

    found = kind(validate(parameters["scenario"], str(parameters["scenario"]["name"])))
    return found and json.dumps([found, parameters["inputs"], parameters["device"]])


def figures_of(parameters: Sequence[Mapping[str, Any]]) -> list[Row | Exception]:
    """Metrics of each scenario of jobs of one kind, with its steps if they are to be written, or the error of its run."""
    found: list[Row | Exception] = []
    for job, done in zip(parameters, runs_of_many(parameters), strict=True):
        if isinstance(done, Exception):
            found.append(done)
        else:
            figures, _, table = done
            held = job["scenario"]["functions"] if job["trajectory"] else {}
            symbols = [name for name, each in held.items() if each.get("controller")]
            found.append({**figures, "steps_of": {name: of_one(table, name).to_pydict() for name in symbols}})
    return found


def runs_of_many(parameters: Sequence[Mapping[str, Any]]) -> "list[Done | Exception]":
    """Figures, trace and table of each run of one kind, or its error.

    parameters: of each run scenario, inputs (`luxloop.loop.recording.manifest.digests` of its files, part of a job's identity) and device.
    """
    from luxloop.loop.studies.runs import runs

    try:
        return list(runs([job_scenario(each["scenario"], each["inputs"]) for each in parameters], parameters[0]["device"]))
    except Exception as error:  # then one by one
        return [error] if len(parameters) == 1 else [found for each in parameters for found in runs_of_many([each])]


def job_scenario(scenario: Mapping[str, Any], inputs: dict[str, str]) -> Scenario:
    """Scenario of a job, to be run with one thread, so that metrics do not depend on the machine.

    Raises LuxloopError if it is invalid, or its files differ on this machine.
    """
    import torch

    torch.set_num_threads(1)
    valid = validate(scenario, str(scenario["name"]))
    here = digests(valid)
    if others := [key for key in inputs | here if inputs.get(key) != here.get(key)]:
        raise LuxloopError(
            f"{valid.name}: {others[0]}: differs here from the file where the run was started, or has changed since; put the same at "
            "the same place on every machine and start again"
        )
    return valid


def _all(params: CampaignParams) -> Iterator[RunParams]:
    grid = product(params.scenarios, params.tables or (None,), params.variants or (None,), params.seeds)
    for scenario, controller, variant, seed in grid:
        yield RunParams(scenario=scenario, controller=controller, variant=variant, seed=seed)
    yield from params.runs


Draws = Mapping[str, ranges.Range | Sequence[Any]]


def _draws(file: Path, params: CampaignParams, name: str) -> Draws:
    """Ranges and lists of the table `draw` by key, for a scenario. Raises LuxloopError with the key and the remedy."""
    scenario, found = load(name, [params.set], allow_code=True), dict[str, ranges.Range | Sequence[Any]]()
    for key, given in _flat(params.draw):
        if isinstance(given, str):
            found[key] = ranges.parse(f"{key}={given}", [scenario], f"{file}: draw")
        elif isinstance(given, list) and given:
            found[key] = given
        else:
            raise LuxloopError(f'{file}: draw.{key}: {given!r} is neither a range nor a list; write for example "1:100" or [1, 2, 3]')
    return found


def _flat(table: Mapping[str, Any], within: str = "") -> Iterator[tuple[str, Any]]:
    """Keys as `--set` takes them, `objects[0].albedo`, and values of nested tables."""
    for name, value in table.items():
        key = within + name if INDEX.fullmatch(name) else f"{within}.{name}".removeprefix(".")
        if isinstance(value, dict):
            yield from _flat(value, key)
        else:
            yield key, value


def _draw(draws: Draws, seed: int) -> dict[str, Any]:
    """Values of a seed by key; each key has its own stream of random numbers, so that another key changes none."""
    found = {}
    for key, each in draws.items():
        rng = np.random.default_rng([seed, *key.encode()])
        found[key] = each.draw(rng) if isinstance(each, ranges.Range) else each[int(rng.integers(len(each)))]
    return found


def _run(file: Path, params: CampaignParams, one: RunParams, draws: Callable[[str], Draws], allow_code: bool) -> Run:
    if one.variant is not None and one.variant not in params.variants:
        raise LuxloopError(f"{file}: runs: there is no variant {one.variant!r}; write its keys below [variants.{one.variant}]")
    changes: list[dict[str, Any]] = [params.set, params.variants[one.variant] if one.variant else {}, {"seed": one.seed}]
    beside = file.parent / one.scenario
    with locate(f"{file}: variants.{one.variant}" if one.variant else str(file)):
        name = str(beside) if os.path.isfile(beside) else one.scenario
        if one.controller:
            held = only(load(name, allow_code=True).symbols)
            changes.insert(0, {"functions": {held: {"controller": {**params.tables.get(one.controller, {"name": one.controller})}}}})
        for each in changes:
            resolve_paths(each, file.parent)
        drawn = _draw(draws(name), one.seed)
        scenario = load(name, [*changes, *(f"{key}={json.dumps(value)}" for key, value in drawn.items())], allow_code=True)
        if not allow_code:  # changes come from a file, too
            refuse_code(scenario, one.scenario)
        return Run(one, scenario, drawn, params.trajectories)
