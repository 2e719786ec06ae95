"""Measured values against the files' reference, point sources by hand, and the wall that pictures show."""

import csv
import json

import numpy as np
import pytest
import torch

from luxloop import load_lamp
from luxloop.loop.report.measure import grid, on_road, points, towards, write_csv
from luxloop.world.lamps.description import measured_lamp
from luxloop.world.light.emitters import sources, wall_illuminance
from luxloop.world.photometry import Distribution, write

RTOL = 1e-6  # the reference is rounded to ten digits


@pytest.fixture
def reference(data_dir):
    return json.loads((data_dir / "ies" / "reference.json").read_text("utf-8"))["files"]


def test_directions_of_a_headlamps_file_have_the_files_intensity(data_dir, reference):
    lamp = measured_lamp(data_dir / "ies" / "type_a_symmetric.ies", "left")
    v, h, candela = np.array(reference["type_a_symmetric.ies"]["candela_bilinear"]["rows"]).T
    ahead = abs(h) < 89
    found = towards(lamp, "full", torch.tensor(np.array([h, v])[:, ahead]))
    np.testing.assert_allclose(found["cd"], candela[ahead], rtol=RTOL)
    cos = np.cos(np.radians(h)) * np.cos(np.radians(v))
    np.testing.assert_allclose(found["lx"], (candela * cos**3)[ahead] / 25**2, rtol=RTOL)


def test_directions_of_an_eulumdat_file_have_the_files_intensity(data_dir, reference):
    lamp = measured_lamp(data_dir / "ies" / "sample4.ldt", "left")
    expected = reference["sample4.ldt"]
    c, gamma, value = np.array(expected["full_values"]["rows"]).T
    near = (gamma > 0) & (gamma < 80)
    c, gamma, value = np.radians(c[near]), np.radians(gamma[near]), value[near]
    # C0 is to the right, C90 up, gamma from the axis
    h, v = np.arctan2(np.sin(gamma) * np.cos(c), np.cos(gamma)), np.arcsin(np.sin(gamma) * np.sin(c))
    found = towards(lamp, "full", torch.tensor(np.degrees([h, v])))
    # 1e-6: of the file's angles, which trigonometry returns to 1e-14, and of the rounded reference
    np.testing.assert_allclose(found["cd"], value * expected["lamp_flux_lm"][0] / 1000, rtol=RTOL)


def test_a_place_on_the_road_gets_the_light_of_two_point_sources(tmp_path):
    angles = np.arange(-90.0, 91.0, 10.0)
    write(tmp_path / "even.ies", Distribution("A", angles, angles, np.full((len(angles), len(angles)), 1000.0)))
    lamps = {side: measured_lamp(tmp_path / "even.ies", side) for side in ("left", "right")}
    found = on_road(lamps, "full", torch.tensor([[30.0], [1.75], [0.25]]).double())
    per_m3 = sum(1000 / (30**2 + (1.75 - y) ** 2 + 0.5**2) ** 1.5 for y in (0.6, -0.6))
    assert float(found["lx_vertical"]) == pytest.approx(30 * per_m3, rel=RTOL)
    assert float(found["lx_horizontal"]) == pytest.approx(0.5 * per_m3, rel=RTOL)
    (left,) = on_road({"left": lamps["left"]}, "full", torch.tensor([[10.0], [0.6], [0.75]]).double())["lx_vertical"].tolist()
    assert left == pytest.approx(10, rel=RTOL)  # 1000 cd at 10 m


def test_a_wall_has_the_light_that_pictures_show(tmp_path):
    lamp = load_lamp("ssl-hd")  # its modules do not share a centre
    h_v = points(["-10,-3:10,1:81"], "HV", (89, 89), "--at")
    found, eye = towards(lamp, "low", h_v, 10.0), torch.eye(4, dtype=torch.float64)
    shown = wall_illuminance(sources(lamp, lamp.beam("low"), eye), eye, *h_v, distance_m=10.0)
    torch.testing.assert_close(found["lx"], shown, rtol=1e-9, atol=1e-9)  # the same sums in another order
    write_csv(tmp_path / "wall.csv", found)
    with (tmp_path / "wall.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 81 and list(rows[0]) == ["h_deg", "v_deg", "y_m", "z_m", "cd", "lx"]
    assert [float(row["cd"]) for row in rows] == pytest.approx(found["cd"].tolist(), rel=1e-8)  # nine digits
    assert float(rows[0]["y_m"]) == pytest.approx(10 * np.tan(np.radians(10)), rel=1e-8)  # to the left


def test_a_wall_is_measured_where_the_beam_lights_it_or_over_the_angles_given(tmp_path):
    angles = np.arange(-90.0, 91.0)
    write(tmp_path / "beam.ies", Distribution("A", angles, angles, 1e4 * np.exp(-(angles[:, None] ** 2) / 50 - angles**2 / 8)))
    lamp = measured_lamp(tmp_path / "beam.ies", "left")

    def ends(*extent: str, step_deg: float = 0.5) -> list[list[float]]:
        return [each.tolist() for each in grid(lamp, "full", step_deg, extent).aminmax(dim=1)]

    # a 500th of the peak lies 17.6 deg aside and 7.0 deg up and down, on nodes of 0.5 and 0.25 deg
    assert ends() == [[-18.5, -7.5], [18.5, 7.5]]
    assert ends("30,15") == [[-30, -15], [30, 15]]
    assert ends("10,4:-20,-8") == [[-20, -8], [10, 4]]
    assert ends("0.3,0.3", step_deg=0.1) == [[pytest.approx(-0.3)] * 2, [pytest.approx(0.3)] * 2]


def test_lines_have_their_ends_and_count():
    line = points(["1,2", "0,0:4,2:3"], "XYZ", (9, 9, 9), "--road")
    assert line.T.tolist() == [[1, 2, 0], [0, 0, 0], [2, 1, 0], [4, 2, 0]]
    assert points(["0,0,1:1,1,1"], "XYZ", (9, 9, 9), "--road").shape == (3, 51)
