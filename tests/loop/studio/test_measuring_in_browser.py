"""Figures under the cursor in a real browser: those of the place that is seen there, and those of the library."""

import csv
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.keys import Keys

from luxloop.loop.studio.page import PAGE
from luxloop.loop.studio.sources import Source
from tests.loop.studio.conftest import SMALL, Served, serving
from tests.loop.studio.pages import IN_BROWSER, one, press, until, visit

pytestmark = IN_BROWSER
HIGH_BEAM = (*SMALL, "lighting.base.beam=high", "functions={}", "checks={}")
SAME_PLACE = """const [x, y] = arguments, seen = luxloop.scenes[0].pick(x, y), { meter } = luxloop.store.state;
    const found = meter?.readings?.[0]?.point_m;
    return found && Math.hypot(...found.map((each, k) => each - seen[k])) < 0.02 && { found, ...meter.readings[0] }"""
SHADER = "const [p, n] = arguments; return luxloop.scenes[0].probe(new Float32Array(p), new Float32Array(n))[0]"

NUMBERS = """const { left, top } = document.querySelector('.scene canvas').getBoundingClientRect();
    return [...document.querySelectorAll('.scene-labels span')]
      .filter((each) => /^[\\d.]+$/.test(each.innerText) && each.checkVisibility({ visibilityProperty: true }))
      .map((each) => [each.innerText, each.getBoundingClientRect()])
      .map(([text, box]) => [text, (box.left + box.right) / 2 - left, (box.top + box.bottom) / 2 - top])"""
# a pixel of an object within a facet: beside an edge the neighbouring facet throws a shadow of up to two texels of the page's shadow map
OF_OBJECT = """const [view, name] = [luxloop.scenes[0], arguments[0]], { clientWidth: w, clientHeight: h } = view.canvas, seen = [];
    const facet = (x, y) => {
      const hit = view.hit(x, y);
      return hit?.object === name ? hit.normal.map((each) => each.toFixed(3)).join() : null;
    };
    const around = [-2, 0, 2].flatMap((dx) => [-2, 0, 2].map((dy) => [dx, dy]));
    for (let x = 2; x < w - 2; x += 2) for (let y = 2; y < h - 2; y += 2) {
      const here = facet(x, y);
      if (here && around.every(([dx, dy]) => facet(x + dx, y + dy) === here)) seen.push([x, y]);
    }
    return seen[seen.length >> 1]"""
IN_WORLD = """const [name, point, normal] = arguments, { elements: e } = luxloop.scenes[0].body(name).T;
    const turned = (v) => [0, 1, 2].map((k) => e[k] * v[0] + e[4 + k] * v[1] + e[8 + k] * v[2]);
    return [turned(point).map((each, k) => each + e[12 + k]), turned(normal)]"""


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    """Two lamps with the high beam before five road users."""
    yield from serving(Source("gfhb", HIGH_BEAM), PAGE)


@pytest.fixture
def page(browser: webdriver.Chrome, served: Served) -> webdriver.Chrome:
    return visit(browser, served)


def hover(page: webdriver.Chrome, css: str, x: int, y: int) -> tuple[float, float]:
    """Move the cursor by CSS pixels from the middle of an element; returns where it is in it."""
    element = one(page, css)
    ActionChains(page).move_to_element_with_offset(element, x, y).perform()
    size = page.execute_script("return [arguments[0].clientWidth, arguments[0].clientHeight]", element)
    return size[0] // 2 + x, size[1] // 2 + y


def figures(page: webdriver.Chrome) -> dict[str, float]:
    """Numbers of the line, by name."""
    script = (
        "return Object.fromEntries([...document.querySelectorAll('.figures [data-figure]')].map((e) => [e.dataset.figure, e.innerText]))"
    )
    texts = page.execute_script(script)
    return {name: float(text.split()[1].replace("\u2212", "-")) for name, text in texts.items()}


