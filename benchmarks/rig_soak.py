"""Half an hour on a rig of another process, at 30 frames a second: `python benchmarks/rig_soak.py`.

`snowflake` runs over sockets. Each minute gives the latency of the camera's pictures from exposure to arrival, by the truth of the rig, the
rate and the losses of exposures, and the memory of both processes; at its end the loop hangs, and the watchdog has to darken the lamp.
"""

import ctypes
import json
import math
import os
import subprocess
import sys
import time
import urllib.request
import zlib
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import psutil
from bench import Goal, run, show
from torch import Tensor

from luxloop import Exposure, load
from luxloop.loop.commands.rig_runs import pixel_grids
from luxloop.loop.rig.params import RigParams
from luxloop.loop.rig.plant import RigEvaluator, RigPlant
from luxloop.loop.rig.rig import Rig, await_camera, open_rig
from luxloop.loop.run import run as run_scenario
from luxloop.loop.simulation.build import from_zero
from luxloop.loop.simulation.lamps import lamp_modules
from luxloop.world.validation import validate_model

ROOT = Path(__file__).parents[1]
LIGHT, CAMERA, TRUTH = 4148, 8180, 8181  # ports
MINUTE_S = 60.0
WARM_MINUTES = 3  # until caches are full and the symbol has settled
DARK_S = 0.2  # after the watchdog's time by which the lamp is dark


class Enough(KeyboardInterrupt):
    """The time is over: as Ctrl-C, by which the recording is ended as usual."""


@contextmanager
def rig_process(keys: Sequence[str]) -> Iterator[int]:
    """Its process number; it is ready to be used."""
    ports = ("--light-port", str(LIGHT), "--camera-port", str(CAMERA), "--truth-port", str(TRUTH))
    command = [sys.executable, "-m", "luxloop.loop.commands.cli", "rig", "simulate", "snowflake", "--set", *keys, *ports]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}) as process:
        try:
            while "End it" not in (line := process.stdout.readline()):
                if not line:
                    sys.exit("the rig has not started")
            yield process.pid
        finally:
            process.kill()


def used_mb() -> float:
    """Memory of this process that is in use, by glibc's `mallinfo2`: without what the allocator keeps free."""
    names = ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = type("mallinfo2", (ctypes.Structure,), {"_fields_": [(name, ctypes.c_size_t) for name in names]})
    found = mallinfo()
    return float(found.uordblks + found.hblkhd) / 2**20


def truth() -> dict[str, Any]:
    """What the rig knows: its last frames, and the lamp's state."""
    with urllib.request.urlopen(f"http://127.0.0.1:{TRUTH}/truth", timeout=20) as answer:
        return json.load(answer)


@dataclass
class Minutes:
    """Gets each exposure while its light stands; has a row a minute."""

    rig: Rig
    process: int
    count: int
    rows: list[dict[str, Any]] = field(default_factory=list)
    taken: list[tuple[int, float]] = field(default_factory=list)  # CRC-32 of pictures of this minute, and when they arrived
    began_s: float = math.inf
    before: tuple[int, int, int] = (0, 0, 0)

    def __post_init__(self) -> None:
        expose = self.rig.expose

        def watched(*given: Any) -> Any:
            limited, taken = expose(*given)
            if taken.image is not None:
                self.taken.append((zlib.crc32(bytes(taken.data)), taken.arrived_s))
            return limited, taken

        self.rig.expose = watched  # type: ignore[assignment,method-assign]

    def look(self, exposure: Exposure) -> None:
        now_s = time.monotonic()
        self.began_s = min(self.began_s, now_s)
        if now_s - self.began_s < MINUTE_S or not any(bool(light.u.any()) for light in exposure.lights):
            return
        self.rows.append(self._minute(now_s - self.began_s))
        print(json.dumps(self.rows[-1]), flush=True)
        if len(self.rows) == self.count:
            raise Enough
        self.began_s = time.monotonic()

    def _minute(self, lasted_s: float) -> dict[str, Any]:
        statistics, keeper = self.rig.statistics, self.rig.keeper
        lost, exposures, darkened = self.before
        loop_mb, rig_mb = (psutil.Process(each).memory_info().rss / 2**20 for each in (None, self.process))
        memory = {"loop_mb": loop_mb, "used_mb": used_mb(), "rig_mb": rig_mb}
        hung_s, before = time.monotonic(), keeper.darkened
        time.sleep(self.rig.params.limits.loop_s + DARK_S)  # the loop hangs
        true = truth()
        exposed_s = {frame["crc32"]: frame["exposed_from_s"] for frame in true["frames"]}
        latency_ms = [1e3 * (arrived_s - exposed_s[crc]) for crc, arrived_s in self.taken if crc in exposed_s]
        dark_s = math.nan if true["dark_since_s"] is None else true["dark_since_s"] - hung_s
        row = {
            "latency_ms": float(np.median(latency_ms)) if latency_ms else math.nan,
            "latency_99_ms": float(np.quantile(latency_ms, 0.99)) if latency_ms else math.nan,
            "exposures_hz": (statistics.exposures - exposures) / lasted_s,
            "lost": sum(statistics.lost.values()) - lost,
            **memory,
            "spurious": before - darkened,
            "dark_after_s": dark_s,
            "missed": int(not 0 < dark_s < self.rig.params.limits.loop_s + DARK_S or keeper.darkened != before + 1),
        }
        self.before, self.taken = (sum(statistics.lost.values()), statistics.exposures, keeper.darkened), []
        return row


