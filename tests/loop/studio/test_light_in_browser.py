"""Light painted in the world, in a real browser: the place that is clicked on lights up, and so does the road as bright as is wanted."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains

from luxloop.controllers.pixels.jpo_plane import lighting
from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.sources import Source
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, one, press, until, visit

pytestmark = IN_BROWSER
DARK = (*SMALL, "headlight.model=idealised-332x1024", "lighting.base.beam=off", "functions={}", "checks={}", "objects=[]")
PROBE = """const points = arguments[0], normals = points.map((_, k) => Number(k % 3 === 2));
    return Array.from(luxloop.scenes[0].probe(new Float32Array(points), new Float32Array(normals)))"""


@pytest.fixture(scope="module")
def dark() -> Iterator[Served]:
    """Two lamps of 332 x 1024 pixels that hardly overlap, all dark."""
    yield from serving(Source("gfhb", DARK), PAGE)


@pytest.fixture
def page(browser: webdriver.Chrome, dark: Served) -> webdriver.Chrome:
    visit(browser, dark)
    browser.execute_script("luxloop.store.set({ viewpoint: 'above' })")
    return browser


def pressed(page: webdriver.Chrome, text: str) -> None:
    script = "[...document.querySelectorAll('.world-light button')].find((each) => each.textContent === arguments[0]).click()"
    page.execute_script(script, text)


def probed(page: webdriver.Chrome, points: np.ndarray) -> np.ndarray:
    """Illuminance in lx of the ground at points `[n, 3]` by the shader."""
    return np.array(page.execute_script(PROBE, points.ravel().tolist()))


def test_a_click_lights_the_place_by_the_pixels_that_the_library_names(page, dark):
    canvas = one(page, ".scene canvas")
    pressed(page, "light")
    ActionChains(page).move_to_element_with_offset(canvas, 12, -30).click().perform()
    until(page, "return luxloop.store.state.light?.type === 'place'")
    point = np.array(page.execute_script("return luxloop.store.state.light.point_m"))
    assert 15 < point[0] < 60
    run = dark.run
    params = run.simulation.scenario.lighting.painted
    assert [each.module for each in params] == ["left matrix", "right matrix"]
    for module, each in zip(run.simulation.modules, params, strict=True):
        pixels, _ = lighting(module.headlight, module.T_world_module, torch.from_numpy(point))
        assert np.array_equal(np.flatnonzero(each.pictures[1]), np.sort(pixels.numpy()))
    until(page, "return luxloop.store.state.runs[0].utilisations.get(0)?.some((each) => each === 255)")
    there, beside = probed(page, np.stack([point, point + np.array([0, 2.0, 0])]))
    assert there > 0.05 and beside < 0.05 * there
    assert page.execute_script("return luxloop.painting.marked.get(0).size") > 0


def test_the_road_becomes_as_bright_as_is_wanted(page, dark):
    pressed(page, "lux")
    page.execute_script("luxloop.wanted.road.paint(28, 0, 3, 0.5)")
    pressed(page, "paint it")
    until(page, "return luxloop.store.state.light?.type === 'wish'")
    granted = page.execute_script("return luxloop.store.state.light")
    told = one(page, ".panel.scene .readout").text
    assert granted["wanted_lx"] == pytest.approx(0.5) and "0.5 lx wanted" in told and "RMSE" in told
    until(page, "return luxloop.store.state.runs[0].utilisations.get(0)?.some((each) => each > 0)")
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0, 2 * np.pi, 200), 2.5 * np.sqrt(rng.uniform(0, 1, 200))  # half a metre within the border
    points = np.stack([28 + radius * np.cos(angle), radius * np.sin(angle), np.zeros(200)], 1)
    lx = probed(page, points)
    # Cells of half a metre have the mean that is wanted: a point may differ, as the pixels' light has a ripple.
    assert np.abs(lx.mean() - 0.5) < 0.02 and np.sqrt(np.square(lx - 0.5).mean()) < 0.1
    assert probed(page, np.array([[28.0, 6.0, 0], [28.0, -6.0, 0], [45.0, 0, 0]])).max() < 0.1


def test_the_wall_becomes_as_bright_as_is_wanted(page, dark):
    press(page, "5")
    pressed(page, "lux")
    canvas = one(page, ".scene canvas")
    ActionChains(page).move_to_element_with_offset(canvas, 12, 30).click().perform()
    painted = page.execute_script("return [luxloop.wanted.wall, luxloop.wanted.road].map((each) => each.painted.some((cell) => cell))")
    assert painted == [True, False]
    pressed(page, "clear")
    page.execute_script("luxloop.wanted.wall.paint(0, 2, 0.6, 20)")
    pressed(page, "paint it")
    until(page, "return luxloop.store.state.light?.type === 'wish' && luxloop.store.state.light.on === 'wall'")
    run = dark.run
    assert len(run.simulation.scenario.lighting.painted) == 2
    granted = page.execute_script("return luxloop.store.state.light")
    assert granted["wanted_lx"] == pytest.approx(20) and granted["rmse_lx"] < 1  # a step of 1 in 255 is 0.6 lx there, of each lamp
    press(page, "1")