def told(reading: dict[str, Any]) -> dict[str, float]:
    """The same numbers of a reading."""
    x, y, z = reading["ground_m"]
    light = {"E": reading["lx"], "Ev": reading["vertical_lx"], "L": reading["cd_m2"], "I": reading["cd"]}
    return {"x": x, "y": y, "z": z, "H": reading["h_deg"], "V": reading["v_deg"], "d": reading["distance_m"]} | light


@pytest.mark.parametrize(("viewpoint", "y"), [("orbit", 30), ("above", 40), ("driver", 20), ("oncoming", 30), ("wall", -10)])
def test_figures_are_those_of_the_place_under_the_cursor(page, viewpoint, y):
    page.execute_script(f"luxloop.store.set({{ viewpoint: '{viewpoint}' }})")
    at = hover(page, ".scene canvas", 12, y)
    reading = until(page, SAME_PLACE.replace("arguments", str([*at]), 1))
    until(page, "return document.querySelector('.figures [data-figure=E]')")
    shown = figures(page)
    for name, value in told(reading).items():
        if name in shown:  # not the wall's luminance
            assert shown[name] == pytest.approx(value, rel=6e-3, abs=6e-3), name  # three digits, or centimetres
    assert {"x", "y", "z", "H", "V", "E", "I"} <= shown.keys()
    if viewpoint != "wall":
        shader = page.execute_script(SHADER, reading["point_m"], reading["normal"])
        assert shader == pytest.approx(reading["lx"], rel=0.02, abs=1e-3)  # 2 %: what the picture differs by from the library


def test_figures_of_a_pixel_of_the_camera_are_those_of_its_image(page, served):
    hover(page, ".camera canvas", 3, 30)
    until(page, "return /^u /.test(document.querySelector('.camera .readout').textContent)")
    u, v = page.execute_script("return document.querySelector('.camera .readout').textContent.match(/\\d+/g).slice(0, 2).map(Number)")
    scene = served.run.simulation.world.lit(0.0)
    lx, cd_m2 = (each[v, u] for each in scene.light([torch.clone(each) for each in served.run.snapshots[0].lights]))
    until(page, f"return Math.abs(luxloop.store.state.meter?.readings?.[0]?.lx / {float(lx)} - 1) < 1e-5")
    shown = figures(page)
    assert float(lx) > 0.5 and shown["E"] == pytest.approx(float(lx), rel=6e-3)  # three digits
    assert shown["L"] == pytest.approx(float(cd_m2 + scene.base[v, u]), rel=6e-3)


def test_a_line_across_the_wall_is_a_profile_of_the_library(page):
    page.execute_script("luxloop.store.set({ viewpoint: 'wall', aim: 'line' })")
    page.execute_script("luxloop.store.on(['meter'], ({ meter }) => { if (meter?.readings?.length > 1) window.profile = meter.readings; })")
    canvas = one(page, ".scene canvas")
    hover(page, ".scene canvas", -120, -5)
    ActionChains(page).click_and_hold().move_to_element_with_offset(canvas, 120, -5).release().perform()
    readings = until(page, "return window.profile?.at(-1).h_deg > 3 && window.profile")  # of the whole line
    h, lx = (np.array([each[key] for each in readings]) for key in ("h_deg", "lx"))
    step = np.diff(h)
    assert len(h) == 201 and h[0] < -3 and h[-1] > 3 and (step > 0).all() and step.max() < 1.2 * step.min()
    assert lx.max() > 10 and until(page, "return document.querySelector('.profile canvas')?.checkVisibility()")
    page.execute_script("luxloop.store.set({ aim: null, viewpoint: 'orbit' })")
    until(page, "return !document.querySelector('.profile').checkVisibility()")  # a line of the wall is none of the road


