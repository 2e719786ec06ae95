"""The light `screen` as a page sees it, without a browser: light counts while the page that has shown it still does."""

import json
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from luxloop.loop.rig.light import Shine
from luxloop.loop.rig.params import ScreenLightParams
from luxloop.loop.rig.screen import ScreenLight
from tests.loop.rig.conftest import eventually
from tests.refusal import refusal


class Page:
    """A page that draws at once, in a thread of its own."""

    def __init__(self, light: ScreenLight) -> None:
        self.frames, self._url = 0, f"ws://127.0.0.1:{light.port}/light"
        self.there: ClientConnection | None = None
        threading.Thread(target=self._run, daemon=True).start()
        assert eventually(lambda: self.there is not None, 5)

    def send(self, text: str) -> None:
        self.there.send(text)

    def close(self) -> None:
        self.there.close()

    def _run(self) -> None:
        with connect(self._url, proxy=None) as self.there, suppress(ConnectionClosed):
            for message in self.there:
                if isinstance(message, bytes):
                    self.frames += 1
                    self.send(json.dumps({"number": int.from_bytes(message[:4], "big")}))


def shine(number: int) -> Shine:
    return Shine(number, (np.full((2, 3), 0.5, np.float32),))


def test_light_is_in_doubt_once_its_page_has_darkened_or_another_has_come():
    light = ScreenLight(ScreenLightParams(kind="screen", port=0), ((2, 3),))
    try:
        first = Page(light)
        assert eventually(lambda: light.has_page, 5)
        assert light.show(shine(0)) is None and light.show(shine(0)) is None and first.frames == 1
        first.send('{"darkened": true}')
        assert eventually(lambda: "darkened by itself" in str(light.show(shine(0))), 2)
        assert light.show(shine(1)) is None
        second = Page(light)
        assert eventually(lambda: "another one has taken its place" in str(light.show(shine(1))), 2)
        assert light.show(shine(2)) is None and second.frames == 1
        second.close()
        assert eventually(lambda: not light.has_page, 5) and "no page shows it" in str(light.show(shine(2)))
    finally:
        light.close()


@pytest.mark.parametrize("host", ["a" * 100, "no.such.host.invalid", "203.0.113.7"])
def test_an_address_that_is_none_is_a_sentence(host):
    began_s = time.monotonic()
    with refusal(r"light\.port: cannot listen on"):
        ScreenLight(ScreenLightParams(kind="screen", host=host), ((2, 3),))
    assert time.monotonic() - began_s < 20
