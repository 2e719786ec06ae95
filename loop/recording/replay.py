"""Loads recordings, replays them with their edits and compares the results, writes them as CSV; edits a running simulation."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.csv
import torch
from pydantic import BaseModel, TypeAdapter
from torch import Tensor

from luxloop.controllers.symbol.sensing.symbol_sensor import FeatureParams
from luxloop.loop.recording.comparison import Comparison, differences
from luxloop.loop.recording.manifest import EDITS, MANIFEST, TRAJECTORY, Manifest, table_of
from luxloop.loop.recording.record import refuse_unknown_columns, row, schema
from luxloop.loop.scenario.driving import repeat
from luxloop.loop.scenario.edits import Edit, acts, overrides_between
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import TAGS
from luxloop.loop.simulation.evaluator import Evaluation
from luxloop.loop.simulation.result import SimulationState
from luxloop.loop.simulation.simulated import SimulatedPlant, driven_plant
from luxloop.loop.simulation.simulation import Simulation
from luxloop.world.arrays import read_parquet
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import content, reading, whole
from luxloop.world.plugin import refuse_code
from luxloop.world.validation import parsed_json


def apply_edit(
    simulation: Simulation, state: SimulationState, scenario: Scenario, reached_by: Scenario | None = None
) -> tuple[Simulation, SimulationState]:
    """The simulation with another scenario, and its state before the next step.

    state: after the last step. reached_by: scenario of the simulation that did the last step, by default the simulation's own; so several
    edits between two steps act as one. Functions and controllers keep their states if their kinds and the shapes of their states are the
    same, others start anew. Frames in transit show the scene at their exposures. Raises LuxloopError as `luxloop.loop.run.prepare`, and
    where the scenario needs a simulation that starts anew.
    """
    reached_by = reached_by or simulation.scenario
    if acts(simulation.scenario, scenario) == "restart":
        raise LuxloopError(f"{scenario.source}: a run cannot go on with these values; start it anew")
    driven = continue_course(simulation, scenario)
    if driven is not None and reached_by is simulation.scenario:
        return driven, state
    after = driven or Simulation.prepare(scenario, simulation.device, simulation)
    if scenario.plant.kind != "simulated":
        after = replace(after, plant=simulation.plant)  # it may hold a connection or devices
    if (scenario.checks, scenario.functions) != (simulation.scenario.checks, simulation.scenario.functions):
        refuse_unknown_columns(after)
    symbols = {name: each.start() for name, each in after.controlled.items()}
    same = {name for name, each in scenario.functions.items() if _alike(reached_by.functions.get(name), each)}
    functions, symbols = _continue_states(after.planner.start(), state.functions, same), _continue_states(symbols, state.symbols, same)
    commanded = {name: each for name, each in state.commanded.items() if name in after.planner.commanding}
    return after, replace(state, functions=functions, symbols=symbols, commanded=commanded)


def _continue_states(fresh: Mapping[str, Any], old: Mapping[str, Any], same: Collection[str]) -> dict[str, Any]:
    return {name: old[name] if name in same and name in old and _fits(old[name], each) else each for name, each in fresh.items()}


def _alike(a: Any, b: Any) -> bool:
    """Whether two values of parameters are of the same variant, with all tables in them."""
    if not (isinstance(a, BaseModel) or isinstance(b, BaseModel)):
        return True
    return type(a) is type(b) and all(each == getattr(b, key) if key in TAGS else _alike(each, getattr(b, key)) for key, each in a)


def _fits(old: Any, fresh: Any) -> bool:
    """Whether a state has the types and shapes of a fresh one; None, for values unknown at first, fits any."""
    if fresh is None or old is None:
        return True
    if type(old) is not type(fresh):
        return False
    if isinstance(old, Tensor):
        return old.shape == fresh.shape
    if is_dataclass(old):
        old, fresh = (tuple(getattr(state, each.name) for each in fields(old)) for state in (old, fresh))
    return not isinstance(old, tuple) or len(old) != len(fresh) or all(map(_fits, old, fresh))


def continue_course(simulation: Simulation, scenario: Scenario) -> Simulation | None:
    """The simulation with a scenario that differs only in the course of a driven vehicle and in the number of steps; None for any other."""
    before, plant = simulation.scenario, simulation.plant
    if before.vehicle is None or scenario.vehicle is None or not scenario.vehicle.roams or not isinstance(plant, SimulatedPlant):
        return None
    vehicle = before.vehicle.model_copy(update={"course": scenario.vehicle.course})
    if before.model_copy(update={"vehicle": vehicle, "steps": scenario.steps}) != scenario:
        return None
    cache = simulation.cache.copy()
    plant, controlled = driven_plant(plant, scenario, cache), {}
    for name, each in simulation.controlled.items():
        if (evaluator := each.evaluator) is not None:
            evaluator = replace(evaluator, world=plant.world)
        controlled[name] = replace(each, evaluator=evaluator)
    cache.end()
    return replace(simulation, scenario=scenario, plant=plant, controlled=controlled, cache=cache)


@dataclass(frozen=True)
class Recording:
    """A recording: manifest, scenario, table of the steps, and edits during the run."""

    manifest: Manifest
    scenario: Scenario
    table: pa.Table
    edits: tuple[Edit, ...] = ()


EDIT_LIST: Final = TypeAdapter(tuple[Edit, ...])


def load(directory: Path) -> Recording:
    """Read a recording. Raises LuxloopError where the directory is none, is damaged, or was written by a newer luxloop."""
    manifest = Manifest.read(directory)
    scenario = validate(manifest.scenario, f"{directory}/manifest.json: scenario")
    table, file = read_parquet(directory / TRAJECTORY), directory / EDITS
    with reading(file, "damaged, not the edits of a run", "record the run again"):
        edits = EDIT_LIST.validate_python(parsed_json(content(file)) if file.is_file() else ())
    return Recording(manifest, scenario, table, edits)


def load_to_rerun(directory: Path, allow_code: bool) -> Recording:
    """Read a recording with at least one step. Raises LuxloopError as `load`, and where it names a Python module that may not run."""
    recording = load(directory)
    if recording.table.num_rows == 0:
        raise LuxloopError(f"{directory / TRAJECTORY}: holds no step; record the run again")
    if not allow_code:
        refuse_recorded_code(directory, recording.scenario, recording.edits)
    return recording


def refuse_recorded_code(directory: Path, scenario: Scenario, edits: Iterable[Edit]) -> None:
    """Raises LuxloopError where a recording's scenario or one of the edits names a Python module."""
    refuse_code(scenario, str(directory / MANIFEST))
    for edit in edits:
        scenario = repeat(scenario, edit)
        if not edit.driven:
            refuse_code(scenario, str(directory / EDITS))


