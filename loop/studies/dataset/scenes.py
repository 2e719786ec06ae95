"""The scenes of a data set: each a scenario from a seed, with keys that its file sets, chooses among or draws from ranges."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field

from luxloop.loop.recording.labels import Labels, Layout
from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import overridden, resolve_paths
from luxloop.loop.studies.ranges import Range, parse, with_values
from luxloop.loop.studies.training.scenes import tables
from luxloop.world.errors import locate
from luxloop.world.params import Params
from luxloop.world.plugin import refuse_code
from luxloop.world.validation import read_toml, validate_model

DRAWING: Final = 3  # of what is drawn for a scene, beside its world


class DatasetParams(Params):
    """A data set: how frames are labelled, and what its scenes have in common and what they vary."""

    labels: Layout = Field("coco", description="layout of the labels")
    masks: bool = Field(False, description="whether there are masks of instances and parts")
    depth: bool = Field(False, description="whether there is the depth at each pixel")
    lux: bool = Field(False, description="whether there is the illuminance from the headlamps at each pixel")
    seed: int = Field(0, ge=0, lt=2**31, description="seed of the first scene; the next ones have the next seeds")
    steps: int = Field(1, ge=1, le=1000, description="frames of a scene")
    rate_hz: float = Field(1.0, ge=0.1, le=1000, description="frames a second")
    set: dict[str, Any] = Field({}, description="keys of every scene, written as in a scenario file")
    variants: dict[str, dict[str, Any]] = Field(
        {}, description="named tables of further keys, one of which each scene has; left out: one variant without changes"
    )
    vary: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        (), description="keys with ranges, from which each scene draws a number: key=low:high, or key=low:high:log"
    )


@dataclass(frozen=True)
class DatasetScene:
    """A scene of a data set. variant: its name, empty for none. drawn: numbers from ranges, by key."""

    seed: int
    variant: str
    drawn: Mapping[str, float | int]
    scenario: Scenario

    @property
    def name(self) -> str:
        return f"{self.seed:06d}"


@dataclass(frozen=True)
class Dataset:
    """What a file says of a data set, and its scenes."""

    labels: Labels
    scenes: tuple[DatasetScene, ...]


def read(file: Path, number: int, *, allow_code: bool = False) -> Dataset:
    """The first scenes of a data set. allow_code: whether Python modules that its file names may run.

    Raises LuxloopError that names the file, the key and the remedy.
    """
    data = read_toml(file)
    with locate(str(file)):
        params = validate_model(DatasetParams, data, "docs/data.md has an example")
        for each in (params.set, *params.variants.values()):
            resolve_paths(each, file.parent)
        first = tuple(_scenario(params, params.seed, variant) for variant in params.variants or [""])
        if not allow_code:
            for scenario in first:
                refuse_code(scenario, scenario.source)
        ranges = tuple(parse(each, first, "vary") for each in params.vary)
        labels = Labels(params.labels, params.masks, params.depth, params.lux)
        return Dataset(labels, tuple(_scene(params, ranges, params.seed + k) for k in range(number)))


def _scene(params: DatasetParams, ranges: tuple[Range, ...], seed: int) -> DatasetScene:
    rng, names = np.random.default_rng([seed, DRAWING]), [*params.variants] or [""]
    variant = names[int(rng.integers(len(names)))]
    drawn = {each.key: each.draw(rng) for each in ranges}
    scenario = _scenario(params, seed, variant)
    return DatasetScene(seed, variant, drawn, with_values(scenario, drawn) if drawn else scenario)


def _scenario(params: DatasetParams, seed: int, variant: str) -> Scenario:
    name = f"scene {seed}"
    own = {"name": name, "steps": params.steps, "rate_hz": params.rate_hz, "seed": seed, "lighting": {}}
    data = validate({**own, **tables(seed)}, name).model_dump(mode="json")
    with locate(f"variants.{variant}" if variant else "set"):
        return validate(overridden(data, [params.set, params.variants[variant] if variant else {}]), name)


def facts(scene: DatasetScene) -> dict[str, Any]:
    """What a data set says of a scene."""
    return {"seed": scene.seed, "variant": scene.variant, "drawn": dict(scene.drawn)}
