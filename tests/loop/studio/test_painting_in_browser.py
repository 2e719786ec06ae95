"""Painting in a real browser: what one draws on a module is its light, in the page and in the loop."""

import base64
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.session import Source
from luxloop.world.lamps.utilisations import read_utilisation
from tests.loop.studio.clients import watching
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, one, until, visit

pytestmark = IN_BROWSER
ROWS, COLUMNS = 3, 28
MARKED = "return [luxloop.painting.layers[0].painted, luxloop.painting.layers[0].value].map((each) => [...each])"
SHOWN = "return [...(luxloop.store.state.runs[0].utilisations.get(0) ?? [])]"


@pytest.fixture(scope="module")
def plain() -> Iterator[Served]:
    """84 pixels a lamp, and nothing but high beam."""
    yield from serving(Source("gfhb", (*SMALL, "headlight.model=hd84", "functions={}", "checks={}", "objects=[]")), PAGE)


@pytest.fixture
def tools(browser: webdriver.Chrome, plain: Served) -> webdriver.Chrome:
    """The page with the tools to paint."""
    until(visit(browser, plain), "return luxloop.store.state.runs[0].utilisations.size === 2")
    browser.execute_script("document.querySelector('.matrix [title=\"Paint pixels\"]').click()")
    return browser


@pytest.fixture
def page(tools: webdriver.Chrome, plain: Served) -> webdriver.Chrome:
    """With nothing painted."""
    clicked(tools, "clear")
    until(tools, "return luxloop.store.state.model.lighting.painted.length === 0")
    run = plain.run

    def shows_it(page: webdriver.Chrome) -> bool:
        """The last snapshot is replaced after the edit was answered, so it is read at each try."""
        return np.array_equal(utilisations(page), (255 * run.snapshots[-1].lights[0]).round().view(ROWS, COLUMNS).numpy())

    WebDriverWait(tools, 20, 0.1).until(shows_it)
    return tools


def clicked(page: webdriver.Chrome, text: str) -> None:
    script = "[...document.querySelectorAll('.paint-tools button')].find((each) => each.textContent === arguments[0]).click()"
    page.execute_script(script, text)


def drawn(page: webdriver.Chrome, *pixels: tuple[int, int]) -> None:
    """A stroke of the mouse over pixels of the left module: row and column each."""
    canvas = one(page, ".matrix canvas")
    places = [page.execute_script("return luxloop.pixelAt(0, ...arguments)", *pixel) for pixel in pixels]
    width, height = canvas.size["width"], canvas.size["height"]
    actions = ActionChains(page, duration=20)
    for k, (x, y) in enumerate(places):
        actions.move_to_element_with_offset(canvas, round(x - width / 2), round(y - height / 2))
        if k == 0:
            actions.click_and_hold()
    actions.release().perform()


def utilisations(page: webdriver.Chrome) -> np.ndarray:
    """Those of the left module that the page has got last."""
    return np.array(page.execute_script(SHOWN)).reshape(ROWS, COLUMNS)


def is_lit(page: webdriver.Chrome, served: Served, expected: np.ndarray) -> None:
    """The left module comes to these utilisations, and what is painted in the page is what the scenario has."""
    WebDriverWait(page, 20, 0.1).until(lambda page: np.array_equal(utilisations(page), expected), str(expected))

    def agree(page: webdriver.Chrome) -> bool:
        painted, value = (np.array(each, np.uint8).reshape(ROWS, COLUMNS) for each in page.execute_script(MARKED))
        params = served.scenario.lighting.painted
        (left,) = (each for each in params if each.module == "left matrix")
        return np.array_equal(left.pictures[1], painted) and np.array_equal(left.pictures[0] * (painted > 0), value)

    WebDriverWait(page, 20, 0.1).until(agree, "page and scenario differ")  # the last part of a stroke may still be under way


def test_a_stroke_is_light_where_it_was_drawn(page, plain):
    before = utilisations(page)
    drawn(page, (0, 3), (0, 8), (2, 8))
    expected = before.copy()
    expected[0, 3:9] = expected[:, 8] = 255
    is_lit(page, plain, expected)
    clicked(page, "eraser")
    drawn(page, (0, 4), (0, 6))
    expected[0, 4:7] = before[0, 4:7]
    is_lit(page, plain, expected)