def soak(given: Namespace) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """A row a minute, and the rig's statistics of the whole."""
    light = {"kind": "ddp", "timecode": True, "host": "127.0.0.1", "port": LIGHT, "bits": 16}
    camera = {"kind": "http", "url": f"http://127.0.0.1:{CAMERA}/camera", "bits": 12}
    params = validate_model(RigParams, {"light": light, "camera": camera, "timing": given.timing}, "")
    scenario = load("snowflake", [*given.keys, "plant.kind=rig", "checks={}", "steps=100000"])
    with rig_process([*given.keys, *given.faults]) as process, TemporaryDirectory() as folder:
        grids = pixel_grids(scenario)
        with open_rig(params, grids, scenario.camera, armed=True) as rig:
            if not await_camera(rig, 20):
                sys.exit("the rig's camera sends nothing")

            watched, evaluators = Minutes(rig, process, given.minutes), []

            def plant(simulation: Any) -> Any:
                modules = lamp_modules(simulation.modules)
                evaluator = RigEvaluator(simulation.controlled, scenario.camera, None)
                evaluators.append(evaluator)

                def look(exposure: Exposure, image: Tensor | None) -> None:
                    evaluator.look(exposure, image)
                    watched.look(exposure)

                own = RigPlant.of(rig, modules, scenario.steps * len(scenario.shares))
                return from_zero(replace(own, look=look), scenario, modules)

            with suppress(Enough):
                run_scenario(scenario, folder, device="cpu", video=False, report=False, plant=plant)
            rig.keeper.dark("the time is over")
            return watched.rows, rig.statistics.summary(len(scenario.shares)) | {"judged": evaluators[0].summary()}


def measure(given: Namespace) -> dict[str, Any]:
    rows, statistics = soak(given)
    show("By minute", {str(number): row for number, row in enumerate(rows, 1)})
    warm = pd.DataFrame(rows[WARM_MINUTES:] or rows)

    def growth(key: str) -> float:
        """By a straight line, over the whole time."""
        return float(np.polyfit(warm.index, warm[key], 1)[0] * (len(warm) - 1)) if len(warm) > 1 else 0.0

    goals = [
        Goal("memory that the loop uses grows by, MB", growth("used_mb"), 10.0),
        Goal("memory of the rig process grows by, MB", growth("rig_mb"), 10.0),
        Goal("median latency drifts by, ms", abs(growth("latency_ms")), 2.0),
        Goal("hangs that the watchdog missed", sum(row["missed"] for row in rows), 0),
        Goal("times that the watchdog darkened without a hang", sum(row["spurious"] for row in rows), 0),
    ]
    failures = {goal.what: f"{goal.value:.3g}" for goal in goals if goal.passed is False}
    return {"minutes": rows, "statistics": statistics, "goals": goals, "failures": failures}


if __name__ == "__main__":
    run(measure, __doc__, "minutes")
