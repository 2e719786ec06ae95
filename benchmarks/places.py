"""How well symbols lie on hard roads: `python benchmarks/places.py [--quick] [--out FOLDER] [--json FILE]`.

Worlds drawn from a seed, and in each of them all controllers side by side, beside what lamp and camera allow there. Goes on where an
earlier run in the same folder was, and writes docs/places.md. `--quick`: about an eighth of the worlds.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import places_bound
import places_cases
import places_page
import symbol_control_cases
from bench import machine
from places_cases import KINDS, places, run_place
from places_goals import measures

from luxloop.loop.recording.digest import digest_of_code
from luxloop.loop.recording.manifest import digests
from luxloop.loop.studies.jobs.executors import local
from luxloop.loop.studies.jobs.runner import Job, digest_of, run

DOCS = Path(__file__).parents[1] / "docs" / "results"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="about an eighth of the worlds")
    parser.add_argument("--only", nargs="+", choices=KINDS, metavar="KIND", help=f"these kinds of roads alone: {', '.join(KINDS)}")
    parser.add_argument("--out", type=Path, default=Path("runs/places"), help="folder for what has been done")
    parser.add_argument("--page", type=Path, default=DOCS, help="folder for the page and its picture")
    parser.add_argument("--json", type=Path, help="also write a row a world and controller here")
    parser.add_argument("--jobs", type=int, help="processes, by default one a core")
    given = parser.parse_args()
    begun = time.perf_counter()
    chosen = [place for place in places(given.quick) if not given.only or place.kind in given.only]
    inputs = sorted({file for place in chosen for file in digests(place.scenario).items()})  # scans among them
    version = digest_of_code() + digest_of(places_cases, places_bound, symbol_control_cases) + json.dumps(inputs)
    jobs = [Job(place.key, place.parameters) for place in chosen]
    results = run(run_place, jobs, given.out / "jobs.jsonl", version=version, executor=local(given.jobs), title="worlds")
    found = {row["key"]: row for row in results.rows}
    rows = [row for place in chosen if place.key in found for row in measures(place, found[place.key])]
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))
    about = machine("torch", "numpy") | {
        "command": "python benchmarks/places.py"
        + (" --quick" if given.quick else "")
        + (f" --only {' '.join(given.only)}" if given.only else ""),
        "failed": "".join(f"\n\nFailed: {key}: {reason}" for key, reason in results.failures.items()),
    }
    places_page.write(rows, chosen, about, given.page)
    print(f"written: {given.page / 'places.md'}, after {(time.perf_counter() - begun) / 60:.1f} minutes")
    if results.failures:
        sys.exit("\n".join(f"failed: {key}: {reason}" for key, reason in results.failures.items()))


if __name__ == "__main__":
    main()
