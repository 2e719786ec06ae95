"""The controls of the scenario's keys in a real browser: a value reaches the simulation, and a refusal appears beside its control."""

from collections.abc import Iterator

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import Select

from luxloop import load
from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.session import Source
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, one, press, until, until_here, visit

pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def symbol() -> Iterator[Served]:
    """A symbol that a controller holds."""
    yield from serving(Source("snowflake", (*SMALL, "steps=60", "checks={}")), PAGE)


def keys_of(browser: webdriver.Chrome, served: Served, token: str | None = None) -> webdriver.Chrome:
    """Open the page with the drawer of keys."""
    visit(browser, served, token).find_element(By.TAG_NAME, "body").send_keys("k")
    until(browser, "return document.querySelector('.function') !== null")
    return browser


@pytest.fixture
def page(browser: webdriver.Chrome, symbol: Served) -> webdriver.Chrome:
    return keys_of(browser, symbol)


def labelled(browser: webdriver.Chrome, label: str) -> WebElement:
    return one(browser, f"[aria-label='{label}']")


def searched(browser: webdriver.Chrome, words: str, key: str) -> WebElement:
    """The control of a key that a search finds."""
    labelled(browser, "Search keys").clear()
    labelled(browser, "Search keys").send_keys(words)
    until(browser, f"return document.querySelector('.keys-found [data-key=\"{key}\"]') !== null")
    return one(browser, f".keys-found [data-key='{key}']")


def test_a_slider_s_gain_reaches_the_controller_at_the_next_step(page, symbol):
    run = symbol.run
    before = run.simulation.symbol.params.position.kp
    slider = labelled(page, "functions.symbol.controller.position.kp, slider")
    slider.send_keys(Keys.ARROW_RIGHT * 5)
    asked = float(slider.get_attribute("value") or "nan")
    assert asked > before
    until_here(lambda: run.simulation.symbol.params.position.kp == asked)
    assert symbol.studio.session.state.runs == (run,) and {each.step for each in run.tally.edits} == {len(run.rows)}
    back = one(page, "[data-key='functions.symbol.controller.position.kp'] button")
    until_here(lambda: back.is_displayed())
    back.click()
    until_here(lambda: run.simulation.symbol.params.position.kp == before)


def test_what_is_refused_is_told_beside_its_control_and_changes_nothing(page, symbol):
    before = symbol.scenario
    row = searched(page, "pixel_controller", "pixel_controller")
    field = row.find_element(By.TAG_NAME, "input")
    field.clear()
    until(page, "return document.querySelector('.keys-found .key-error') !== null")
    field.send_keys(Keys.CONTROL, "a", Keys.NULL, "jpoo", Keys.ENTER)
    until(page, "return document.querySelector('.keys-found .key-error')?.textContent.includes(\"did you mean 'jpo'?\")")
    assert field.get_attribute("value") == "ssc" and symbol.scenario == before


def test_a_text_proposes_what_there_is(page, symbol):
    for key, name in (
        ("headlight.model", "hd84"),
        ("functions.symbol.image", "chevrons"),
    ):
        proposed = (
            "return [...document.querySelector(`.keys-found [data-key='${arguments[0]}'] input`).list.options].map(({ value }) => value)"
        )
        searched(page, key, key)
        assert name in page.execute_script(proposed, key)


def test_a_function_is_switched_off_and_on_and_its_controller_is_another(page, symbol):
    before = symbol.scenario.functions
    labelled(page, "functions.symbol: on or off").click()
    until_here(lambda: not symbol.scenario.functions)
    page.execute_script("luxloop.store.set({ things: true })")
    until(page, "return document.querySelector('.thing.off .name')?.textContent === 'symbol'")
    page.execute_script("luxloop.store.set({ things: false })")
    labelled(page, "functions.symbol: on or off").click()
    until_here(lambda: symbol.scenario.functions == before)
    until(page, "return document.querySelector(\"[aria-label='functions.symbol.controller: name']\")")
    Select(labelled(page, "functions.symbol.controller: name")).select_by_value("open")
    until_here(lambda: symbol.scenario.symbol.controller.name == "open")
    press(page, Keys.CONTROL, "z")
    until_here(lambda: symbol.scenario.functions == before)


def test_a_disturbance_holds_from_the_next_step_for_a_second(page, symbol):
    run = symbol.run
    page.find_element(By.XPATH, "//*[@aria-label='Disturb']/button[text()='lost frames']").click()
    until_here(lambda: symbol.scenario.disturbances.drops)
    (spell,) = symbol.scenario.disturbances.drops
    assert (spell.from_step, spell.until_step) == (len(run.rows), len(run.rows) + 30)  # at 30 steps a second
    until(page, "return document.querySelector('.disturb [aria-pressed=true]')?.textContent === 'lost frames'")


def test_the_scenario_is_saved_and_the_run_recorded(page, symbol, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where the server makes its folder of recordings
    page.execute_script("URL.createObjectURL = (blob) => { blob.text().then((text) => { window.saved = text; }); return '#'; }")
    press(page, Keys.CONTROL, "s")
    until(page, "return window.saved")
    (tmp_path / "saved.toml").write_text(page.execute_script("return window.saved"))
    assert load(str(tmp_path / "saved.toml")) == symbol.scenario
    for on in ("true", "false"):
        one(page, ".record").click()
        until(page, f"return document.querySelector('.record').ariaPressed === '{on}'")
    (folder,) = (tmp_path / "runs").iterdir()
    assert one(page, ".toast").text == f"Recorded in runs/{folder.name}"
    assert folder.name.startswith("snowflake_") and (folder / "manifest.json").is_file()


def test_a_watcher_reads_and_cannot_change(browser, symbol):
    keys_of(browser, symbol, symbol.tokens.watch)
    controls = browser.find_elements(By.CSS_SELECTOR, ".keys-panel fieldset :is(input, select, button)")
    assert len(controls) > 20 and not any(each.is_enabled() for each in controls)
    row = searched(browser, "position kp", "functions.symbol.controller.position.kp")
    assert row.find_element(By.CSS_SELECTOR, "input[type=number]").get_attribute("value") == "0.75"
