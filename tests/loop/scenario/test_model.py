"""Scenario files: what is in them is what runs."""

import json
from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args, get_origin

import pytest
import torch
from pydantic import BaseModel, TypeAdapter

from luxloop import LuxloopError, Scenario, load, validate
from luxloop.controllers.symbol import HeightControllerParams
from luxloop.loop.scenario.shipped import scenario_files
from luxloop.world.plugin import Name
from tests.loop.scenario.files import BOX, GOOD, LIT
from tests.refusal import refusal


def test_manifest_gives_the_same_scenario_back(file):
    file.write_text(GOOD + BOX)
    scenario = load(str(file))
    again = validate(json.loads(json.dumps(scenario.model_dump(mode="json"))), "manifest.json")
    assert again == scenario
    assert again.digest == scenario.digest
    assert scenario.digest != load(str(file), ["seed=1"]).digest


@pytest.mark.parametrize("name", scenario_files())
def test_shipped_scenarios_are_valid_and_named_like_their_files(name):
    scenario = load(name)
    assert scenario.name == name
    assert scenario.description


def test_every_key_is_described():
    def described(schema: dict[str, object]) -> None:
        for key, value in schema.get("properties", {}).items():  # type: ignore[attr-defined]
            assert "description" in value or "const" in value, key

    schema = Scenario.model_json_schema()
    described(schema)
    for inner in schema["$defs"].values():
        described(inner)


def tables_of(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for field in annotation.model_fields.values():
            yield from tables_of(field.annotation)
    for inner in get_args(annotation):
        yield from tables_of(inner)


def test_every_key_that_may_be_missing_has_an_example_that_is_possible():
    """Keys that tell variants apart excepted: a table without one is none of them."""
    for table in set(tables_of(Scenario)):
        for key, field in table.model_fields.items():
            if field.is_required() and get_origin(field.annotation) is not Literal and field.annotation is not Name:
                assert field.examples, f"{table.__name__}.{key}"
                TypeAdapter(Annotated[field.annotation, field]).validate_python(field.examples[0])


def test_a_name_alone_is_a_scenario_of_darkness(file):
    file.write_text('name = "x"')
    scenario = load(str(file))
    assert (scenario.functions, scenario.lighting.base.beam, scenario.symbols) == ({}, "off", {})
    assert (scenario.headlight.model, scenario.headlight.lamps, scenario.headlight.modules) == ("ssl-hd", ("left", "right"), None)
    with refusal("symbols that a controller holds: none, where exactly one is needed"):
        _ = scenario.symbol


def test_functions_are_given_with_or_without_a_controller(file):
    file.write_text(GOOD + LIT.partition("\n")[2] + '[functions.own]\nkind = "symbol"\nimage = "mine.svg"\n')
    scenario = load(str(file), ["lighting.power_limit=0.5"], steps=2)
    assert (scenario.steps, scenario.lighting.power_limit, scenario.lighting.base.beam) == (2, 0.5, "low")
    assert scenario.functions["own"].image == str(file.parent / "mine.svg")  # type: ignore[union-attr]
    assert tuple(scenario.symbols) == ("symbol",) and scenario.symbol.controller == HeightControllerParams()
    assert validate(json.loads(json.dumps(scenario.model_dump(mode="json"))), "manifest.json") == scenario
    both = load(str(file), ["functions.own.controller=open"])
    assert tuple(both.symbols) == ("own", "symbol")
    with refusal("symbols that a controller holds: own, symbol, where exactly one is needed"):
        _ = both.symbol


def test_traffic_follows_the_drive():
    traffic, course = {"seed": 3}, [{"speed_m_s": 14.0}]
    standing = validate({"name": "night", "traffic": traffic}, "standing")
    driving = validate({"name": "night", "steps": 300, "traffic": traffic, "vehicle": {"course": course}}, "driving")
    assert standing.traffic is not None and standing.all_objects == standing.traffic.objects()
    assert driving.vehicle is not None and driving.all_objects == standing.traffic.along(driving.vehicle, 10.0)
    assert len(driving.all_objects) > len(standing.all_objects) and all(each.on_road for each in driving.all_objects)


def test_a_warm_lamp_takes_more_power_for_its_flux():
    headlight = load("obl", ["headlight.thermal_k_w=2", "headlight.efficacy_loss_percent_k=0.5"]).headlight
    power_w = headlight.power_w(400.0) - headlight.standby_w
    assert power_w > 400.0 / 40.0
    assert 40.0 * (1 - 0.005 * 2 * power_w) * power_w == pytest.approx(400.0)  # flux at 2 K/W times its power over the air
    assert load("obl").headlight.power_w(400.0) == 5.0 + 400.0 / 40.0  # junctions stay cold by default
    with pytest.raises(LuxloopError, match="a lamp of 1001 lm gets too hot to give more than 1000 lm; lower thermal_k_w"):
        headlight.power_w(1001.0)


def test_pixels_dimmed_by_current_follow_a_data_sheet():
    """LedEngin LZ1-00NW05: 240 lm and 3.8 V at 1.5 A, 190 lm and 3.6 V at 1 A; by pulse width power falls as the flux does."""
    full, share = 240 / (1.5 * 3.8), torch.tensor([190 / 240])  # lm/W
    took_w = load("obl", ["headlight.droop=1.3"]).headlight.at_full_current(share) * 240 / full
    assert took_w.item() == pytest.approx(1.0 * 3.6, rel=0.02)
    assert load("obl").headlight.at_full_current(share) is share
