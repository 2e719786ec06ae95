"""What the studio costs the loop: `python benchmarks/studio.py [--json FILE] [--quick]`.

Steps of scenarios by the clock: in the studio that nobody watches, watched by another process, which reads and acknowledges all that it
gets, by a deaf one, which reads nothing after its first step, and by one that does not show the camera; run by run in turn, on two cores,
each scenario in a process of its own. The time of the processor for the loop's thread counts beside that by the clock, which other programs
lengthen. Then bytes and time of a message, and the time from the command to the first picture.
"""

import argparse
import asyncio
import json
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from bench import machine, on_one_thread
from rich.table import Table

from luxloop.loop.report import terminal as tables
from luxloop.loop.studio.feed import Feed
from luxloop.loop.studio.messages import VIEWS, Button, Request
from luxloop.loop.studio.server import Studio, Tokens
from luxloop.loop.studio.session import Session
from luxloop.loop.studio.sources import Source
from luxloop.world.messages import LENGTH

SMALL = ("camera.width_px=640", "camera.height_px=360", "judge_every=0")
STEPS = {"snowflake": 240, "gfhb": 60, "driving": 80}  # some four to eight seconds each
SETTLED_S = 1.0  # in which a client has got the meshes of a run that starts
WATCHER = """
import json, struct, sys, time
from websockets.sync.client import connect
def message(**head):
    text = json.dumps(head).encode()
    return struct.pack("<I", len(text)) + text
with connect(f"ws://127.0.0.1:{sys.argv[1]}/socket", max_size=None, max_queue=1, compression=None) as socket:
    socket.send(message(type="hello", token=sys.argv[2]))
    socket.send(message(type="want", views=sys.argv[4].split()))
    while data := socket.recv():
        (length,) = struct.unpack_from("<I", data)
        head = json.loads(data[4 : 4 + length])
        if head["type"] == "step":
            socket.send(message(type="shown", id=head["id"]))
            print("step", flush=True)
            time.sleep(float(sys.argv[3]))
"""
DEAF_S = 1e6  # after a step, in which a watcher reads nothing
ALL, NO_CAMERA = " ".join(VIEWS), " ".join(each for each in VIEWS if each != "camera")
WATCHERS = {"watched": (0.0, ALL), "deaf": (DEAF_S, ALL), "without the camera": (0.0, NO_CAMERA)}  # what they sleep, and what they see


@contextmanager
def studio(name: str, steps: int) -> Iterator[tuple[Session, int, Tokens]]:
    """A studio of a scenario that is prepared, its port and its tokens."""
    loop, tokens = asyncio.new_event_loop(), Tokens()
    threading.Thread(target=loop.run_forever, daemon=True).start()

    async def begin() -> tuple[Studio, int]:
        served = Studio((Source(name, (*SMALL, f"steps={steps}")),), Path("none"), tokens, device="cpu")
        server = await served.serve("127.0.0.1", 0)
        return served, server.sockets[0].getsockname()[1]

    served, port = asyncio.run_coroutine_threadsafe(begin(), loop).result()
    while served.session.published.progress is not None:
        time.sleep(0.05)
    if served.session.published.failed:
        sys.exit(served.session.published.failed)
    yield served.session, port, tokens
    served.stop()


def played_ms(session: Session) -> tuple[float, float]:
    """Start anew and play to the end; ms of the clock a step, and of the processor for the loop's thread."""
    number = session.published.number
    session.ask(Button(type="reset"), print)
    while session.published.number == number:
        time.sleep(0.01)
    time.sleep(SETTLED_S)
    (run,) = session.published.runs
    (thread,) = (each for each in threading.enumerate() if each.name == "simulation")
    clocks = time.CLOCK_MONOTONIC, time.pthread_getcpuclockid(thread.ident or 0)
    began_s = [time.clock_gettime(each) for each in clocks]
    session.ask(Button(type="play"), print)
    while not run.over:
        time.sleep(0.002)
    wall, busy = (1e3 * (time.clock_gettime(each) - began) / (len(run.rows) - 1) for each, began in zip(clocks, began_s, strict=True))
    return wall, busy


