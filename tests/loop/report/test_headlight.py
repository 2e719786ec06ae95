"""Pictures of headlamps: what they are drawn from has the right values, and files come whole or not at all."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.text import Text

from luxloop import Lamp, Module, Scenario, idealised, pose_from_degrees, show_headlight, validate
from luxloop.loop.report import headlight
from luxloop.loop.report.charts import distance_marks, isolines, steps
from luxloop.loop.report.facts import borders_deg, flux_lm, lit_deg, peak
from luxloop.loop.report.headlight import facts, reach_m
from luxloop.loop.report.styles import VIEWS
from luxloop.loop.report.views import BIRDSEYE_X_M, BIRDSEYE_Y_M, LitCar, Road, beside, birdseye, driver, grey
from luxloop.world.frames import View
from luxloop.world.headlight import Headlight
from luxloop.world.scene.air import Medium
from tests.loop.conftest import box, toml
from tests.refusal import refusal


@pytest.fixture(scope="module")
def light() -> Headlight:
    return idealised(20, 40, (4, 4), half_width_deg=12, top_deg=2, bottom_deg=-8)


@pytest.fixture(scope="module")
def lamps(light: Headlight) -> dict[str, Lamp]:
    low = torch.ones(20, 40)
    low[:5] = 0  # the upper 2.6 deg
    lamp = Lamp("small", (Module("main", light),), {"low": (low.flatten(),)})
    return {"left": lamp, "right": lamp}


@pytest.fixture(scope="module")
def bending(lamps: dict[str, Lamp], light: Headlight) -> dict[str, Lamp]:
    """With a second module that can be swivelled."""
    (main,), low = lamps["left"].modules, lamps["left"].beam("low")
    lamp = Lamp("bending", (main, Module("bend", light, swivel_deg=(-15.0, 15.0))), {"low": (*low, *low)})
    return {"left": lamp, "right": lamp}


@pytest.fixture(scope="module")
def car(lamps: dict[str, Lamp]) -> LitCar:
    return LitCar(lamps, {side: lamp.beam("full") for side, lamp in lamps.items()})


def scenario(**tables: object) -> Scenario:
    return validate({"name": "test", "surface": {"grain": 0.0}, "renderer": "raycast", **tables}, "test")


@pytest.fixture(scope="module")
def road() -> Road:
    return Road(scenario(light={"ambient_lx": 0.0}))


def point_at(view: View, row: int, col: int) -> torch.Tensor:
    """Where on the plane z = 0 a pixel's centre looks."""
    ray = view.rays()[:, row, col]
    return view.origin - view.origin[2] / ray[2] * ray


def expected_lx(car: LitCar, point: torch.Tensor) -> float:
    """I cos / d^2 of all lamps on the road, written out."""
    total = 0.0
    for side, lamp in car.lamps.items():
        ray = point - torch.tensor([0.0, 0.6 if side == "left" else -0.6, 0.75], dtype=torch.float64)
        total += float(lamp.intensity(car.patterns[side], ray[:, None])) * 0.75 / float(ray.norm()) ** 3
    return total


def test_map_of_the_road_has_its_illuminance_in_its_places(car, road):
    view = birdseye(0.25)
    seen = road.look(car, view)
    (x0, _), (_, y1) = BIRDSEYE_X_M, BIRDSEYE_Y_M
    for x, y in ((20.125, 0.125), (40.125, -3.125), (15.125, 2.875)):
        row, col = round((y1 - y) / 0.25 - 0.5), round((x - x0) / 0.25 - 0.5)
        point = point_at(view, row, col)
        assert point.tolist() == pytest.approx([x, y, 0], abs=1e-6)
        value = expected_lx(car, point)
        assert value > 0.5
        assert seen.illuminance[row, col] == pytest.approx(value, rel=1e-4)  # positions are float32


def test_driver_sees_albedo_times_illuminance_by_pi(car, road):
    view = driver(320)
    seen = road.look(car, view)
    row, col = 130, 170
    value = expected_lx(car, point_at(view, row, col))
    assert value > 0.5
    assert seen.luminance[row, col] == pytest.approx(0.2 * value / math.pi, rel=1e-3)  # the road's albedo is 0.2
    assert np.isnan(seen.illuminance[0]).all() and not seen.luminance[0].any(), "the sky is not lit"


