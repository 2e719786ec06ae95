"""Driving in a real browser: keys move the car, and its light switch the beam."""

from collections.abc import Iterator

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

from luxloop.controllers.functions.commands import DirectParams
from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.sources import Source
from tests.loop.studio.clients import watching
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, one, press, until, visit

pytestmark = IN_BROWSER
BUTTON = "[...document.querySelectorAll('.panel.scene button')].find((each) => each.textContent === 'Drive')"
PLAIN = (*SMALL, "rate_hz=5.0", "headlight.model=hd84", "functions={}", "checks={}", "objects=[]", "lighting.base.beam=low")


@pytest.fixture(scope="module")
def car() -> Iterator[Served]:
    yield from serving(Source("gfhb", (*PLAIN, "vehicle.course=[{speed_m_s=5.0}]", "steps=2")), PAGE)


def test_keys_drive_the_car_and_switch_its_light(browser, car):
    visit(browser, car)
    until(browser, f"return !{BUTTON}.disabled")
    browser.execute_script(f"{BUTTON}.click()")
    until(browser, "return luxloop.store.state.model.vehicle.roams && luxloop.store.state.viewpoint === 'driver'")
    ActionChains(browser).key_down(Keys.ARROW_UP).key_down("a").perform()
    until(browser, "return luxloop.store.state.runs[0].newest > 4 && document.querySelector('.drive-speed').textContent !== ''")
    ActionChains(browser).key_down("f").perform()
    until(browser, "return luxloop.store.state.model.lighting.base.beam === 'high'")
    browser.execute_script("dispatchEvent(new Event('blur'))")  # in another window nobody holds the flash
    until(browser, "return luxloop.store.state.model.lighting.base.beam === 'low'")
    ActionChains(browser).key_up("f").send_keys("h").perform()
    until(browser, "return luxloop.store.state.model.lighting.base.beam === 'high'")
    for key, shown in (("q", "left"), ("x", "hazard")):
        ActionChains(browser).send_keys(key).perform()
        until(browser, f"return luxloop.store.state.model.lighting.indicator === '{shown}'")
    module = car.run.simulation.modules[0].name
    slider = one(browser, f"[aria-label='{module}, intensity']")
    browser.execute_script(
        "arguments[0].closest('details').open = true; arguments[0].value = 0.25; arguments[0].dispatchEvent(new Event('input'))", slider
    )
    until(browser, "return luxloop.store.state.runs[0].rows.count && Object.keys(luxloop.store.state.model.functions).length === 1")
    (commanding,) = car.scenario.functions.values()
    assert isinstance(commanding, DirectParams) and (commanding.modules, commanding.intensity) == ((module,), 0.25)
    one(browser, f"[title='Let {module} rest']").click()
    until(browser, "return Object.keys(luxloop.store.state.model.functions).length === 0")
    ActionChains(browser).key_up(Keys.ARROW_UP).key_up("a").send_keys(Keys.ESCAPE).perform()
    until(browser, "return !luxloop.store.state.driving && luxloop.store.state.model.vehicle.course.at(-1).curvature_1_m === 0")
    after = car.scenario
    assert after.lighting.base.beam == "high" and after.vehicle is not None
    course = after.vehicle.course
    assert max(each.speed_m_s for each in course) > 6
    assert max(each.curvature_1_m * each.speed_m_s**2 for each in course) > 0.3  # m/s^2 to the left; how far depends on the machine's speed
    assert after.steps > 2  # that the scenario has


@pytest.mark.slow
def test_a_car_that_stands_is_put_on_wheels_once_one_agrees(browser, car, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where the recording is
    browser.get("about:blank")
    with watching(car.port, car.tokens.edit) as other:
        other.of("scenario")
        other.say("pen")
        other.say("set", overrides=["vehicle={}"])
        other.until(lambda head: head["type"] == "scenario" and head["model"]["vehicle"] is None)
    visit(browser, car)
    until(browser, f"return !{BUTTON}.disabled && luxloop.store.state.model.vehicle === null")
    one(browser, ".record").click()
    until(browser, "return luxloop.store.state.status.recording")
    for key in (Keys.ESCAPE, Keys.ENTER):
        assert car.scenario.vehicle is None
        browser.execute_script(f"{BUTTON}.click()")
        text = one(browser, "dialog[open]").text
        assert "starts anew" in text and f"runs/{car.studio.session.state.recording} ends" in text
        assert browser.switch_to.active_element.text == "Put it on wheels"
        browser.switch_to.active_element.send_keys(key)
        until(browser, "return document.querySelector('dialog[open]') === null")
    until(browser, "return luxloop.store.state.model.vehicle?.course[0].speed_m_s === 0")
    until(browser, "return luxloop.store.state.driving && document.querySelector('.drive-speed').textContent === '0 km/h'")
    until(browser, "return luxloop.store.state.runs[0].newest > 1")
    press(browser, Keys.ESCAPE)
    until(browser, "return !luxloop.store.state.driving")
