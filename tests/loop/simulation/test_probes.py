"""Probes: lux meters that agree with the lamp's intensity, stand still, ride along, and see shadows."""

import math

import pytest
import torch
from matplotlib.figure import Figure
from rich.console import Console

from luxloop import Simulation, load, run
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.report.courses import write_courses
from luxloop.loop.report.run_table import summary_table
from tests.refusal import refusal

CAMERA = {"width_px": 160, "height_px": 90, "oversampling": 1}
BOARD = {"kind": "box", "name": "board", "size_m": [0.2, 6.0, 3.0], "albedo": 0.3, "track": [{"position_m": [40.0, 0.0, 0.0]}]}


def lit(probes, **values):
    given = {
        "camera": CAMERA,
        "steps": 1,
        "functions": {},
        "objects": [],
        "lighting": {"base": {"beam": "high"}},
        "probes": probes,
    } | values
    simulation = Simulation.prepare(load("gfhb", **given))
    result = simulation.evaluate(simulation.step(simulation.start())[1])
    return simulation, result


def test_a_probe_measures_intensity_over_distance_squared_and_the_cosine():
    place = (25.0, 0.7, 0.9)
    _, result = lit({"facing_lamps": {"position_m": place}, "upright": {"position_m": place, "facing": [-1.0, 0.0, 0.0]}})
    simulation, _ = lit({})
    facing = upright = 0.0
    for module, u in zip(simulation.world.modules, result.lights, strict=True):
        T = module.T_body_headlight.double()
        way = torch.tensor(place, dtype=torch.float64)[:, None] - T[:3, 3:]
        cd = float(module.headlight.intensity(module.headlight.light_texture(u).double(), T[:3, :3].T @ way))
        facing += cd / float(way.norm()) ** 2
        upright += cd / float(way.norm()) ** 2 * float(way[0] / way.norm())
    assert facing > 1
    # 1e-5: the texture is float32
    assert result.probes == pytest.approx({"facing_lamps": facing, "upright": upright}, rel=1e-5)


def test_a_probe_agrees_with_the_light_on_a_surface_there():
    simulation, result = lit({"on_board": {"position_m": [39.899, 0.3, 0.8], "facing": [-1, 0, 0]}}, objects=[BOARD])
    seen = simulation.world.lit(0.0)
    lx = simulation.world.illuminance(0.0, result.exposures[0].lights).flatten()
    place = seen.surfaces.position.flatten(1)
    away = (place - torch.tensor([[39.9], [0.3], [0.8]])).norm(dim=0)
    # a pixel spans 0.2 m of the board, over which the high beam changes by some percent
    assert result.probes["on_board"] == pytest.approx(float(lx[away.argmin()]), rel=0.1)


def test_what_stands_before_a_probe_shades_it_and_what_carries_it_does_not():
    behind = {"behind": {"position_m": [45.0, 0.0, 0.8]}, "inside": {"position_m": [0.0, 0.0, 0.8], "frame": "board"}}
    _, result = lit(behind, objects=[BOARD])
    assert result.probes["behind"] == 0 and result.probes["inside"] > 1
    _, free = lit({"behind": behind["behind"]})
    assert free.probes["behind"] > 1


def test_frames_ride_along_and_a_probe_of_a_vanished_object_is_empty():
    moving = (
        BOARD | {"vanishes_s": 0.15} | {"track": [{"time_s": 0.0, "position_m": [40.0, 0, 0]}, {"time_s": 1.0, "position_m": [20.0, 0, 0]}]}
    )
    probes = {"rides": {"position_m": [-0.2, 0.0, 0.8], "frame": "board"}, "ahead": {"position_m": [30.0, 0.0, 0.8], "frame": "car"}}
    simulation, first = lit(probes, objects=[moving], rate_hz=10.0, steps=3)
    states, found = simulation.start(), []
    for _ in range(3):
        states, result = simulation.step(states)
        found.append(simulation.evaluate(result).probes)
    assert found[1]["rides"] > 1.05 * found[0]["rides"] and math.isnan(found[2]["rides"])
    assert found[0]["ahead"] == pytest.approx(found[1]["ahead"])
    assert {"probes.rides.lx", "probes.ahead.lx"} <= set(schema(simulation).names)
    assert row(first)["probes.ahead.lx"] == found[0]["ahead"]


def veil_by_hand(lx: float, deg: float, age_years: float) -> float:
    """CIE 146:2002, general disability glare equation, of brown eyes (p = 0.5)."""
    return lx * (10 / deg**3 + (5 / deg**2 + 0.1 * 0.5 / deg) * (1 + (age_years / 62.5) ** 4) + 0.0025 * 0.5)


