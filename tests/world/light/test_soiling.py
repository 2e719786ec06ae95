"""Soiled glass before a camera and a lamp: what its spots cover, and that light is neither made nor lost but by absorption."""

import pytest
import torch

from luxloop.world.light.soiling import SoilingParams, transmission
from tests.world.light.test_volumetric import uniform

SCENE = torch.rand(2, 90, 160, generator=torch.Generator().manual_seed(0)).square()


@pytest.mark.parametrize("coverage", [0.1, 0.5, 1.0])
def test_spots_cover_their_share(coverage):
    passing = transmission(coverage, 0.25, 0.05, 180, 320, 3)
    assert float(passing.double().mean()) == pytest.approx(1 - coverage * 0.75, abs=2e-4)
    assert float(passing.min()) == pytest.approx(0.25, abs=0.1)


def test_spots_that_let_everything_through_change_nothing():
    assert torch.equal(SoilingParams(coverage=0.5, transmission=1.0).through(SCENE), SCENE)


@pytest.mark.parametrize("coverage", [0.1, 0.5, 1.0])
def test_ice_scatters_what_it_takes(coverage):
    ice = SoilingParams(coverage=coverage, absorption=0.0)
    behind = ice.through(SCENE)
    torch.testing.assert_close(behind.sum((-2, -1)), SCENE.sum((-2, -1)), rtol=1e-5, atol=0)
    assert bool((behind.std((-2, -1)) < SCENE.std((-2, -1))).all()), "with less contrast"
    torch.testing.assert_close(ice.through(torch.ones(90, 160)), torch.ones(90, 160))


def test_dirt_absorbs_its_share():
    dirt = SoilingParams(coverage=0.3, transmission=0.4, absorption=1.0)
    even = dirt.through(torch.ones(90, 160))
    assert float(even.mean()) == pytest.approx(1 - 0.3 * 0.6, abs=2e-4)
    torch.testing.assert_close(dirt.through(SCENE), SCENE * even)


def test_a_soiled_cover_takes_from_directions():
    lamp, dirt = uniform().headlight, SoilingParams(coverage=0.5, transmission=0.2, spot=0.3, seed=1)
    clear, behind = (each.light_texture(torch.ones(each.n_pixels)) for each in (lamp, dirt.cover(lamp, 0)))
    share = behind / clear
    assert 0.2 - 1e-6 <= float(share.min()) < 0.5 < float(share.max()) <= 1
    assert not torch.equal(dirt.cover(lamp, 1).light_texture(torch.ones(lamp.n_pixels)), behind), "lamps are soiled each in its way"


def test_clean_glass_changes_nothing():
    lamp = uniform().headlight
    assert SoilingParams().cover(lamp, 0) is lamp
    assert SoilingParams().through(SCENE) is SCENE