def test_objects_of_a_scenario_throw_shadows(car):
    wall = box("box", (1.0, 12.0, 2.0), (20.0, 0.0, 0.0))
    seen = Road(scenario(objects=[wall])).look(car, birdseye(0.5))
    behind, before = (round((x - BIRDSEYE_X_M[0]) / 0.5) for x in (30.0, 15.0))
    assert seen.illuminance[40, behind] == 0 and seen.illuminance[40, before] > 0.5


def test_lamps_of_a_car_that_drives_shine_where_it_is_then(car):
    track = [{"time_s": t, "position_m": [40.0 - 10 * t, 3.5, 0.0], "yaw_deg": 180.0} for t in (0.0, 2.0)]
    oncoming = scenario(light={"ambient_lx": 0.0}, objects=[{"kind": "car", "name": "car", "track": track}])
    dark = replace(car, patterns={side: tuple(torch.zeros_like(u) for u in pattern) for side, pattern in car.patterns.items()})
    lit = [Road(oncoming, time_s).look(dark, birdseye(0.5)).luminance for time_s in (0.0, 2.0)]
    # light on the road ahead of the car, without the lamps themselves, which are bright: 20 m nearer
    on_road = [np.where(luminance < 10, luminance, 0).sum(0) for luminance in lit]
    before, after = (float(each @ np.arange(len(each)) / each.sum()) for each in on_road)
    assert after - before == pytest.approx(-20.0 / 0.5, abs=5.0)  # the map ends where the nearest light is


def test_fog_veils_what_is_far_and_shows_the_beam(car, road):
    view = beside(160)
    clear, fog = road.look(car, view), road.look(car, view, Medium.fog(100.0))
    sky = np.isnan(clear.illuminance)
    assert clear.luminance[sky].max() == 0 < fog.luminance[sky].max()
    bright = clear.luminance > 0.5 * clear.luminance.max()
    assert fog.luminance[bright].mean() < 0.6 * clear.luminance[bright].mean(), "about 15 m there and 20 m back of 100 m take two thirds"