def messages_of(session: Session) -> dict[str, dict[str, float]]:
    """Median bytes and ms of a message, by type, to a client that gets each step of a run that is over."""
    found = defaultdict(list)
    feed, published = Feed(), session.published
    for step in range(len(published.runs[0].snapshots)):
        messages = feed.messages(published, Request(at=(0, step), shown=step))
        began_s = time.perf_counter()
        for data in messages:
            (length,) = LENGTH.unpack_from(data)
            kind = json.loads(data[LENGTH.size : LENGTH.size + length])["type"]
            found[kind].append((len(data), 1e3 * (time.perf_counter() - began_s)))
            began_s = time.perf_counter()
    medians = {kind: [median(each) for each in zip(*of_kind[-8:], strict=True)] for kind, of_kind in found.items()}
    return {kind: {"bytes": size, "ms": ms} for kind, (size, ms) in medians.items()}


def measured(name: str, steps: int, rounds: int) -> dict[str, Any]:
    """One scenario: ms a step unwatched, watched, and watched by one that reads nothing, run by run in turn, medians; the medians of the
    ratios of runs that follow each other; and its messages.
    """
    taken: dict[str, list[tuple[float, float]]] = {kind: [] for kind in ("unwatched", *WATCHERS)}
    with studio(name, steps) as (session, port, tokens):
        for _ in range(rounds):
            taken["unwatched"].append(played_ms(session))
            for kind, (sleeps_s, views) in WATCHERS.items():
                with watched_from_outside(port, tokens.watch, sleeps_s, views):
                    taken[kind].append(played_ms(session))
        found: dict[str, Any] = {kind: median(each[0] for each in runs) for kind, runs in taken.items()}
        for kind in WATCHERS:
            ratios = zip(
                *(
                    [after / before for after, before in zip(*pair, strict=True)]
                    for pair in zip(taken[kind], taken["unwatched"], strict=True)
                ),
                strict=True,
            )
            found[f"{kind}_ratio"], found[f"{kind}_busy_ratio"] = map(median, ratios)
        return {**found, "messages": messages_of(session)}


@contextmanager
def watched_from_outside(port: int | str, token: str, sleeps_s: float, views: str = ALL) -> Iterator[None]:
    """By a process that has got a step of these views, and sleeps after each."""
    command = [sys.executable, "-c", WATCHER, str(port), token, str(sleeps_s), views]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as watcher:
        assert watcher.stdout is not None
        watcher.stdout.readline()
        yield
        watcher.kill()


def first_picture_s(name: str) -> float:
    """From the command to the first step at a client."""
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "luxloop.loop.commands.cli", "studio", name, "--no-open", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        address = next(line.split()[-1] for line in server.stdout if line.startswith("To watch"))
        port, token = address.rpartition(":")[2].split("/#")
        with watched_from_outside(port, token, 0.0):
            seconds = time.perf_counter() - began_s
        server.terminate()
    return seconds


def main() -> None:
    on_one_thread("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--scenario", help="measure it alone, and print that as JSON")
    given = parser.parse_args()
    names = ["snowflake"] if given.quick else list(STEPS)
    if given.scenario:
        print(json.dumps(measured(given.scenario, *((4, 1) if given.quick else (STEPS[given.scenario], 5)))))
        return
    found = {}
    for name in names:  # the context of OpenGL belongs to one thread of a process
        command = [sys.executable, __file__, "--scenario", name, *(["--quick"] if given.quick else [])]
        found[name] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    result = {"machine": machine("websockets", "torch"), "scenarios": found, "first_picture_s": first_picture_s("snowflake")}
    beside = [column for kind in WATCHERS for column in (kind, "by the processor")]
    table = Table("scenario", "unwatched, ms", *beside, "bytes of a step", "ms of a step's message")
    for name, each in found.items():
        ratios = [f"{each[f'{kind}_{of}']:.2f}" for kind in WATCHERS for of in ("ratio", "busy_ratio")]
        message = each["messages"]["step"]
        table.add_row(name, f"{each['unwatched']:.1f}", *ratios, f"{message['bytes']:.0f}", f"{message['ms']:.1f}")
    tables.show(table)
    print(f"first picture of snowflake: {result['first_picture_s']:.1f} s")
    if given.json:
        given.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