def test_the_wheel_zooms_the_wall_at_the_cursor_and_labels_never_overlap(page):
    page.execute_script("luxloop.store.set({ viewpoint: 'wall', rule: 'r149-driving-a' })")
    until(page, "return [...document.querySelectorAll('.scene-labels span')].some((each) => each.innerText === 'H-V')")
    x, y = hover(page, ".scene canvas", 60, -10)
    place = "return luxloop.scenes[0].pick(...arguments)"
    before, corner = page.execute_script(place, x, y), page.execute_script(place, 5, 5)
    for turns in (1, 5, 6):
        script = """const [canvas, x, y, n] = arguments, { left, top } = canvas.getBoundingClientRect();
            const at = { deltaY: -100, clientX: left + x, clientY: top + y, cancelable: true };
            for (let k = 0; k < n; k++) canvas.dispatchEvent(new WheelEvent('wheel', at));
            luxloop.scenes[0].renderNow();"""
        page.execute_script(script, one(page, ".scene canvas"), x, y, turns)
        boxes = page.execute_script(
            "return [...document.querySelectorAll('.scene-labels span:not([aria-hidden])')]"
            ".filter((each) => each.checkVisibility({ visibilityProperty: true }))"
            ".map((each) => each.getBoundingClientRect()).map(({ left, top, right, bottom }) => [left, top, right, bottom])"
        )
        assert len(boxes) > 5
        for k, a in enumerate(boxes):
            # half a pixel: sizes are rounded
            assert not any(a[0] < b[2] - 0.5 and b[0] < a[2] - 0.5 and a[1] < b[3] - 0.5 and b[1] < a[3] - 0.5 for b in boxes[:k])
    assert page.execute_script(place, x, y) == pytest.approx(before, abs=0.02)  # m, of the 30 m that were shown; a pixel is 4 cm
    assert abs(page.execute_script(place, 5, 5)[1] - before[1]) < 0.5 * abs(corner[1] - before[1])
    page.execute_script("arguments[0].dispatchEvent(new MouseEvent('dblclick'))", one(page, ".scene canvas"))
    assert page.execute_script(place, 5, 5) == pytest.approx(corner, abs=1e-6)
    page.execute_script("luxloop.store.set({ rule: '' })")


def test_axes_of_the_wall_have_their_names_where_its_controls_make_it_smaller(page):
    page.execute_script("luxloop.store.set({ viewpoint: 'wall' })")
    for name in ("angle up", "horizontal angle to the right"):
        label = f"[...document.querySelectorAll('.scene-labels span')].find((each) => each.innerText === '{name}')"
        until(page, f"return {label}?.checkVisibility({{ visibilityProperty: true }})")
    page.execute_script("luxloop.store.set({ viewpoint: 'orbit' })")


def test_a_drag_that_begins_on_a_label_moves_the_wall_and_selects_no_text(page):
    page.execute_script("luxloop.store.set({ viewpoint: 'wall', rule: 'r149-driving-a' })")
    place = "luxloop.scenes[0].renderNow(); return luxloop.scenes[0].pick(5, 5)[1]"
    label = (
        "[...document.querySelectorAll('.scene-labels [title]')].find((each) => each.innerText.includes('H-V') && each.checkVisibility())"
    )
    whole = page.execute_script(place)
    ActionChains(page).scroll_from_origin(ScrollOrigin.from_element(until(page, f"return {label}")), 0, -120).perform()
    before = until(
        page, f"const now = (() => {{ {place} }})(); return now < {whole} - 0.1 && now"
    )  # m; nearer, so that there is room to move
    at = ActionChains(page).move_to_element(until(page, f"return {label}"))
    at.click_and_hold().move_by_offset(20, 0).move_by_offset(20, 0).release().perform()
    until(page, f"return (() => {{ {place} }})() > {before} + 0.1")  # m to the left
    assert page.execute_script("return getSelection().toString()") == ""
    page.execute_script("arguments[0].dispatchEvent(new MouseEvent('dblclick'))", one(page, ".scene canvas"))
    page.execute_script("luxloop.store.set({ rule: '', viewpoint: 'orbit' })")