def test_chromatic_lamps_are_seen_in_colour(light, road):
    red = torch.tensor([1 / 0.2126, 0.0, 0.0])[:, None].expand(3, len(light.matrix.values))
    coloured = Headlight(**{**vars(light), "chroma": red})
    lamp = Lamp("red", (Module("main", coloured),))
    plain, seen = (
        road.look(LitCar({"left": each}, {"left": each.beam("full")}), driver(160))
        for each in (Lamp("grey", (Module("main", light),)), lamp)
    )
    assert seen.luminance.shape == (90, 160, 3)
    assert seen.luminance[..., 0].max() > 0 and seen.luminance[..., 1:].max() == 0
    np.testing.assert_allclose(grey(seen.luminance), plain.luminance, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(seen.illuminance, plain.illuminance, rtol=1e-4, atol=1e-6)


def test_fog_scatters_the_light_of_the_sky_too(lamps):
    dark = LitCar({"left": lamps["left"]}, {"left": lamps["left"].beam("off")})
    seen = Road(scenario(light={"ambient_lx": 1000.0})).look(dark, driver(160), Medium.fog(50.0))
    # Half of the air's surroundings is a sky of E / pi.
    assert seen.luminance[0, 80] == pytest.approx(1000 / (2 * math.pi), rel=1e-5)
    near, clear = seen.luminance[-1, 80], 0.2 * 1000 / math.pi
    distance = 1.2 / -float(driver(160).rays()[2, -1, 80]) * float(driver(160).rays()[:, -1, 80].norm())
    through = 0.05 ** (distance / 50)
    assert near == pytest.approx(clear * through + 1000 / (2 * math.pi) * (1 - through), rel=1e-4)


@pytest.mark.parametrize("road", ["{ kind='flat' }", "{ kind='grade', grade_percent=3.0 }", "{ kind='bumps' }"])
def test_distances_stand_where_the_road_is_and_nothing_hides_them(road, car):
    def marks(lane_width_m: float, *objects: dict[str, object]) -> tuple[View, list[Text]]:
        given = {"road": toml(road), "surface": {"grain": 0.0, "lane_width_m": lane_width_m}, "objects": objects}
        seen, axes = Road(scenario(**given)).look(car, driver(960)), Figure().subplots()
        distance_marks(axes, seen, lane_width_m)
        return seen, axes.texts

    seen, texts = marks(5.0)
    assert len(texts) >= 4
    for text in texts:
        metres, (u, v) = float(text.get_text().split()[1]), text.get_position()
        x, y, _ = seen.surfaces.position[:, int(v), int(u)]
        # A row is 6 m of a flat road 100 m ahead.
        assert float(x) == pytest.approx(metres, abs=0.7 * metres**2 / 1319 + 0.05)
        assert float(y) == pytest.approx(-2.65, abs=0.1)
    if "flat" in road:
        _, texts = marks(3.5, box("box", (1.0, 20.0, 3.0), (25.0, 0.0, 0.0)))
        assert {text.get_text() for text in texts} == {"– 10 m", "– 20 m"}


def test_flux_of_a_uniform_texture_is_its_solid_angle(light):
    def rectangle(y: float, z: float) -> float:
        return math.atan(y * z / math.sqrt(1 + y * y + z * z))

    solid_angle = 2 * (rectangle(light.left, light.top) - rectangle(light.left, light.bottom))
    # Midpoints of 80 x 160 texels; the integrand varies by 7 %.
    assert flux_lm(light, torch.full((light.rows, light.cols), 1000.0)) == pytest.approx(1000 * solid_angle, rel=1e-5)


def test_reach_is_where_the_inverse_square_law_says(lamps):
    alone = LitCar({"left": lamps["left"]}, {"left": lamps["left"].beam("full")})
    # 50 kcd give 10 lx at 70.7 m, looking 0.6 deg down; facing the car costs no cosine worth mentioning there.
    assert reach_m(alone, 10.0) == pytest.approx(math.sqrt(50_000 / 10), abs=0.5)
    assert reach_m(LitCar({"left": lamps["left"]}, {"left": lamps["left"].beam("off")}), 1.0) == 0.0


def test_wall_holds_the_beam_and_facts_name_its_peak(lamps):
    low = LitCar(lamps, {side: lamp.beam("low") for side, lamp in lamps.items()})
    (left, right), (bottom, top) = lit_deg(low.intensity)
    assert left < -12 and right > 12 and bottom < -8 and top >= 1.5
    found = dict(facts(low, "low"))
    assert found["beam"] == "low"
    assert found["left lamp"].startswith("800 pixels, ")
    assert found["left peak"] == "50 kcd, 80 lx at 25 m"


def test_the_peak_is_found_wherever_it_is(light):
    far_aside = Lamp("aside", (Module("main", light, pose_from_degrees((0, 0, 0), pitch_deg=-20, yaw_deg=60)),))
    one = torch.zeros(20, 40)
    one[19, 39] = 1.0  # its lower right corner
    found = peak(far_aside, (one.flatten(),))
    assert 47 < -found.h_deg < 50 and 11 < found.v_deg < 15
    assert found.candela == pytest.approx(50_000, rel=1e-3)
    assert borders_deg(light) == pytest.approx((12, -12, -8, 2))


@pytest.mark.parametrize(("brightest", "expected"), [(0.0, [1.0]), (3.0, [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2]), (10.0, [2, 5])])
def test_lines_are_at_round_values(brightest, expected):
    assert steps(brightest, most=len(expected)) == pytest.approx(expected)


def test_lines_run_along_borders_where_light_ends_at_once():
    axes = Figure().subplots()
    light = np.zeros((20, 30))
    light[5:15, 8:20] = 3.0
    isolines(axes, np.arange(30.0), np.arange(20.0), light)
    (lines,) = (each for each in axes.collections if isinstance(each, ContourSet))
    for path in lines.get_paths():
        x, y = path.vertices.T
        assert 7 < x.min() < 8 and 19 < x.max() < 20 and 4 < y.min() < 5 and 14 < y.max() < 15


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, road: Road) -> None:
    """Small views of a road that is there already."""
    monkeypatch.setattr(headlight, "DPI", 50)
    monkeypatch.setattr(headlight, "Road", lambda scenario, time_s: road)
    monkeypatch.setattr(headlight, "beside", lambda: beside(160))
    monkeypatch.setattr(headlight, "driver", lambda width_px=320: driver(320))
    monkeypatch.setattr(headlight, "birdseye", lambda cell_m=0.5, x_m=BIRDSEYE_X_M: birdseye(0.5, x_m))


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.usefixtures("quick")
def test_each_view_in_each_style_is_a_readable_picture_of_a_dark_lamp_as_well(view, lamps, tmp_path):
    for style in VIEWS[view]:
        picture = cv2.imread(str(show_headlight(lamps, tmp_path / f"{style}.png", view=view, style=style)))
        assert picture.shape[1] >= 500 and picture.std() > 10
    if view in ("wall", "pixels", "overview"):
        assert cv2.imread(str(show_headlight({"right": lamps["right"]}, tmp_path / "dark.jpg", beam="off", view=view))) is not None
    assert {path.suffix for path in tmp_path.iterdir()} - {".jpg"} == {".png"}, "nothing half-written is left"


