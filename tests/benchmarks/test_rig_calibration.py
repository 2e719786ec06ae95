"""A lamp is digitised within the bounds that docs/rig_calibration.md names, also with effects that the calibration does not model."""

from dataclasses import replace
from pathlib import Path

import bench
import numpy as np
import pytest
import rig_calibration
import scipy.sparse as sp
from rig_bench import Rig, rig
from rig_calibration import digitise, figures, uneven_wall

from luxloop.loop.rig.calibration.digitise import ModuleMeasurement
from tests.refusal import refusal

GIVEN = bench.cases(rig_calibration.measure)
STUCK = 433


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Rig]:
    """A lamp of 20 x 40 pixels; every seventh lies at the border, where blur takes light out of the field. One is stuck in "nothing"."""
    scenario = uneven_wall(GIVEN, "small", tmp_path_factory.mktemp("lamp"))
    rigs = {name: rig(scenario, **GIVEN.cases[name], fine=3) for name in ("nothing", "all four")}
    bench = rigs["nothing"].bench
    (seen,) = bench.transports
    switched = sp.diags_array(np.where(np.arange(seen.shape[1]) == STUCK, 0, 1).astype(np.float32))
    base = bench.base + seen[:, [STUCK]].toarray().reshape(bench.shape)
    return rigs | {"nothing": replace(rigs["nothing"], bench=replace(bench, transports=(sp.csr_array(seen @ switched),), base=base))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shots")


@pytest.fixture(scope="module")
def found(small: dict[str, Rig], folder: Path) -> dict[str, ModuleMeasurement]:
    return {name: digitise(of, folder if name == "nothing" else None) for name, of in small.items()}


@pytest.mark.parametrize(("case", "stuck"), [("nothing", [STUCK]), ("all four", [])])
def test_a_small_lamp_with_dead_and_stuck_pixels(small, found, case, stuck):
    px, one, _, turned, *_ = figures(small[case], found[case]).values()
    assert px < 0.1 and one < 2.0 and turned < 0.05
    assert np.flatnonzero(found[case].dead).tolist() == [266, 405] and np.flatnonzero(found[case].stuck).tolist() == stuck


def test_measurement_goes_on_where_it_stopped(small, found, folder):
    of, kept = small["nothing"], sorted(folder.glob("*.png"))
    dark = replace(of.bench, transports=tuple(0 * each for each in of.bench.transports))
    from_folder = digitise(replace(of, bench=dark), folder)  # this lamp gives no light: every frame is from the folder
    for each in kept[::7]:
        each.unlink()
    again = digitise(of, folder)
    assert sorted(folder.glob("*.png")) == kept
    for each in (from_folder, again):
        np.testing.assert_array_equal(each.measured.intensity, found["nothing"].measured.intensity)


@pytest.mark.parametrize(("gain", "message"), [(0, "sees none of its pixels"), (100, "saturated at its shortest exposure")])
def test_a_dark_lamp_and_a_saturated_camera_are_told(small, gain, message):
    of = small["all four"]
    with refusal(message):
        digitise(replace(of, bench=replace(of.bench, transports=tuple(gain * each for each in of.bench.transports))))


@pytest.mark.slow
def test_hd_lamp(tmp_path):
    """The goals: places within 0.1 px, intensities within 2 % rms."""
    of = rig(uneven_wall(GIVEN, "hd", tmp_path))
    px, one, *_ = figures(of, digitise(of)).values()
    assert px < 0.1 and one < 2.0
