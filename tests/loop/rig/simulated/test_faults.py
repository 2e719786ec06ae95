"""Faults come from a file and from the command line, and mistakes in them are told."""

import pytest

from luxloop.loop.rig.simulated.faults import FaultParams, read
from luxloop.loop.scenario.shipped import examples
from tests.refusal import refusal


def test_a_file_and_changes_make_faults(tmp_path):
    (file := tmp_path / "mine.toml").write_text("[lens]\nblur_px = 1.0\n[camera]\nloss = 0.1\n")
    faults = read(file, ["faults.lens.veil=0.1", "faults.camera.loss=0.2", "faults.lens.coefficients=[-0.1]"])
    assert (faults.lens.blur_px, faults.lens.veil, faults.camera.loss, faults.lens.coefficients) == (1.0, 0.1, 0.2, (-0.1,))
    assert read(None) == FaultParams()


def test_the_shipped_example_has_a_little_of_everything():
    faults = read(examples()["rig_faults.toml"])
    assert all(getattr(faults, table) != getattr(FaultParams(), table) for table in FaultParams.model_fields if table != "board")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[lens]\nblur = 1", r"mine.toml: lens.blur: unknown key.*blur_px"),
        ("[lens]\nblur_px = -1", r"mine.toml: lens.blur_px: "),
        ('[lens]\nmodel = "division"\ncoefficients = [0.1, 0.2]', r"coefficients: the model division has 1, not 2; leave out the others"),
        ("lens", r"mine.toml: not valid TOML"),
    ],
)
def test_mistakes_are_told(text, message, tmp_path):
    (file := tmp_path / "mine.toml").write_text(text)
    with refusal(message):
        read(file)
    with refusal(r"--set faults.lens.blurr=1: lens.blurr: unknown key"):
        read(None, ["faults.lens.blurr=1"])
