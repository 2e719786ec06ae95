"""Choosing, dragging, adding and removing in the scene, in a real browser: where the pointer is, there it is in the loop."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from luxloop import Scenario
from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.session import Source
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, one, press, until, until_here, visit

pytestmark = IN_BROWSER
CARPET = 'functions.carpet={kind = "primitive", x_m = 12.0, width_m = 4.0, length_m = 8.0}'
WALL = '{name = "wall", kind = "box", size_m = [0.5, 2.0, 1.5], category = "other", track = [{position_m = [14.0, 3.0, 0.0]}]}'
CORNER = (-3.0, -1.5, 0.0)  # m from the carpet's middle: there are no handles
FINE_M = 0.005  # a key is rounded to 1 mm, and the page computes with single precision 50 m around

PIVOT = "const p = luxloop.placing; return p.gizmo.control.object.position.toArray()"
HANDLE = """
const [mode, axis] = arguments, gizmo = luxloop.placing.gizmo.control.getHelper().children[0];
luxloop.scenes[0].renderNow();
const mesh = gizmo.picker[mode].children.find((each) => each.name === axis);
mesh.geometry.computeBoundingBox();
const middle = mesh.geometry.boundingBox.getCenter(mesh.position.clone()).applyMatrix4(mesh.matrixWorld);
return luxloop.scenes[0].pixel(middle).toArray()"""
RING = """
const mesh = luxloop.placing.gizmo.control.getHelper().children[0].gizmo.rotate.children.find((each) => each.name === arguments[0]);
luxloop.scenes[0].renderNow();
const { position } = mesh.geometry.attributes, place = mesh.position.clone();
const pixels = Array.from({ length: position.count }, (_, k) => place.fromBufferAttribute(position, k).applyMatrix4(mesh.matrixWorld))
  .map((each) => luxloop.scenes[0].pixel(each).toArray());
return pixels.reduce((low, each) => (each[1] > low[1] ? each : low))"""  # where it is nearest
PLACE = """
const [key, ...point] = arguments, { placing, scenes } = luxloop;
const thing = placing.things.find((each) => each.key === key);
return scenes[0].pixel(thing.bounds.min.clone().set(...point).applyMatrix4(placing.local(thing))).toArray()"""


@pytest.fixture(scope="module")
def plain() -> Iterator[Served]:
    """A primitive and a wall on a flat road, and 84 pixels a lamp."""
    given = ("headlight.model=hd84", "functions={}", CARPET, "checks={}", "camera.noise=false", f"objects=[{WALL}]")
    yield from serving(Source("gfhb", (*SMALL, *given)), PAGE)


@pytest.fixture
def page(browser: webdriver.Chrome, plain: Served) -> webdriver.Chrome:
    visit(browser, plain)
    press(browser, "e")
    until(browser, "return luxloop.scenes[0].pick(150, 200) !== null && luxloop.placing.things.length > 2")
    until(browser, "return !document.querySelector('aside.things').hidden")
    return browser


def chosen(page: webdriver.Chrome, key: str) -> None:
    one(page, f'.things-list [data-key="{key}"]').click()
    until(page, f"return luxloop.store.state.chosen.join() === '{key}'")


def dragged(page: webdriver.Chrome, start: tuple[float, float], by: tuple[int, int]) -> np.ndarray:
    """Drag with the left button from one pixel of the scene's canvas to another; returns both, which are whole."""
    canvas = one(page, ".scene-view canvas")
    middle = canvas.size["width"] // 2, canvas.size["height"] // 2
    first = round(start[0]), round(start[1])
    last = first[0] + by[0], first[1] + by[1]
    actions = ActionChains(page, duration=50)
    for k in range(5):
        x, y = (round(a + (b - a) * k / 4) for a, b in zip(first, last, strict=True))
        actions.move_to_element_with_offset(canvas, x - middle[0], y - middle[1])
        if k == 0:
            actions.click_and_hold()
    actions.release().perform()
    until(page, "return !luxloop.placing.isDragging && !luxloop.store.state.edits_pending")
    return np.array([first, last])


