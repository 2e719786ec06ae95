"""The page in a real browser: what it computes is what `world` computes, and what one does arrives."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_dilation
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

from luxloop.loop.studio.messages import Button, Set
from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.runs import Run
from luxloop.loop.studio.sources import Source
from luxloop.world.light.illumination import DirectTransport, illuminance
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, WAIT_S, one, press, until, until_here, visit
from tests.loop.studio.proxy import network

pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def objects() -> Iterator[Served]:
    """Five road users before a car with two lamps of five modules, masks among them."""
    yield from serving(Source("gfhb", (*SMALL, "camera.width_px=640", "camera.height_px=360")), PAGE)


@pytest.fixture(scope="module")
def page(browser: webdriver.Chrome, objects: Served) -> webdriver.Chrome:
    browser.get("about:blank")
    browser.get_log("browser")  # what pages of other files complained of, whose servers have ended
    return visit(browser, objects)


def compared(browser: webdriver.Chrome, run: Run) -> np.ndarray:
    """Illuminance `[3, n]` in lx by the shader, by `world`, and by that without shadows, at 1,000 pixels where the last is 0.5 lx or more.

    They lie farther than 2 px from outlines and from borders of shadows and masks, on which side of which a point lies by rounding.
    """
    lit, lights = run.simulation.world.lit(0.0), run.snapshots[0].lights
    lx, ids = lit.light(list(lights))[0].flatten(), lit.surfaces.object_id
    open_ = torch.zeros_like(lx)
    for transport, u in zip(lit.transports, lights, strict=True):
        assert isinstance(transport, DirectTransport)
        surface = transport.surface
        central = transport.central(surface.index)
        light = illuminance(surface, transport.headlight.light_texture(u))
        open_.index_add_(0, transport.pixel(surface.index)[central], light[central])
    lx, open_ = (each.view(ids.shape).numpy() for each in (lx, open_))
    steps = [np.abs(lx - np.roll(lx, 1, axis)) > 0.1 * open_ + 1e-9 for axis in (0, 1)]
    outlines = [ids.numpy() != np.roll(ids.numpy(), 1, axis) for axis in (0, 1)]
    near = binary_dilation(np.logical_or.reduce([*steps, *outlines]), iterations=3)  # an edge lies between a pixel and the one before it
    index = np.random.default_rng(0).permutation(np.flatnonzero(~near & (open_ >= 0.5)))[:1000]
    points, normals = (each.flatten(1).T[index].flatten().tolist() for each in (lit.surfaces.position, lit.surfaces.normal))
    script = "const [p, n] = arguments; return Array.from(window.luxloop.scenes[0].probe(new Float32Array(p), new Float32Array(n)))"

    def probed(driver: webdriver.Chrome) -> Any:
        shader = np.array(driver.execute_script(script, points, normals))
        return shader.any() and [shader]  # dark until the first light has come

    (shader,) = WebDriverWait(browser, WAIT_S, 0.5).until(probed)
    return np.stack([shader, lx.ravel()[index], open_.ravel()[index]])


@pytest.mark.slow
def test_light_in_the_shader_is_that_of_the_library(browser, objects):
    visit(browser, objects)
    shader, lx, _ = compared(browser, objects.run)
    lit = lx >= 0.5
    assert lit.sum() > 500 and np.abs(shader[lit] / lx[lit] - 1).max() < 0.02


def test_keys_steer_the_loop_on_a_page_that_asks_nobody_else_and_complains_of_nothing(page, objects):
    press(page, ".")
    until(page, "return document.body.innerText.includes('step 1')")
    assert len(objects.run.rows) == 2
    press(page, "r")
    until(page, "return document.body.innerText.includes('step 0')")
    names = page.execute_script("return performance.getEntriesByType('resource').map((each) => each.name)")
    assert names and all(name.startswith(f"http://127.0.0.1:{objects.port}/") for name in names)
    assert not [each["message"] for each in page.get_log("browser") if each["level"] == "SEVERE"]


def test_texts_are_legible_and_controls_have_names(page):
    script = (Path(__file__).parent / "legible.js").read_text("utf-8")
    assert page.execute_script(script) == [[], []]
    for key, there in (("k", ".function"), ("e", ".things"), ("5", ".beam-controls"), ("?", "dialog[open]")):
        press(page, key)
        until(page, f"return document.querySelector('{there}')?.checkVisibility()")
        assert page.execute_script(script) == [[], []], key
    one(page, "dialog[open]").send_keys(Keys.ESCAPE)


def test_a_watcher_sees_and_cannot_steer(browser, objects):
    visit(browser, objects, objects.tokens.watch)
    run = objects.run
    before = len(run.rows)
    press(browser, ".r")
    browser.execute_async_script("const done = arguments[0]; setTimeout(done, 1000)")  # in which an editor's step is done
    assert objects.studio.session.state.runs == (run,) and len(run.rows) == before


def test_a_page_without_a_scenario_offers_those_there_are(browser):
    for served in serving(Source("nowhere"), PAGE):
        browser.get("about:blank")
        browser.get(f"http://127.0.0.1:{served.port}/#{served.tokens.edit}")
        until(browser, "return document.querySelector('.notice')?.textContent.includes('nowhere')")
        one(browser, "[aria-label^='Scenario: ']").click()
        until(browser, "return [...document.querySelectorAll('[role=option]')].some((each) => each.dataset.name === 'gfhb')")


def test_a_page_whose_network_is_cut_goes_on_with_the_same_run(browser, objects):
    with network(objects.port) as between:
        visit(browser, replace(objects, port=between.port))
        run = objects.run
        done = len(run.snapshots)
        between.cut()
        until(browser, "return document.querySelector('.notice').textContent.includes('is cut')")
        between.restore()
        until(browser, "return window.luxloop.store.state.link === 'open' && window.luxloop.store.state.status !== null")
        until(browser, f"return window.luxloop.store.state.runs[0]?.shown?.step === {done - 1}")
        press(browser, ".")
        until(browser, f"return window.luxloop.store.state.runs[0].shown?.step === {done}")
        assert objects.studio.session.state.runs == (run,) and len(run.snapshots) == done + 1


@pytest.mark.slow
def test_a_run_is_steered_scrubbed_and_compared(browser):
    for served in serving(Source("snowflake", SMALL), PAGE):
        visit(browser, served)
        shown = "window.luxloop.store.state.runs[0].shown?"
        for step in (1, 2, 3):
            one(browser, "[aria-label='One step (.)']").click()
            until(browser, f"return {shown}.step === {step}")
        slider = one(browser, ".scrub")
        slider.send_keys(Keys.ARROW_LEFT)
        until(browser, f"return {shown}.scrub && {shown}.step === 2")
        browser.find_element(By.XPATH, "//button[text()='live']").click()
        until(browser, f"return !{shown}.scrub && {shown}.step === 3")

        ActionChains(browser).move_to_element(one(browser, ".camera canvas")).perform()
        until(browser, r"return /^u \d+, v \d+: \d+ of \d+$/.test(document.querySelector('.camera .readout').textContent)")
        assert "camera.off" not in served.run.snapshots[-1].pictures
        Select(one(browser, "[aria-label='Frame of the camera']")).select_by_visible_text("light off")
        until(browser, "return window.luxloop.store.state.runs[0].look?.off && document.querySelector('.camera .empty').hidden")

        keys = one(browser, ".keys")
        keys.send_keys("camera.bitz=10", Keys.ENTER)
        until(browser, "return document.querySelector('.toast')?.textContent.includes('camera.bitz: unknown key')")
        keys.clear()
        keys.send_keys("functions.symbol.controller.position.kp=0.9", Keys.SHIFT, Keys.ENTER)
        until(browser, "return window.luxloop.store.state.runs.length === 2 && window.luxloop.scenes.length === 2")
        gains = [run.simulation.scenario.symbol.controller.position.kp for run in served.studio.session.state.runs]
        assert gains[0] != gains[1] == 0.9


@pytest.mark.slow
def test_every_view_is_drawn(browser, objects, tmp_path):
    visit(browser, objects)
    pictures = []
    for key in "12345":
        press(browser, key)
        browser.execute_async_script("const done = arguments[0]; setTimeout(done, 2000)")
        pictures.append(browser.get_screenshot_as_png())
        (Path(os.environ.get("LUXLOOP_SHOTS", tmp_path)) / f"view{key}.png").write_bytes(pictures[-1])
    assert len(set(pictures)) == 5


def test_shadows_in_the_shader_are_those_of_the_library(browser, objects):
    session = objects.studio.session
    number = session.state.number
    session.ask(Button(type="reset"), print)  # what other tests may have stepped
    until_here(lambda: session.state.number > number)
    (run,) = session.state.runs
    before = run.snapshots[0]
    # lower than the lamps, so that the camera sees its shadow beyond
    box = 'objects=[{name="box", kind="box", category="other", size_m=[0.5, 1.5, 0.4], track=[{position_m=[9.0, 0.0, 0.0]}]}]'
    session.ask(Set(type="set", overrides=("functions={}", "checks={}", "lighting.base.beam=full", box)), print)
    until_here(lambda: run.snapshots[0] is not before)  # in the other world
    visit(browser, objects)
    shader, lx, open_ = compared(browser, run)
    assert (lx < 0.9 * open_).sum() > 20  # in the shadow of one lamp or of both
    assert (np.abs(shader - lx) < 0.02 * open_).all()
