"""A lamp is digitised within the bounds that docs/rig_calibration.md names, also with effects that the calibration does not model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from rig_bench import Rig, model, rig, wall
from rig_calibration import CASES, figures, lamp, measured

from luxloop.world.errors import LuxloopError


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rig]:
    light, camera = lamp("small")
    scenario = wall(model(tmp_path_factory.mktemp("lamp") / "small.npz", light), camera.pop("width"), camera.pop("height"), **camera)
    return {name: replace(rig(scenario, CASES[name], 3), light=light) for name in ("nothing", "all four")}


@pytest.mark.parametrize("case", ["nothing", "all four"])
def test_small_lamp(small: dict[str, Rig], case: str) -> None:
    """Of 20 x 40 pixels, every seventh lies at the border, where blur takes light out of the field."""
    found = measured(small[case])
    px, one, _, turned, *_ = figures(small[case], found)
    assert px < 0.1
    assert one < 2.0
    assert turned < 0.05
    assert np.argwhere(found.dead.ravel()).ravel().tolist() == [266, 405]
    assert not found.stuck.any()


def test_stuck_pixel_is_told_from_a_dead_one(small: dict[str, Rig]) -> None:
    of = small["nothing"]
    (seen,) = of.bench.transports
    lit = seen[:, [433]].toarray().reshape(of.bench.shape)
    switched = sp.diags_array(np.where(np.arange(seen.shape[1]) == 433, 0, 1).astype(np.float32))
    stuck = replace(of.bench, transports=(sp.csr_array(seen @ switched),), base=of.bench.base + lit)
    found = measured(replace(of, bench=stuck))
    assert np.flatnonzero(found.stuck).tolist() == [433]
    assert np.flatnonzero(found.dead).tolist() == [266, 405]


def test_measurement_goes_on_where_it_stopped(small: dict[str, Rig], tmp_path: Path) -> None:
    of = small["nothing"]
    measured(of, tmp_path)
    kept = sorted(tmp_path.glob("*.png"))
    for each in kept[::7]:
        each.unlink()
    dark = replace(of.bench, transports=tuple(0 * each for each in of.bench.transports))
    again = measured(of, tmp_path)
    assert sorted(tmp_path.glob("*.png")) == kept
    all_kept = measured(replace(of, bench=dark), tmp_path)  # this lamp gives no light: every frame is from the folder
    np.testing.assert_array_equal(all_kept.measured.intensity, again.measured.intensity)


def test_a_dark_lamp_and_a_saturated_camera_are_told(small: dict[str, Rig]) -> None:
    of = small["nothing"]
    dark = replace(of.bench, transports=tuple(0 * each for each in of.bench.transports))
    with pytest.raises(LuxloopError, match="sees none of its pixels"):
        measured(replace(of, bench=dark))
    bright = replace(of.bench, transports=tuple(100 * each for each in of.bench.transports))
    with pytest.raises(LuxloopError, match="saturated at its shortest exposure"):
        measured(replace(of, bench=bright))


@pytest.mark.slow
def test_hd_lamp(tmp_path: Path) -> None:
    """The goals: places within 0.1 px, intensities within 2 % rms."""
    light, camera = lamp("hd")
    scenario = wall(model(tmp_path / "hd.npz", light), camera.pop("width"), camera.pop("height"), **camera)
    of = replace(rig(scenario, CASES["nothing"], 2), light=light)
    px, one, *_ = figures(of, measured(of))
    assert px < 0.1
    assert one < 2.0