def test_it_is_shown_in_place_of_the_functions_and_filled(page, plain):
    clicked(page, "line")
    drawn(page, (0, 14), (2, 14))
    page.execute_script("luxloop.painting.value = 51; luxloop.painting.setOver(false)")
    clicked(page, "fill")
    drawn(page, (1, 20))
    expected = np.zeros((ROWS, COLUMNS))
    expected[:, 14], expected[:, 15:] = 255, 51
    is_lit(page, plain, expected)
    page.execute_script("luxloop.painting.value = 255; luxloop.painting.setOver(true)")


def test_undo_takes_a_stroke_off_the_page(page, plain):
    before = utilisations(page)
    clicked(page, "brush")
    drawn(page, (0, 3), (0, 8))
    until(page, "return luxloop.store.state.runs[0].utilisations.get(0).slice(3, 9).every((each) => each === 255)")  # all of it has arrived
    ActionChains(page).key_down(Keys.CONTROL).send_keys("z").key_up(Keys.CONTROL).perform()
    until(page, "return luxloop.painting.layers[0].painted.every((each) => each === 0)")
    WebDriverWait(page, 20, 0.1).until(lambda page: np.array_equal(utilisations(page), before))


def test_a_text_is_written_where_one_clicks(page, plain):
    clicked(page, "text")
    page.execute_script("luxloop.painting.thickness = 3")
    drawn(page, (2, 9))
    until(page, "return document.activeElement === document.querySelector('.paint-tools .words')")
    page.switch_to.active_element.send_keys("H")
    drawn(page, (2, 9))
    until(page, "return luxloop.painting.layers[0].painted.some((each) => each)")
    painted = np.array(page.execute_script(MARKED)[0]).reshape(ROWS, COLUMNS)
    assert painted[:, :9].sum() == painted[:, 14:].sum() == 0
    page.execute_script("luxloop.painting.thickness = 1")
    clicked(page, "brush")


def test_files_are_taken_where_they_fit_and_saved_as_shown(page, plain, tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (ROWS, COLUMNS)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "mine.png"), picture)
    np.savetxt(tmp_path / "wrong.csv", np.zeros((4, COLUMNS)), delimiter=",")
    file = one(page, ".paint-tools input[type=file]")
    file.send_keys(str(tmp_path / "wrong.csv"))
    until(page, "return document.body.innerText.includes('wrong.csv: has 4 x 28 pixels, but left matrix has 3 x 28')")
    file.send_keys(str(tmp_path / "mine.png"))
    until(page, "return luxloop.painting.layers[0].painted.every((each) => each === 255)")
    is_lit(page, plain, picture)
    page.execute_script(
        """const make = URL.createObjectURL;
        URL.createObjectURL = (blob) => { window.made = blob; return make.call(URL, blob); };
        HTMLAnchorElement.prototype.click = function () { (window.saved ??= {})[this.download] = window.made; };"""
    )
    for kind in ("PNG", "CSV"):
        clicked(page, kind)
    until(page, "return Object.keys(window.saved ?? {}).length === 2")
    for name in ("left_matrix.png", "left_matrix.csv"):
        script = """const [name, done] = arguments, reader = new FileReader();
            reader.onload = () => done(reader.result.split(',')[1]);
            reader.readAsDataURL(saved[name]);"""
        (tmp_path / name).write_bytes(base64.b64decode(page.execute_async_script(script, name)))
        assert np.array_equal((255 * read_utilisation(tmp_path / name, ROWS, COLUMNS)).round(), picture.ravel())


@pytest.mark.slow
def test_what_another_client_paints_is_shown(page, plain):
    before = utilisations(page)
    drawn(page, (1, 1))
    before[1, 1] = 255
    is_lit(page, plain, before)
    with watching(plain.port, plain.tokens.edit) as other:
        other.say("pen")
        spot = {"value": np.full((1, 2), 77, np.uint8), "painted": np.full((1, 2), 255, np.uint8)}
        other.say("paint", spot, module=0, box=[2, 3, 5, 7])
        until(page, "return luxloop.store.state.runs[0].utilisations.get(0)[2 * 28 + 6] === 77")