@pytest.mark.parametrize("viewpoint", ["above", "orbit", "wall"])
def test_numbers_of_isolux_lines_agree_with_the_figures_there(page, viewpoint):
    page.execute_script(f"luxloop.store.set({{ viewpoint: '{viewpoint}', isolux: true, rule: '' }}); luxloop.scenes[0].renderNow()")
    # the view's light comes with the next message from the server
    numbers = until(page, f"const found = (() => {{ {NUMBERS} }})(); return new Set(found.map(([text]) => text)).size >= 3 && found")
    canvas = one(page, ".scene canvas")
    width, height = canvas.size["width"], canvas.size["height"]
    for text, x, y in numbers:
        at = hover(page, ".scene canvas", round(x) - width // 2, round(y) - height // 2)
        reading = until(page, SAME_PLACE.replace("arguments", str([*at]), 1))
        # the middle of a number is at most 0.7 px from the cursor, the light changes by 15 % a pixel where lines are numbered at all
        assert reading["lx"] == pytest.approx(float(text), rel=0.1), (x, y)
    page.execute_script("luxloop.store.set({ isolux: false }); luxloop.scenes[0].renderNow()")
    assert page.execute_script(NUMBERS) == []


def test_the_profile_covers_neither_the_wall_nor_its_verdicts(page):
    page.set_window_size(1280, 808)
    page.execute_script("luxloop.store.set({ viewpoint: 'wall', rule: 'r149-driving-a', aim: 'line' })")
    until(page, "return document.querySelector('.beam-list').checkVisibility()")
    hover(page, ".scene canvas", -60, 40)  # beside the test points, whose labels the mouse can touch
    ActionChains(page).click_and_hold().move_to_element_with_offset(one(page, ".scene canvas"), 60, 40).release().perform()
    until(page, "return document.querySelector('.profile').checkVisibility()")
    for maximised in ("null", "'scene'"):
        covered = page.execute_script(
            f"luxloop.store.set({{ maximised: {maximised} }});"
            "const box = document.querySelector('.profile').getBoundingClientRect();"
            "return [...document.querySelectorAll('.panel')].filter((each) => each.checkVisibility())"
            ".map((each) => [each.dataset.panel, each.getBoundingClientRect()])"
            ".filter(([, { left, top, right, bottom }]) => left < box.right && box.left < right && top < box.bottom && box.top < bottom)"
            ".map(([name]) => name)"
        )
        assert covered == []
    page.execute_script("luxloop.store.set({ aim: null, viewpoint: 'orbit', rule: '', maximised: null })")


def test_the_csv_of_the_wall_holds_the_light_at_its_angles(page):
    page.execute_script(
        "URL.createObjectURL = (blob) => { blob.text().then((text) => { window.csv = text; }); return '#'; };"
        "luxloop.store.set({ viewpoint: 'wall', rule: '' }); document.querySelectorAll('.figures .segments button')[2].click()"
    )
    names, *lines = csv.reader(until(page, "return window.csv").splitlines())
    assert {line[names.index("surface")] for line in lines} == {"wall"}
    number = {name: np.array([float(line[k] or "nan") for line in lines]) for k, name in enumerate(names) if name != "surface"}
    assert sorted({round(each, 3) for each in number["h_deg"]}) == [*np.arange(-24, 24.5, 0.5)]
    assert sorted({round(each, 3) for each in number["v_deg"]}) == [*np.arange(-8, 6.5, 0.5)]
    assert len(lines) == 97 * 29 and number["lx"].max() > 10
    hover(page, ".scene canvas", 25, -12)
    reading = until(page, "const { meter } = luxloop.store.state; return meter?.readings?.length === 1 && meter.readings[0]")
    nearest = np.argsort(np.hypot(number["h_deg"] - reading["h_deg"], number["v_deg"] - reading["v_deg"]))[:4]
    assert number["lx"][nearest].min() * 0.98 <= reading["lx"] <= number["lx"][nearest].max() * 1.02  # 2 %: curvature within half a degree
    page.execute_script("luxloop.store.set({ viewpoint: 'orbit' })")


@pytest.mark.parametrize(("viewpoint", "surface", "frame"), [("driver", "car_ahead", "car_ahead"), ("wall", "wall", "car")])
def test_a_probe_kept_on_an_object_or_the_wall_rides_along(page, served, viewpoint, surface, frame):
    page.execute_script(f"luxloop.store.set({{ viewpoint: '{viewpoint}', aim: 'probe' }}); luxloop.scenes[0].renderNow()")
    canvas = one(page, ".scene canvas")
    width, height = canvas.size["width"], canvas.size["height"]
    # the wall where no road user stands before it
    x, y = (width // 2 + 10, height // 2 - 22) if surface == "wall" else page.execute_script(OF_OBJECT, surface)
    hover(page, ".scene canvas", x - width // 2, y - height // 2)
    ActionChains(page).click().perform()
    until(page, "return luxloop.store.state.model.probes.probe")
    reading = page.execute_script("return luxloop.store.state.meter.readings[0]")
    probe = served.scenario.probes["probe"]
    assert (reading["surface"], probe.frame) == (surface, frame) and reading["lx"] > 0.1
    press(page, ".")
    lx = until(page, "return luxloop.store.state.runs[0].rows.column('probes.probe.lx')?.[1]")
    if surface == "wall":  # the light of the car's own lamps, which ride along too
        assert lx == pytest.approx(reading["lx"], rel=1e-3)  # the probe's place is rounded to 0.1 mm, its normal to 1e-4
    else:
        ahead = IN_WORLD.replace("arguments", str([surface, [*probe.position_m], [*probe.facing]]), 1)
        here = reading["point_m"][0]
        point, normal = until(page, f"const found = (() => {{ {ahead} }})(); return found[0][0] > {here} + 0.3 && found")  # m, of 10 m/s
        assert lx == pytest.approx(page.execute_script(SHADER, point, normal), rel=0.02)  # what the picture differs by from the library
    page.execute_script("luxloop.store.set({ aim: null })")
    press(page, Keys.CONTROL, "z")
    until(page, "return !luxloop.store.state.model.probes?.probe")
    press(page, "r")
    until(page, "return document.body.innerText.includes('step 0')")


def test_a_click_keeps_a_probe_with_the_light_that_the_cursor_told(page, served):
    page.execute_script("luxloop.store.set({ viewpoint: 'driver', aim: 'probe' })")
    told = {}
    for name, css, y in (("probe", ".scene canvas", 20), ("probe_2", ".camera canvas", 30)):
        hover(page, css, 12, y)
        ActionChains(page).click().perform()
        until(page, f"return luxloop.store.state.model.probes.{name}")
        told[name] = page.execute_script("return luxloop.store.state.meter.readings[0].lx")
    assert served.scenario.probes["probe"].frame == "world" and min(told.values()) > 0.1
    press(page, ".")
    until(page, "return luxloop.store.state.runs[0].rows.count === 2")
    values = page.execute_script(
        "return ['probe', 'probe_2'].map((each) => luxloop.store.state.runs[0].rows.column(`probes.${each}.lx`)[1])"
    )
    # the probe's place is rounded to 0.1 mm, its normal to 1e-4
    assert values == pytest.approx([*told.values()], rel=1e-3)
    text = until(
        page, "return [...document.querySelectorAll('.scene-labels span')].find((e) => /^probe .* lx/.test(e.innerText))?.innerText"
    )
    assert float(text.split()[1]) == pytest.approx(told["probe"], rel=6e-3)  # three digits
    until(page, "return [...document.querySelectorAll('.chart h3')].some((e) => e.innerText.startsWith('Illuminance on probes'))")
    page.execute_script(
        "URL.createObjectURL = (blob) => { blob.text().then((text) => { window.curves = text; }); return '#'; };"
        "[...document.querySelectorAll('.curves button')].find((each) => each.innerText === 'CSV').click()"
    )
    saved = [*csv.DictReader(until(page, "return window.curves").splitlines())]
    assert [float(each["time_s"]) for each in saved] == [0, pytest.approx(1 / served.scenario.rate_hz)]
    assert [float(saved[1][f"probes.{name}.lx"]) for name in ("probe", "probe_2")] == pytest.approx(values)
    assert saved[0]["probes.probe.lx"] == ""  # before it was kept
    page.execute_script("luxloop.store.set({ aim: null })")
    for left in (1, 0):
        press(page, Keys.CONTROL, "z")
        until(page, f"return Object.keys(luxloop.store.state.model.probes).length === {left}")
