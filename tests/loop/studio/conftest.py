"""One studio for all tests of a file: preparing a scenario is what takes time."""

import asyncio
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from websockets.asyncio.server import Server

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.studio.runs import Run
from luxloop.loop.studio.server import Studio, Tokens
from luxloop.loop.studio.sources import Source
from tests.loop.studio.clients import Watcher, watching

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

# a process has one OpenGL context, in one thread, which other tests of the process use
SMALL = (
    "renderer=raycast",
    "camera.width_px=320",
    "camera.height_px=180",
    "camera.oversampling=1",
    "road={kind='flat'}",
    "steps=6",
)


@dataclass(frozen=True)
class Served:
    """A studio that runs in a thread of its own."""

    port: int
    tokens: Tokens
    studio: Studio
    server: Server

    @property
    def run(self) -> Run:
        """The first that is shown."""
        return self.studio.session.state.runs[0]

    @property
    def scenario(self) -> Scenario:
        """As the simulation has it now."""
        return self.run.simulation.scenario


@pytest.fixture(scope="session")
def page_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In place of the page."""
    page = tmp_path_factory.mktemp("page")
    (page / "index.html").write_text("<!doctype html><title>studio</title>")
    (page / "secret.key").write_text("not of the page")
    return page


@pytest.fixture(scope="module")
def served(page_folder: Path) -> Iterator[Served]:
    yield from serving(Source("snowflake", SMALL), page_folder)


@pytest.fixture
def editor(served: Served) -> Iterator[Watcher]:
    """A client that may edit, once it knows the scenario."""
    with watching(served.port, served.tokens.edit) as editor:
        editor.of("scenario")
        yield editor


@pytest.fixture(scope="module")  # an open page draws for ever, beside all later tests
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator["Chrome"]:
    from tests.loop.studio.pages import chromium  # Selenium, for which other tests do not wait

    with chromium(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


def serving(source: Source, page: Path) -> Iterator[Served]:
    """A studio in a thread, until the test is over."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()

    async def begin() -> Served:
        tokens = Tokens()
        studio = Studio((source,), page, tokens, device="cpu")
        server = await studio.serve("127.0.0.1", 0)
        return Served(server.sockets[0].getsockname()[1], tokens, studio, server)

    async def end() -> None:
        served.server.close()
        await served.server.wait_closed()

    served = asyncio.run_coroutine_threadsafe(begin(), loop).result()
    yield served
    served.studio.session.stop()
    asyncio.run_coroutine_threadsafe(end(), loop).result()
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
