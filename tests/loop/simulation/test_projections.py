"""Symbols as the driver sees them, against trigonometry and photometry by hand."""

import math

import cv2
import numpy as np
import pytest
import torch

from luxloop import Utilisation, run
from luxloop.loop.recording.record import row
from luxloop.loop.simulation.projections import projection_metrics
from luxloop.world.scene.vehicle import VehiclePath
from tests.loop.conftest import simulated

EYE_M = 1.3, 1.6  # height, and distance behind the lamps, of the driver's eye
LAMP_M = 0.75
PIXEL_DEG = 0.015  # of the lamp, upright
X_M, LENGTH_M, WIDTH_M, CD, AMBIENT_LX = 18.0, 4.0, 1.0, 3000.0, 0.2
BAR = f"""
name = "bar"
steps = 1
renderer = "raycast"
judge_projections = true
headlight = {{ model = "idealised-332x1024", lamps = ["left"], distance_m = 0.0 }}
camera = {{ width_px = 160, height_px = 90, oversampling = 1 }}
light.ambient_lx = {AMBIENT_LX}
lighting.base.beam = "off"
[functions.bar]
kind = "symbol"
image = "bar.png"
x_m = {X_M}
width_m = {WIDTH_M}
length_m = {LENGTH_M}
quantity = "I_v"
value = {CD}
"""


@pytest.fixture
def seen(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("bar.png", np.full((64, 64), 255, np.uint8))
    return lambda *changes, **values: [row(each) for each in simulated(BAR, *changes, **values).evaluations()]


def arcmin(x_m: float, above_m: float = EYE_M[0]) -> float:
    return 60 * math.degrees(math.atan2(above_m, x_m + EYE_M[1]))


def test_a_bar_has_its_place_intensity_contrast_and_strokes(seen):
    (one,) = seen()
    bar = {key.removeprefix("functions.bar."): value for key, value in one.items() if key.startswith("functions.bar.")}
    pixel_m = math.radians(PIXEL_DEG) * (X_M + LENGTH_M / 2) ** 2 / LAMP_M  # along the road, at the far end
    assert [bar["near_m"], bar["far_m"]] == pytest.approx([X_M - LENGTH_M / 2, X_M + LENGTH_M / 2], abs=pixel_m)
    assert bar["aside_m"] == pytest.approx(WIDTH_M / 2, abs=0.02)
    assert bar["h_deg_max"] == pytest.approx(math.degrees(math.atan2(WIDTH_M / 2, X_M - LENGTH_M / 2)), abs=0.1)
    assert bar["v_deg_max"] == pytest.approx(-math.degrees(math.atan2(LAMP_M, X_M + LENGTH_M / 2)), abs=0.05)
    assert bar["cd_max"] == pytest.approx(CD, rel=0.02)  # setpoints in the middles of pixels
    # E = I h / d^3 of the lamp, averaged over the bar as the driver sees it, beside the ambient light
    x = np.linspace(X_M - LENGTH_M / 2, X_M + LENGTH_M / 2, 400)
    seen_share = 1 / (x + EYE_M[1]) ** 3  # angular width times height of a strip
    lx = CD * LAMP_M / (x**2 + LAMP_M**2) ** 1.5
    contrast = float((lx * seen_share).sum() / seen_share.sum()) / AMBIENT_LX
    assert bar["contrast"] == pytest.approx(contrast, rel=0.05)  # up to 5 % of the light is in the surround
    height = arcmin(X_M - LENGTH_M / 2) - arcmin(X_M + LENGTH_M / 2)
    width = 60 * 2 * math.degrees(math.atan2(WIDTH_M / 2, math.hypot(X_M + EYE_M[1], EYE_M[0])))
    short, long = sorted((height, width))
    # four times the mean distance from the edges of a rectangle: w (1 - w / 3 l); the bar tapers, by a seventh to each end
    assert bar["stroke_arcmin"] == pytest.approx(short * (1 - short / (3 * long)), rel=0.08)


def test_a_symbol_aside_turned_and_dark_is_seen_as_that(seen):
    (one,) = seen("functions.bar.y_m=1.5", "functions.bar.yaw_deg=90.0", "functions.bar.length_m=1.0")
    assert one["functions.bar.aside_m"] == pytest.approx(1.5 + 0.5, abs=0.1)
    assert one["functions.bar.far_m"] == pytest.approx(X_M + 0.5, abs=0.2)
    (dark,) = seen("functions.bar.start_s=9.0")
    assert dark.get("functions.bar.contrast") is None


def test_a_blob_has_no_modulation_and_sharp_strokes_have(seen, tmp_path):
    stripes = np.zeros((64, 64), np.uint8)
    stripes[:16] = stripes[32:48] = 255  # of 1 m, at the far end and behind the middle
    cv2.imwrite("bar.png", stripes)
    wide = "functions.bar.width_m=2.0"
    (sharp,), (coarse,) = seen(wide), seen(wide, "headlight.model=hd84", "functions.bar.value=300.0")
    # Half a pixel of 0.015 deg beyond each edge is 5 cm along the road at 18 m: 0.05 of the gap's light is the strokes'.
    assert sharp["functions.bar.modulation"] > 0.85
    assert coarse["functions.bar.modulation"] < 0.2, "a pixel of 3.3 deg covers all four stripes"
    assert coarse["functions.bar.stroke_arcmin"] > sharp["functions.bar.stroke_arcmin"], "so that width alone would pass it"


def test_light_that_fills_the_view_has_neither_contrast_nor_strokes(seen):
    simulation = simulated(BAR, "functions.bar.length_m=0.5", "functions.bar.width_m=0.3")
    dark, full = (torch.full((simulation.modules[0].headlight.n_pixels,), u) for u in (0.0, 1.0))
    symbol, path = simulation.scenario.projections["bar"], VehiclePath.of(simulation.world.motion, 0.0)
    found = projection_metrics(simulation.world, path, symbol, None, 0.0, [full], [Utilisation(dark)])
    assert found.cd_max > CD and math.isnan(found.contrast) and math.isnan(found.stroke_arcmin)


def test_a_symbol_on_the_course_of_a_bend_is_half_its_width_aside(seen):
    entry = {"speed_m_s": 10.0, "curvature_1_m": 0.004}
    bend = {"steps": 1, "rate_hz": 0.25, "vehicle": {"course": [entry, entry | {"time_s": 9.0}]}}
    motion = simulated(BAR, **bend).world.motion
    path = np.array([motion.at(t).T_world_ground[:2, 3].tolist() for t in np.linspace(0, 3, 300)])
    y = float(np.interp(X_M, *path.T))
    assert y > 0.7  # m, beside the axis of the car
    (one,) = seen(f"functions.bar.y_m={y}", "functions.bar.length_m=0.5", **bend)
    # 0.1: the bar lies across the car's axis, not across the course, which has turned by 0.07 rad
    assert one["functions.bar.aside_m"] == pytest.approx(WIDTH_M / 2, abs=0.1)


def test_checks_judge_projections_over_a_run(seen, tmp_path):
    checks = {
        "place": {"metric": "functions.bar.aside_m", "take": "max", "at_most": 1.875},
        "intensity": {"metric": "functions.bar.cd_max", "take": "max", "at_most": 1000},
    }
    simulation = simulated(BAR, checks=checks)
    summary = run(simulation.scenario, tmp_path / "run", video=False, report=False).summary["checks"]
    assert summary["place"]["passed"] and not summary["intensity"]["passed"]