def test_a_scenario_turns_the_modules_that_can_be_turned(bending, tmp_path, monkeypatch):
    cars: list[LitCar] = []
    monkeypatch.setattr(headlight, "draw_wall", lambda axes, car, style: cars.append(car))
    turned = scenario(headlight={"swivel_deg": 12.0, "height_m": 0.9})
    show_headlight(bending, tmp_path / "wall.png", view="wall", beam="full", scenario=turned)
    main, bend, *_ = cars[0].sources
    assert main.T_world_source.equal(pose_from_degrees((0.0, 0.6, 0.9)))
    torch.testing.assert_close(bend.T_world_source, pose_from_degrees((0.0, 0.6, 0.9), yaw_deg=12.0))
    h = torch.tensor([-20.0])  # only the bent module gets there
    assert cars[0].intensity(h, torch.tensor([-1.0])) > 0 == LitCar(bending, cars[0].patterns).intensity(h, torch.tensor([-1.0]))


def both(*of_modules: torch.Tensor) -> dict[str, object]:
    return {"beam": {side: [*of_modules] for side in ("left", "right")}}


FULL = torch.ones(800)
WRONG = {
    "no view 'drivr'; did you mean 'driver'": {"view": "drivr"},
    "no style 'isolxu'; did you mean 'isolux'": {"view": "wall", "style": "isolxu"},
    "'driver'.*'isocandela'; it has luminance, falsecolour, isolux": {"view": "driver", "style": "isocandela"},
    "no beam 'hihg'; it has low, full, off": {"beam": "hihg"},
    r"beam.bmp: pictures are written as .png": {"out": Path("beam.bmp")},
    "beam.png: cannot be written": {"out": Path(__file__) / "beam.png", "view": "wall"},
    "visibility of 0 m": {"visibility_m": 0.0, "view": "volume"},
    "visibility of nan m": {"visibility_m": math.nan, "view": "volume"},
    "visibility of inf m": {"visibility_m": math.inf, "view": "volume"},
    "'driver' has no fog.*'volume'": {"visibility_m": 50.0, "view": "driver"},
    "'pixels' shows the lamps by themselves.*scenario": {"scenario": scenario(), "view": "pixels"},
    "'texture' shows the lamps by themselves.*scenario": {"scenario": scenario(), "view": "texture"},
    "module 'bend': swivel of 20 deg is out of its range": {"scenario": scenario(headlight={"swivel_deg": 20.0}), "view": "wall"},
    "no utilisations for the left lamp": {"beam": {"right": [FULL] * 2}},
    "left lamp: 1 utilisations for 2 modules": {"beam": {"left": [FULL], "right": []}},
    r"left lamp, module 'bend'.*shape \(5,\).*800": both(FULL, torch.ones(5)),
    "'bend'.*from 0 to 1": both(FULL, FULL * math.nan),
    "'main'.*from 0 to 1": both(7 * FULL, FULL),
    "'main'.*from 0 to 1.*": both(-FULL, FULL),
}


@pytest.mark.parametrize("message", WRONG)
def test_what_is_wrong_is_named(message, bending, tmp_path):
    with refusal(message):
        show_headlight(bending, **{"out": tmp_path / "beam.png", **WRONG[message]})  # type: ignore[arg-type]
    for sides in ((), ("middle",), ("left", "rigth")):
        with refusal("'left' and 'right', or one of them"):
            show_headlight({side: bending["left"] for side in sides}, tmp_path / "beam.png", view="wall")
    assert not list(tmp_path.iterdir())


def test_left_and_right_textures_are_to_one_scale_and_to_the_right(lamps):
    half = {"left": (torch.full((800,), 0.5),), "right": (torch.ones(800),)}
    figure = Figure()
    headlight._draw_modules(figure, LitCar(lamps, half), "texture")
    shown = [axes.images[0] for axes in figure.axes if axes.images]
    assert [image.get_clim() for image in shown] == [(0, pytest.approx(50.0))] * 2
    assert shown[0].get_extent()[:2] == pytest.approx((-math.tan(math.radians(12)), math.tan(math.radians(12))))
