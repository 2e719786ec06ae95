"""How well symbols lie on roads by luxloop's controllers: `python benchmarks/symbol_control.py [--quick] [--out FOLDER] [--json FILE]`.

Standing roads, late frames, drives and disturbances, and in each of these worlds all controllers side by side. Goes on where an
earlier run in the same folder was, and writes docs/results/symbol_control.md. `--quick`: one seed, two latencies.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import symbol_control_cases
import symbol_control_page
from bench import machine
from symbol_control_cases import DISTURBED, STANDING, UNDISTURBED, cases, trajectories
from symbol_control_goals import measures

from luxloop.loop.recording.digest import digest_of_code
from luxloop.loop.recording.manifest import digests
from luxloop.loop.studies.jobs.executors import local
from luxloop.loop.studies.jobs.runner import Job, digest_of, run

DOCS = Path(__file__).parents[1] / "docs" / "results"
SEEDS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one seed, latencies 0 and 2")
    parser.add_argument("--seeds", type=int, choices=range(1, SEEDS + 1), default=SEEDS, help=f"of the long run, by default {SEEDS}")
    parser.add_argument("--only", nargs="+", metavar="SCENE", help="these scenes alone")
    parser.add_argument("--out", type=Path, default=Path("runs/symbol_control"), help="folder for what has been done")
    parser.add_argument("--page", type=Path, default=DOCS, help="folder for the page and its picture")
    parser.add_argument("--json", type=Path, help="also write a row a run and controller here")
    parser.add_argument("--jobs", type=int, help="processes, by default one a core")
    given = parser.parse_args()
    seeds = 1 if given.quick else given.seeds
    begun = time.perf_counter()
    chosen = [case for case in cases(seeds, given.quick) if not given.only or case.scene in given.only]
    jobs = [Job(case.key, case.parameters) for case in chosen]
    inputs = sorted({file for case in cases(1, quick=True) for file in digests(case.scenario).items()})  # of all worlds, roads among them
    version = digest_of_code() + digest_of(symbol_control_cases) + json.dumps(inputs)
    results = run(trajectories, jobs, given.out / "jobs.jsonl", version=version, executor=local(given.jobs), title="worlds")
    found = {row["key"]: row["judged"] for row in results.rows}
    judged = [(case, found[case.key]) for case in chosen if case.key in found]
    undisturbed = {case.seed: each for case, each in judged if case.scene == UNDISTURBED}
    rows = [row for case, each in judged for row in measures(case, each, undisturbed.get(case.seed) if case.scene in DISTURBED else None)]
    failed = {case.scene for case in chosen if case.key not in found}
    absent = [] if given.only else [scene for scene in STANDING if all(case.scene != scene for case in chosen)]
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))
    about = machine("torch", "numpy") | {
        "command": "python benchmarks/symbol_control.py" + (" --quick" if given.quick else f" --seeds {seeds}" if seeds < SEEDS else ""),
        "seeds": "seed 0 alone" if seeds == 1 else f"{seeds} seeds",
        "left_out": (f"\n\nLeft out, as their measured roads are not here: {', '.join(absent)}." if absent else "")
        + "".join(f"\n\nFailed: {key}: {reason}" for key, reason in results.failures.items()),
    }
    symbol_control_page.write(rows, judged, about, given.page, failed, absent)
    print(f"written: {given.page / 'symbol_control.md'}, after {(time.perf_counter() - begun) / 60:.1f} minutes")
    if results.failures:
        sys.exit("\n".join(f"failed: {key}: {reason}" for key, reason in results.failures.items()))


if __name__ == "__main__":
    main()