def test_an_oncoming_eye_is_veiled_by_one_lamp_as_by_hand():
    eye = {"position_m": [50.0, 3.5, 1.1], "facing": [-1.0, 0.0, 0.0], "adaptation_cd_m2": 0.5}
    head = {"model": "idealised-332x1024", "lamps": ["left"], "distance_m": 0.0}
    simulation, result = lit({"eye": eye}, headlight=head, lighting={"base": {"beam": "full"}}, video={"age_years": 60.0})
    (module,) = simulation.world.modules
    lamp = module.T_body_headlight[:3, 3].double()
    way = torch.tensor([50.0, 3.5, 1.1], dtype=torch.float64) - lamp
    deg = math.degrees(math.acos(float(way[0] / way.norm())))
    veil = veil_by_hand(result.probes["eye"], deg, 60.0)
    assert result.probes["eye"] > 0.1 and 1 < deg < 10
    assert result.glare["eye"].veil_cd_m2 == pytest.approx(veil, rel=1e-9)  # the same sum
    assert result.glare["eye"].ti_percent == pytest.approx(65 * veil / 0.5**0.8, rel=1e-9)
    assert row(result)["probes.eye.ti_percent"] == result.glare["eye"].ti_percent
    assert {"probes.eye.veil_cd_m2", "probes.eye.ti_percent"} <= set(schema(simulation).names)


def test_an_eye_that_rides_along_tells_masked_from_unmasked_light(tmp_path):
    car = {"kind": "car", "name": "oncoming", "seed": 1, "path": {"points_m": [[70, 3.5, 0], [20, 3.5, 0]], "speed_m_s": 15.0}}
    eye = {"frame": "oncoming", "position_m": [0.3, 0.36, 1.2], "facing": [1.0, 0.0, 0.0], "adaptation_cd_m2": 1.0}
    check = {"metric": "probes.eye.ti_percent", "compare": "full_light", "take": "max", "at_most": 0.1}
    values = {"objects": [car], "probes": {"eye": eye}, "checks": {"masked": check}, "lighting": {"base": {"beam": "high"}}}
    mask = {"guard": {"kind": "glare_free"}}
    result = run(load("gfhb", camera=CAMERA, steps=6, functions=mask, **values), tmp_path / "run", video=False, report=False, checks=True)
    assert result.summary["checks"]["masked"]["passed"], "a ratio of 0 to 0 would be 1: the eye is dazzled without the mask"


def test_the_report_draws_the_threshold_increment_of_eyes_alone():
    eye = {"position_m": [50.0, 3.5, 1.1], "facing": [-1.0, 0.0, 0.0], "adaptation_cd_m2": 0.5}
    simulation, result = lit({"eye": eye, "meter": {"position_m": [50.0, 0.0, 0.3]}})
    figure = Figure()
    write_courses(figure.add_subfigure(figure.add_gridspec()[0]), simulation, table_of([row(result)], schema(simulation)), {"objects": {}})
    (curve,) = (curve for axes in figure.axes if axes.get_yscale() == "symlog" for curve in axes.lines)
    assert (
        curve.get_label() == "eye" and curve.get_ydata() == [result.glare["eye"].ti_percent] and figure.axes[-1].get_xlabel() == "time in s"
    )


@pytest.mark.slow
def test_eyes_of_the_shipped_sensors_are_dazzled_without_the_mask(tmp_path):
    scenario = load("sensors", ["functions.guard_traffic={}"])
    checks = run(scenario, tmp_path / "run", video=False, report=False, checks=True).summary["checks"]
    assert {name for name, each in checks.items() if not each["passed"]} == {"oncoming_driver_not_dazzled", "preceding_driver_not_dazzled"}


def test_probes_are_columns_that_checks_hold(tmp_path):
    checks = {"seen": {"metric": "probes.eye.lx", "take": "max", "at_most": 1e6}}
    values = {"camera": CAMERA, "steps": 2, "probes": {"eye": {"position_m": [15, -2, 0]}}, "checks": checks}
    result = run(load("gfhb", **values), tmp_path / "run", video=False)
    lx = result.trajectory["probes.eye.lx"].to_numpy()
    assert result.summary["checks"]["seen"]["passed"] and lx[0] > 0
    assert result.summary["probes"] == {"eye": {"lx_min": lx.min(), "lx_mean": pytest.approx(lx.mean()), "lx_max": lx.max()}}
    text = Console(record=True, width=200)
    text.print(summary_table(result.summary, ""))
    assert f"{lx.mean():.3g} lx (mean)" in text.export_text()


@pytest.mark.parametrize(
    ("probe", "told"),
    [
        ({"position_m": None}, "position_m"),
        ({"frame": "bord"}, "board"),
        ({"frame": "car"}, r"frame: 'car' .*another name"),
        ({"facing": [0, 0, 0]}, "direction"),
        ({"adaptation_cd_m2": 1.0}, "adaptation_cd_m2.*give facing"),
    ],
)
def test_a_probe_nowhere_is_refused(probe, told):
    with refusal(rf"probes\.eye.*{told}"):
        load("gfhb", objects=[BOARD, BOARD | {"name": "car"}], functions={}, probes={"eye": {"position_m": [1, 2, 3]} | probe})