def rerun(recording: Recording, simulation: Simulation) -> Iterator[tuple[Simulation, Evaluation]]:
    """Run the steps of a recording again; yields each with the simulation that did it. simulation: of the recording's scenario.

    Modules that edits name run. Raises LuxloopError where an edit cannot be repeated.
    """
    state, edits, before = simulation.start(), deque(recording.edits), None
    for step in range(recording.table.num_rows):
        reached, by = state, simulation.scenario
        while edits and edits[0].step <= step:
            simulation, state = apply_edit(simulation, reached, repeat(simulation.scenario, edits.popleft()), by)
        with locate(simulation.scenario.source):
            state, result = simulation.step(state)
            before = simulation.evaluate(result, before)
        yield simulation, before


def replay(
    directory: Path | str,
    device: torch.device | str | None = None,
    on_step: Callable[[Evaluation], None] = lambda result: None,
    *,
    allow_code: bool = False,
) -> Comparison:
    """Run the recording in a directory again with its edits, and compare the steps.

    device: by default the recording's, or the CPU where there is no such device. on_step: called after every step. allow_code: whether
    modules that the manifest or edits name may run. Raises LuxloopError where the recording is damaged or an input file is missing.
    """
    directory = Path(directory)
    recording = load_to_rerun(directory, allow_code)
    manifest, scenario = recording.manifest, recording.scenario
    here = "cuda" if manifest.device.startswith("cuda") and torch.cuda.is_available() else "cpu"
    simulation = Simulation.prepare(scenario, device or here)
    columns = schema(simulation)
    columns_of(recording.table, columns, directory / TRAJECTORY)
    notes = manifest.changes(Manifest.of(scenario, simulation.renderer, simulation.device))
    features = dict[str, FeatureParams]()
    rows = []
    for edited, result in rerun(recording, simulation):
        features |= {name: symbol.function.features for name, symbol in edited.controlled.items()}
        columns = pa.unify_schemas([columns, schema(edited)])
        known = set(columns.names)  # columns that an edit adds begin with the edit
        rows.append({name: value for name, value in row(result).items() if name in known})
        on_step(result)
    recorded = columns_of(recording.table, columns, directory / TRAJECTORY)
    return Comparison(len(rows), differences(recorded, table_of(rows, columns), features), tuple(notes))


def compare(first: Path | str, second: Path | str) -> Comparison:
    """Compare two recordings of scenarios with the same columns, without running them: differences of the second from the first.

    A note names the keys in which the scenarios differ.

    Raises LuxloopError where a recording is damaged, or a column of the second is missing in the first.
    """
    a, b = (load(Path(each)) for each in (first, second))
    features = {name: each.features for name, each in a.scenario.symbols.items()}
    here = columns_of(a.table, b.table.schema, Path(first) / TRAJECTORY, f"compare it with a recording of the same scenario, not {second}")
    changed = ", ".join(overrides_between(a.manifest.scenario, b.manifest.scenario))
    notes = (*([f"the scenario differs: {second} has {changed}"] if changed else []), *a.manifest.changes(b.manifest))
    return Comparison(a.table.num_rows, differences(here, b.table, features), notes)


def columns_of(table: pa.Table, columns: pa.Schema, file: Path, remedy: str = "record the run again") -> pa.Table:
    """Selected columns of a recording. remedy: for a missing column. Raises LuxloopError where one is missing or has another type."""
    if missing := [name for name in columns.names if name not in table.column_names]:
        raise LuxloopError(f"{file}: the column {missing[0]!r} is missing; {remedy}")
    try:
        return table.select(columns.names).cast(columns)
    except (pa.ArrowException, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise LuxloopError(f"{file}: a column is not of its type ({reason}); record the run again") from error


def to_csv(directory: Path, file: Path) -> None:
    """Write a recording as CSV, whole or not at all; null is an empty field. Raises LuxloopError where the file cannot be written."""
    table = load(directory).table
    with whole(file) as part:
        pyarrow.csv.write_csv(table, part)