def clicked(page: webdriver.Chrome, x: int, y: int) -> None:
    canvas = one(page, ".scene-view canvas")
    ActionChains(page).move_to_element_with_offset(canvas, x - canvas.size["width"] // 2, y - canvas.size["height"] // 2).click().perform()


def picked(page: webdriver.Chrome, pixel: Any) -> np.ndarray:
    """Point of the road `[3]` m under a pixel."""
    return np.array(page.execute_script("return luxloop.scenes[0].pick(...arguments)", *(float(v) for v in pixel)))


def waited(served: Served, fits: Callable[[Scenario], bool]) -> Scenario:
    until_here(lambda: fits(served.scenario))
    return served.scenario


def test_an_arrow_of_the_gizmo_moves_a_primitive_along_its_axis(page, plain):
    before = plain.scenario.functions["carpet"]
    chosen(page, "functions.carpet")
    start = page.execute_script(HANDLE, "translate", "Y")
    dragged(page, start, (-40, 0))
    after = plain.scenario.functions["carpet"]
    assert after.y_m > before.y_m + 0.5 and after.model_copy(update={"y_m": before.y_m}) == before
    assert page.execute_script(PIVOT) == pytest.approx([after.x_m, after.y_m, after.z_m], abs=FINE_M)
    end = page.execute_script(HANDLE, "translate", "Y")
    assert end[0] - start[0] == pytest.approx(-40, abs=4)  # the arrow follows the pointer, and is drawn in another size farther off


def test_what_is_chosen_is_dragged_over_the_road(page, plain):
    before = plain.scenario.functions["carpet"]
    chosen(page, "functions.carpet")
    x, y = page.execute_script(PLACE, "functions.carpet", *CORNER)
    pixels = dragged(page, (x, y), (30, 12))
    by = picked(page, pixels[1]) - picked(page, pixels[0])
    after = plain.scenario.functions["carpet"]
    assert np.hypot(*by[:2]) > 0.5
    to = np.array([before.x_m, before.y_m]) + by[:2]
    assert [after.x_m, after.y_m] == pytest.approx(np.round(to, 1), abs=FINE_M)  # in steps of 0.1 m


@pytest.mark.slow
def test_handles_turn_and_scale_about_the_middle(page, plain):
    chosen(page, "functions.carpet")
    before = plain.scenario.functions["carpet"]
    press(page, "b")
    width = page.execute_script(HANDLE, "scale", "Y")
    middle = page.execute_script(PLACE, "functions.carpet", 0, 0, 0)
    dragged(page, width, (round(0.5 * (width[0] - middle[0])), 0))
    scaled = plain.scenario.functions["carpet"]
    assert scaled.width_m / before.width_m == pytest.approx(1.5, abs=0.05)  # pixels are whole, and the handle is 25 px away
    assert scaled.model_copy(update={"width_m": before.width_m}) == before
    press(page, "t")
    ring = page.execute_script(RING, "Z")
    dragged(page, ring, (20, 10))
    turned = plain.scenario.functions["carpet"]
    assert abs(turned.yaw_deg - before.yaw_deg) > 2
    assert turned.model_copy(update={"yaw_deg": scaled.yaw_deg}) == scaled
    press(page, "g")


@pytest.mark.slow
def test_what_is_chosen_together_moves_together(page, plain):
    chosen(page, "functions.carpet")
    page.execute_script("luxloop.placing.choose('objects[0]', true)")
    until(page, "return luxloop.placing.chosen.length === 2")
    before = plain.scenario
    dragged(page, page.execute_script(HANDLE, "translate", "Y"), (-30, 0))
    after = waited(plain, lambda now: now.objects != before.objects)
    by_m = after.functions["carpet"].y_m - before.functions["carpet"].y_m
    wall, old = (each.objects[0].track[0].position_m for each in (after, before))
    assert by_m > 0.3 and wall == pytest.approx((old[0], old[1] + by_m, old[2]), abs=FINE_M)
    assert after.functions["carpet"].x_m == before.functions["carpet"].x_m


def test_an_object_is_dragged_and_prepared_anew_where_it_was_let_go(page, plain):
    number = plain.studio.session.state.number
    chosen(page, "objects[0]")
    x, y = page.execute_script(PLACE, "objects[0]", 0, 0.8, 1.2)
    pixels = dragged(page, (x, y), (-25, 8))
    after = waited(plain, lambda now: now.objects[0].track[0].position_m[0] != 14.0).objects[0].track[0].position_m
    shown = "luxloop.scenes[0].body('wall')?.T.elements.slice(12, 15)"
    until(page, f"return Math.abs({shown}[0] - {after[0]}) < {FINE_M}")  # the next picture has it
    assert page.execute_script(f"return {shown}") == pytest.approx(after, abs=FINE_M)
    assert np.abs(pixels[1] - pixels[0]).max() == 25
    there = np.array(page.execute_script(PLACE, "objects[0]", 0, 0.8, 1.2))
    assert there - [x, y] == pytest.approx([-25, 8], abs=2)  # pixels are whole
    assert plain.studio.session.state.number == number  # the run goes on


def test_a_click_on_the_road_places_a_primitive_and_delete_removes_it(page, plain):
    Select(one(page, ".things [aria-label=Add]")).select_by_visible_text("primitive on the road")
    until(page, "return luxloop.placing.clicking !== null")
    pixel = (150, 200)
    expected = picked(page, pixel)
    clicked(page, *pixel)
    until(page, "return luxloop.placing.chosen.some(({ key }) => key === 'functions.primitive')")
    made = plain.scenario.functions["primitive"]
    assert [made.x_m, made.y_m, made.z_m] == pytest.approx(np.round(expected, 1), abs=FINE_M)  # in steps of 0.1 m
    press(page, Keys.DELETE)
    assert waited(plain, lambda now: "primitive" not in now.functions).functions.keys() == {"carpet"}


@pytest.mark.slow
def test_an_object_is_duplicated_switched_off_and_on_and_removed(page, plain):
    chosen(page, "objects[0]")
    press(page, "D")
    both = waited(plain, lambda now: len(now.objects) == 2).objects
    assert both[1].name == "wall_2" and both[1].track[0].position_m[1] == pytest.approx(both[0].track[0].position_m[1] + 1)
    until(page, "return luxloop.placing.chosen[0]?.key === 'objects[1]'")
    page.find_element(By.XPATH, "//button[text()='Switch off']").click()
    assert waited(plain, lambda now: len(now.objects) == 1).objects == both[:1]
    until(page, "return document.querySelector('.thing.off') !== null")
    one(page, ".thing.off").click()
    assert waited(plain, lambda now: len(now.objects) == 2).objects == both
    until(page, "return luxloop.placing.chosen[0]?.key === 'objects[1]'")
    press(page, Keys.DELETE)
    assert waited(plain, lambda now: len(now.objects) == 1).objects == both[:1]


@pytest.mark.slow
def test_an_object_goes_a_course_of_clicked_points_and_halts(page, plain):
    chosen(page, "objects[0]")
    start = plain.scenario.objects[0].track[0].position_m
    page.find_element(By.XPATH, "//button[text()='Course']").click()
    until(page, "return luxloop.placing.clicking !== null")
    pixels = [(150, 200), (180, 190)]
    points = [picked(page, pixel) for pixel in pixels]
    for pixel in pixels:
        clicked(page, *pixel)
    press(page, Keys.ENTER)
    path = waited(plain, lambda now: now.objects[0].path is not None).objects[0].path
    assert path is not None and np.array(path.points_m) == pytest.approx(np.array([start, *points]), abs=FINE_M)
    until(page, "return !luxloop.store.state.edits_pending")
    page.find_element(By.XPATH, "//button[text()='Halt']").click()
    (pose,) = waited(plain, lambda now: now.objects[0].path is None).objects[0].track
    assert np.hypot(pose.position_m[0] - start[0], pose.position_m[1] - start[1]) < 0.5  # of the way of a step or two at 2 m/s


def test_a_watcher_can_choose_and_not_drag(browser, plain):
    visit(browser, plain, plain.tokens.watch)
    press(browser, "e")
    before = plain.scenario
    chosen(browser, "functions.carpet")
    assert browser.execute_script("return luxloop.placing.gizmo.control.object === undefined")
    x, y = browser.execute_script(PLACE, "functions.carpet", *CORNER)
    dragged(browser, (x, y), (30, 12))
    press(browser, Keys.DELETE)
    assert plain.scenario == before
