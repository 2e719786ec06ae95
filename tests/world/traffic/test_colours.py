"""Colours of traffic: none changes luminance, and lamps, signs and vests are what they are known by."""

import pytest

from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.scene.body import Part
from luxloop.world.traffic.colours import GRASS, SKY, colour


def coloured(name: str, material: str, albedo: float = 0.1, owner: str = "one", banded: bool = False) -> tuple[float, float, float]:
    return colour(owner, Part(name, albedo, material), banded)


@pytest.mark.parametrize("material", ["skin", "hair", "cloth", "car_paint", "leaves", "tail_lamp", "glass", "retroreflective_sign"])
def test_colours_have_luminance_1(material):
    for rgb in (coloured("body", material), GRASS, SKY):
        assert sum(weight * value for weight, value in zip(LUMINANCE, rgb, strict=True)) == pytest.approx(1)


def test_parts_have_the_colours_that_they_are_known_by():
    red, green, blue = coloured("tail_lamps", "retroreflective_sign")
    assert red > 5 * max(green, blue)
    red, green, blue = coloured("border", "retroreflective_sign", 0.1)
    assert red > 5 * max(green, blue)
    red, green, blue = coloured("face", "retroreflective_sign", 0.1)
    assert blue > 2 * max(red, green)
    assert coloured("face", "retroreflective_sign", 0.5) == pytest.approx((1, 1, 1)), "a white face has no hue"
    red, green, blue = coloured("jacket", "cloth", 0.6, banded=True)
    assert green > red > blue
    assert coloured("jacket", "cloth") == coloured("jacket", "cloth"), "a person keeps the clothes"
    assert len({coloured("jacket", "cloth", owner=f"person_{k}") for k in range(40)}) > 3
