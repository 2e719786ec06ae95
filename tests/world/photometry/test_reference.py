"""Real and odd files against facts that other readers found (see the data's own README)."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxloop.world.photometry import Photometry, read_photometry

IES = [
    *("defined", "defined_diffuse", "display", "examp1", "medium_scatter", "parallel_beam", "three_lobe_vee"),
    *("tilt_include_geometry3", "type_a_symmetric", "type_b_full"),
]
LDT = ["sample4", "sample5", "sample8"]
RTOL = 1e-6  # the goal; the reference is rounded to ten digits


def facts(data_dir: Path, name: str) -> tuple[Photometry, dict[str, Any]]:
    return read_photometry(data_dir / "ies" / name), json.loads((data_dir / "ies" / "reference.json").read_text("utf-8"))["files"][name]


@pytest.mark.parametrize("name", IES)
def test_lm63(data_dir, name):
    p, expected = facts(data_dir, f"{name}.ies")
    d = p.distribution
    assert d.type == expected["photometry_type"] and p.lamps == expected["lamps"] and p.tilt == expected["tilt"]
    assert (p.lumens_per_lamp if p.lumens_per_lamp is not None else -1) == expected["lumens_per_lamp"]
    assert [p.multiplier, p.ballast_factor, p.field_12, p.watts] == pytest.approx(
        [expected[key] for key in ("candela_multiplier", "ballast_factor", "field_12", "watts")], rel=RTOL
    )
    assert p.feet == (expected["units_of_dimensions"] == "feet")
    np.testing.assert_allclose(np.array(p.size_m) / (0.3048 if p.feet else 1), expected["width_length_height"], rtol=RTOL)
    assert d.candela.shape == (expected["n_horizontal_angles"], expected["n_vertical_angles"])
    for angles, key in ((d.vertical_deg, "vertical_first_last"), (d.horizontal_deg, "horizontal_first_last")):
        assert [angles[0], angles[-1]] == expected[key]
    assert d.candela.max() == pytest.approx(expected["max_candela"], rel=RTOL)
    assert d.at(*expected["max_at_vertical_horizontal"]) == pytest.approx(expected["max_candela"], rel=RTOL)
    assert d.candela.sum() == pytest.approx(expected["sum_of_candela_table"], rel=RTOL)
    for key in ("candela_at_nodes", "candela_bilinear"):
        v, h, candela = np.array(expected[key]["rows"]).T
        np.testing.assert_allclose(d.at(v, h), candela, rtol=RTOL)
    if "tilt_data" in expected:
        assert p.tilt_factors.geometry == expected["tilt_data"]["geometry"]
        np.testing.assert_array_equal(p.tilt_factors.factors, expected["tilt_data"]["factors"])


@pytest.mark.parametrize(
    ("name", "words"),
    [("defined_diffuse", "'END'"), ("display", "no version line"), ("examp1", "line 2"), ("type_a_symmetric", "mirrored")],
)
def test_odd_files_warn(data_dir, name, words):
    p, _ = facts(data_dir, f"{name}.ies")
    assert any(words in warning for warning in p.warnings)


@pytest.mark.parametrize("name", LDT)
def test_eulumdat(data_dir, name):
    p, expected = facts(data_dir, f"{name}.ldt")
    d, klm = p.distribution, expected["lamp_flux_lm"][0] / 1000
    assert d.candela.shape == (expected["stored_planes"], expected["Ng"]) and p.watts == expected["watts"][0]
    assert p.absolute == (expected["lamps"][0] < 0)
    assert d.candela.max() == pytest.approx(expected["max_candela"], rel=RTOL)
    for plane, gamma, value in expected["stored_values"]["rows"]:
        assert d.candela[plane, np.flatnonzero(d.vertical_deg == gamma)[0]] == pytest.approx(value * klm, rel=RTOL)
    c, gamma, value = np.array(expected["full_values"]["rows"]).T
    np.testing.assert_allclose(d.at(gamma, c), value * klm, rtol=RTOL)
    # The makers' own light output ratio, by an integration of theirs: it agrees to 0.1 %.
    assert d.luminous_flux == pytest.approx(expected["lamp_flux_lm"][0] * expected["LOR_percent"] / 100, rel=1e-3)
