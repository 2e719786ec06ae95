"""The page in a real browser, which all files share: how it is opened and waited for."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

from luxloop.loop.studio.page import PAGE
from tests.loop.studio.conftest import Served

CHROMIUM, DRIVER = (shutil.which(name) for name in ("chromium", "chromedriver"))
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--window-size=1280,800",
)
WAIT_S = 180  # for a scenario to be prepared on a busy machine with software WebGL
IN_BROWSER = [
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no browser: apt-get install chromium chromium-driver"),
    pytest.mark.skipif(not (PAGE / "index.html").is_file(), reason="the page is not built: make studio"),
]


@contextmanager
def chromium(profile: Path) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(str(DRIVER)))
    driver.set_script_timeout(WAIT_S)
    yield driver
    driver.quit()


def visit(browser: webdriver.Chrome, served: Served, token: str | None = None) -> webdriver.Chrome:
    """Open the page as nobody has left it, and wait for the first step in all views."""
    browser.get("about:blank")
    browser.execute_cdp_cmd("Storage.clearDataForOrigin", {"origin": f"http://127.0.0.1:{served.port}", "storageTypes": "local_storage"})
    browser.get(f"http://127.0.0.1:{served.port}/#{token or served.tokens.edit}")
    until(browser, "return (window.luxloop?.scenes ?? []).length > 0 && document.body.innerText.includes('step 0')")
    return browser


def until(browser: webdriver.Chrome, script: str) -> Any:
    """Wait for a script to return something true."""
    return WebDriverWait(browser, WAIT_S, 0.1).until(lambda driver: driver.execute_script(script))


def until_here(condition: Callable[[], Any]) -> Any:
    """Wait for something on the server's side."""
    return WebDriverWait(None, WAIT_S, 0.1).until(lambda _: condition())


def press(browser: webdriver.Chrome, *keys: str) -> None:
    """Keys on the page as a whole."""
    browser.find_element(By.TAG_NAME, "body").send_keys(*keys)


def one(browser: webdriver.Chrome, css: str) -> WebElement:
    return browser.find_element(By.CSS_SELECTOR, css)
