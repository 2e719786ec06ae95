"""Every number that a file may give has a range, so that none is beyond what can be computed with."""

from collections.abc import Iterator
from typing import Any

import pytest

from luxloop import LuxloopError, Scenario, load
from luxloop.loop.studies.campaign import CampaignParams
from luxloop.world.lamps.description import LampDescription

LEAST, MOST = ("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum")


def numbers(schema: Any, place: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The schema of each number in a schema, by where it stands."""
    if isinstance(schema, dict):
        if schema.get("type") in ("number", "integer") and not {"const", "enum"} & schema.keys():
            yield place, schema
        for key, value in schema.items():
            yield from numbers(value, f"{place}.{key}")
    elif isinstance(schema, list):
        for each in schema:
            yield from numbers(each, place)


@pytest.mark.parametrize("model", [Scenario, LampDescription, CampaignParams])
def test_every_number_has_a_range(model):
    found = dict(numbers(model.model_json_schema(), model.__name__))
    endless = [place for place, schema in found.items() if not ({*LEAST} & schema.keys() and {*MOST} & schema.keys())]
    assert found and not endless


@pytest.mark.parametrize(
    ("scenario", "given", "words"),
    [
        ("flat", "camera.read_noise_e=1e200", "camera.read_noise_e"),
        ("flat", "camera.exposure_s=1e-300", "camera.exposure_s"),
        ("flat", "camera.saturation_e=1e-300", "too close to 0"),
        ("flat", "rate_hz=1e-300", "rate_hz"),
        ("flat", "functions.symbol.start.x_m=nan", "functions.symbol.start.x_m"),
        ("flat", "functions.symbol.width_m=inf", "functions.symbol.width_m"),
        ("zones", "functions.crossing.pid.kp=1e300", "kp"),
        ("flat", "objects=[{kind='box', name='a', size_m=[1e300, 1, 1], position_m=[9, 0, 0]}]", "size_m"),
        (
            "flat",
            "camera={width_px=8192, height_px=8192, oversampling=16}",
            "camera: 8192 x 8192 px of 16 samples would take at least 376 GB",
        ),
    ],
)
def test_numbers_beyond_all_reason_are_told_by_their_key(scenario, given, words):
    with pytest.raises(LuxloopError) as error:
        load(scenario, [given])
    assert words in str(error.value)
