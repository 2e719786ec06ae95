"""What the studio costs the loop: `python benchmarks/studio.py [--json FILE] [--quick]`.

Steps of scenarios by the clock: in the studio that nobody watches, watched by another process, which reads and acknowledges all that it
gets, by a deaf one, which reads nothing after its first step, and by one that does not show the camera; run by run in turn, on two cores,
each scenario in a process of its own. The time of the processor for the loop's thread counts beside that by the clock, which other programs
lengthen. Then bytes and time of a message, and the time from the command to the first picture.
"""

import asyncio
import multiprocessing
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from bench import BLAS, OMP, medians, run, show

from luxloop.loop.studio.inbox import unpack
from luxloop.loop.studio.messages import VIEWS, Button, Request
from luxloop.loop.studio.server import Studio, Tokens
from luxloop.loop.studio.session import Session
from luxloop.loop.studio.sources import Source
from luxloop.loop.studio.stream import Stream

SMALL = ("camera.width_px=640", "camera.height_px=360", "judge_every=0")
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
    while served.session.state.progress is not None:
        time.sleep(0.05)
    if served.session.state.failed:
        sys.exit(served.session.state.failed)
    yield served.session, port, tokens
    served.stop()


@contextmanager
def watcher(port: int | str, token: str, sleeps_s: float, views: str) -> Iterator[None]:
    """A process that has got a step of these views, and sleeps after each."""
    command = [sys.executable, "-c", WATCHER, str(port), token, str(sleeps_s), views]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        yield
        process.kill()


def play_ms(session: Session) -> tuple[float, float]:
    """Start anew and play to the end; ms of the clock a step, and of the processor for the loop's thread."""
    number = session.state.number
    session.ask(Button(type="reset"), print)
    while session.state.number == number:
        time.sleep(0.01)
    time.sleep(SETTLED_S)
    (run_,) = session.state.runs
    (thread,) = (each for each in threading.enumerate() if each.name == "simulation")
    clocks = time.CLOCK_MONOTONIC, time.pthread_getcpuclockid(thread.ident or 0)
    began_s = [time.clock_gettime(each) for each in clocks]
    session.ask(Button(type="play"), print)
    while not run_.over:
        time.sleep(0.002)
    wall, busy = (1e3 * (time.clock_gettime(each) - began) / (len(run_.rows) - 1) for each, began in zip(clocks, began_s, strict=True))
    return wall, busy


def messages_of(session: Session) -> dict[str, dict[str, float]]:
    """Median bytes and ms of a message, by type, to a client that gets each step of a run that is over."""
    found, feed, published = defaultdict(list), Stream(), session.state
    for step in range(len(published.runs[0].snapshots)):
        began_s = time.perf_counter()
        for message in feed.messages(published, Request(at=(0, step), shown=step)):
            ms = 1e3 * (time.perf_counter() - began_s)
            found[unpack(message)[0]["type"]].append({"bytes": len(message), "ms": ms})
            began_s = time.perf_counter()
    return {kind: medians(each[-8:]) for kind, each in found.items()}


def compare(name: str, steps: int, rounds: int) -> dict[str, Any]:
    """Median ms a step, clock and processor, unwatched and by watcher; median ratios of runs that follow each other; messages."""
    ms = {kind: [] for kind in ("unwatched", *WATCHERS)}
    ratios = {kind: [] for kind in WATCHERS}
    with studio(name, steps) as (session, port, tokens):
        for _ in range(rounds):
            wall, busy = play_ms(session)
            ms["unwatched"].append(wall)
            for kind, watching in WATCHERS.items():
                with watcher(port, tokens.watch, *watching):
                    watched = play_ms(session)
                ms[kind].append(watched[0])
                ratios[kind].append({"clock": watched[0] / wall, "processor": watched[1] / busy})
        times = {f"{kind}, times": medians(each) for kind, each in ratios.items()}
        return {**{kind: median(each) for kind, each in ms.items()}, **times, "messages": messages_of(session)}


def first_picture_s(name: str) -> float:
    """From the command to the first step at a client."""
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "luxloop.loop.commands.cli", "studio", name, "--no-open", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        address = next(line.split()[-1] for line in server.stdout if line.startswith("To watch"))
        port, token = address.rpartition(":")[2].split("/#")
        with watcher(port, token, 0.0, ALL):
            seconds = time.perf_counter() - began_s
        server.terminate()
    return seconds


def measure(given: Namespace) -> dict[str, Any]:
    found = {}
    for name, count in given.steps.items():  # the context of OpenGL belongs to one thread of a process
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            found[name] = pool.apply(compare, (name, count, given.rounds))
    seconds = first_picture_s("snowflake")
    show("ms a step of the clock, and times those of an unwatched run", found)
    print(f"\nfirst picture of snowflake: {seconds:.1f} s")
    return {"scenarios": found, "first_picture_s": seconds}


if __name__ == "__main__":
    run(measure, __doc__, threads=(OMP, BLAS))  # OpenGL renders on both cores
