"""What one expects of any page, in a real browser: keys act, texts are of what is shown, and the page is as one left it."""

from collections.abc import Iterator

import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.sources import Source
from tests.loop.studio.clients import watching
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, one, press, until, visit

pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def symbol() -> Iterator[Served]:
    """A symbol that a controller holds, and which has a frame with the light off."""
    yield from serving(Source("snowflake", (*SMALL, "steps=1000", "checks={}")), PAGE)


@pytest.fixture
def page(browser: webdriver.Chrome, symbol: Served) -> webdriver.Chrome:
    return visit(browser, symbol)


def test_the_page_is_as_one_left_it(page, symbol):
    border = one(page, ".border.columns")
    before = one(page, ".panel.camera").size["width"]
    ActionChains(page).drag_and_drop_by_offset(border, -100, 0).perform()
    wide = one(page, ".panel.camera").size["width"]
    assert wide == pytest.approx(before + 100, abs=3)
    camera, matrix = (one(page, f".panel.{name}").rect for name in ("camera", "matrix"))
    ActionChains(page).drag_and_drop(one(page, ".panel.camera h2"), one(page, ".panel.matrix .panel-body")).perform()
    assert [one(page, f".panel.{name}").rect for name in ("matrix", "camera")] == [camera, matrix]
    press(page, "5k")
    until(page, "return document.body.classList.contains('drawn')")
    narrow = one(page, ".keys-panel").size["width"]
    one(page, ".border.drawer").send_keys(Keys.ARROW_LEFT)
    assert one(page, ".keys-panel").size["width"] > narrow
    press(page, Keys.ESCAPE)
    page.refresh()
    until(page, "return (window.luxloop?.scenes ?? []).length > 0 && document.body.innerText.includes('step ')")
    assert page.execute_script("return [luxloop.store.state.keys_open, luxloop.store.state.viewpoint]") == [True, "wall"]
    press(page, "k")
    until(page, "return !document.body.classList.contains('drawn')")
    assert one(page, ".panel.camera").size["width"] == pytest.approx(wide, abs=1)
    assert one(page, ".panel.camera").location["y"] > one(page, ".panel.matrix").location["y"]


def test_nothing_of_the_last_scenario_is_left_in_another(page, symbol):
    Select(one(page, "[aria-label='Frame of the camera']")).select_by_visible_text("difference, 0 grey")
    keys = one(page, ".keys")
    keys.send_keys("camera.bitz=10", Keys.ENTER)
    until(page, "return document.querySelector('.toast')?.textContent.includes('camera.bitz: unknown key')")
    assert keys.get_attribute("aria-invalid") == "true"
    keys.send_keys(Keys.BACK_SPACE)
    assert keys.get_attribute("aria-invalid") is None
    with watching(symbol.port, symbol.tokens.edit) as other:
        other.of("scenario")
        other.say("pen")
        other.say("open", name="gfhb", overrides=[*SMALL, "checks={}"])
        until(page, "return luxloop.store.state.scenario.name === 'gfhb'")
    assert keys.get_attribute("value") == "" and not page.find_elements(By.CSS_SELECTOR, ".toast:not(.good)")
    frames = Select(one(page, "[aria-label='Frame of the camera']"))
    held = page.execute_script("return Object.keys(luxloop.store.state.scenario.runs[0].controllers).length")
    assert not held and [each.text for each in frames.options] == ["light on"]
    until(page, "return document.querySelector('.camera .empty').hidden")


def test_space_plays_after_the_speed_was_chosen_by_keys(page):
    speed = one(page, "[aria-label=Speed]")
    speed.send_keys(Keys.ARROW_DOWN)  # which leaves the focus there, so that more arrows go on
    assert page.switch_to.active_element == speed
    speed.send_keys(" ")
    until(page, "return luxloop.store.state.status.playing && luxloop.store.state.status.speed === 0.1")
    speed.send_keys(" ")
    until(page, "return !luxloop.store.state.status.playing")
