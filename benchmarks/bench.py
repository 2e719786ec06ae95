"""What benchmarks have in common: one thread, the machine they ran on, and goals."""

import datetime
import os
import platform
import sys
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from rich.console import Console

from luxloop.loop.report.terminal import markdown

Goal = tuple[str, float | None, float, bool]  # what, its value (None where it was not measured), its limit, whether that is the least


def on_one_thread(*variables: str) -> None:
    """Start the program again with these variables at 1, unless they are: libraries read them when they are loaded."""
    threads = dict.fromkeys(variables, "1")
    if any(os.environ.get(name) != value for name, value in threads.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **threads})


def processor() -> str:
    """Model of the CPU."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine()


def machine(*packages: str) -> dict[str, str]:
    """Where and with what this ran."""
    return {
        "date": datetime.date.today().isoformat(),
        "processor": processor(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def judged(goals: Iterable[Goal]) -> list[dict[str, Any]]:
    """Goals as they are written to files; what was not measured is neither passed nor missed."""
    return [
        {
            "goal": name,
            "value": value,
            "limit": limit,
            "at_least": least,
            "passed": None if value is None else (value >= limit if least else value <= limit),
        }
        for name, value, limit, least in goals
    ]


def goals_page(goals: Iterable[dict[str, Any]]) -> str:
    """Goals as Markdown."""
    rows = (
        (
            each["goal"],
            "not measured" if each["value"] is None else f"{each['value']:.2f}",
            f"{'≥' if each['at_least'] else '≤'} {each['limit']:g}",
            {True: "reached", False: "**missed**", None: ""}[each["passed"]],
        )
        for each in goals
    )
    return markdown(("goal", "measured", "limit", ""), rows, "lrrl")


def show_goals(console: Console, goals: Iterable[dict[str, Any]]) -> None:
    for each in goals:
        verdict = "not measured" if each["value"] is None else f"{each['value']:.2f}: {'pass' if each['passed'] else 'FAIL'}"
        console.print(f"{each['goal']}, {'at least' if each['at_least'] else 'at most'} {each['limit']:g}: {verdict}", markup=False)
