"""The studio on another simulator: edits go on with it, and a run that starts anew begins with it again."""

import threading
import time
from typing import Any

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from luxloop import validate
from luxloop.loop.scenario.edits import with_overrides
from luxloop.loop.studio.messages import VIEWS
from luxloop.loop.studio.runs import start
from luxloop.loop.studio.sources import Source
from tests.loop.conftest import SMALL
from tests.loop.simulation.remote.conftest import free_port
from tests.loop.studio.clients import message, unpacked
from tests.refusal import refusal

MOVED = ("functions.patch.x_m=25.0",)


def dark(address: str, over: threading.Event, said: list[Any]) -> None:
    """A simulator in whose world it is dark; it plays run after run."""
    while not over.is_set():
        try:
            with connect(f"ws://{address}", proxy=None, max_size=None) as there:
                there.send(message(type="hello", protocol=1))
                for data in there:
                    head, _ = unpacked(data)
                    said.append((head["type"], head.get("number")))
                    number = head.get("number")
                    if head["type"] in ("start", "show"):
                        end_s = 0.0 if number is None else head["start_s"] + head["duration_s"]
                        frames = [] if number is None else [{"number": number, "taken_s": head["start_s"], "arrived_s": end_s}]
                        arrays = {f"frame.{each['number']}": np.full((180, 320), 9, np.uint16) for each in frames}
                        there.send(message(arrays, "raw", type="arrivals", number=number, time_s=end_s, frames=frames))
        except (OSError, WebSocketException):  # also of a server that is about to go
            time.sleep(0.02)


def test_edits_go_on_and_what_starts_anew_begins_again():
    address, over, said = f"127.0.0.1:{free_port()}", threading.Event(), list[Any]()
    thread = threading.Thread(target=dark, args=(address, over, said))
    thread.start()
    plant = {"kind": "remote", "address": address, "timeout_s": 20}
    patch = {"kind": "primitive", "x_m": 20.0}
    scenario = validate({**SMALL, "functions": {"patch": patch}, "plant": plant}, "studio")
    try:
        (first,) = start([(Source("studio"), scenario)], (), VIEWS, print, anew=True)
        first.edit(first.prepare_edit(with_overrides(scenario, MOVED)), MOVED)
        first.step(VIEWS)
        (again,) = start([(Source("studio"), scenario)], [first], VIEWS, print, anew=False)
        again.step(VIEWS)
        with refusal("no simulator is connected any more"):
            first.step(VIEWS)
        again.simulation.plant.close()  # type: ignore[attr-defined]
    finally:
        over.set()
        thread.join(20)
    once = [("welcome", None), ("start", None), ("show", 0), ("show", 1), ("end", None)]
    assert said == 2 * once
