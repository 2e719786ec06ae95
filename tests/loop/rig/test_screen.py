"""The page of the light `screen` in a browser: its pixels are those that were sent, in order, and it darkens when the loop is gone."""

import io
import shutil
import time
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image
from selenium import webdriver

from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import ScreenLightParams
from luxloop.loop.rig.screen import ScreenLight

CHROMIUM, DRIVER = (shutil.which(name) for name in ("chromium", "chromedriver"))
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--force-color-profile=srgb",
    "--window-size=900,700",
)
GRIDS = ((40, 300), (20, 200))
pytestmark = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no browser: apt-get install chromium chromium-driver")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options, webdriver.ChromeService(str(DRIVER)))
    driver.set_script_timeout(30)
    yield driver
    driver.quit()


@pytest.fixture
def light(browser: webdriver.Chrome) -> Iterator[ScreenLight]:
    light = ScreenLight(ScreenLightParams(kind="screen", port=0, dark_after_s=1.0), GRIDS)
    browser.get(f"http://127.0.0.1:{light.port}/")
    light.await_page(lambda address: None, 30)
    yield light
    light.close()


def drawn(browser: webdriver.Chrome) -> np.ndarray:
    """Grey values of the canvas `[height, width, 3]`, as the page itself reads them."""
    data = "Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data)"
    width, height, data = browser.execute_script(f"const c = document.getElementById('light'); return [c.width, c.height, {data}]")
    return np.array(data, np.uint8).reshape(height, width, 4)


def on_screen(browser: webdriver.Chrome) -> np.ndarray:
    """What the screen shows `[height, width, 3]`."""
    return np.asarray(Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB"))


def pictures_of(seed: int) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Pictures of both modules in all codes, and the codes on the screen."""
    codes = [np.random.default_rng(seed + k).integers(0, 256, grid, dtype=np.uint8) for k, grid in enumerate(GRIDS)]
    screen = np.zeros((60, 300), np.uint8)
    screen[:40], screen[40:, :200] = codes
    return tuple((each / np.float32(255)).astype(np.float32) for each in codes), screen


def test_pixels_on_the_screen_are_those_sent(browser, light):
    for number in range(3):
        pictures, codes = pictures_of(number)
        assert light.show(Shine(number, pictures)) is None
        shown = drawn(browser)
        assert (shown[..., :3] == codes[..., None]).all() and (shown[..., 3] == 255).all()
        seen = on_screen(browser)
        assert (seen[:60, :300] == codes[..., None]).all() and not seen[61:].any()


def test_the_page_darkens_by_itself_and_when_told(browser, light):
    light.show(Shine(0, pictures_of(0)[0]))
    light.dark()
    time.sleep(0.2)
    assert not drawn(browser)[..., :3].any()
    light.show(Shine(1, pictures_of(1)[0]))
    assert drawn(browser)[..., :3].any()
    time.sleep(1.2)
    assert not drawn(browser)[..., :3].any()
