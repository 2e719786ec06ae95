"""What object-based lighting saves and keeps: `python benchmarks/object_based.py [--quick] [--scenes N] [--seeds N]`.

Static and moving scenes that the detector was not trained on, through the whole chain, with all methods side by side; zones; the
tracker; renderings that should agree. Goes on where an earlier run in the same folder was, and writes docs/results/object_based.md.
"""

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import object_based_cases
import object_based_page
import object_based_parts
from bench import machine
from object_based_cases import COMES, FULL, LOW, NEWCOMER, OURS, beam_lights, cases, illuminated, lit
from object_based_goals import FOUND, Measured, measures, track_rows, zone_rows
from object_based_parts import agreement, pair_jobs, track_jobs, tracked, zone_jobs, zones

from luxloop.loop.recording.digest import digest_of_code
from luxloop.loop.simulation.lamps import flux_by_side
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.studies.jobs.executors import local
from luxloop.loop.studies.jobs.runner import Job, Results, digest_of, run
from luxloop.perception.camera import expose
from luxloop.perception.detection.build import WEIGHTS
from luxloop.perception.noise import FrameNoise

ROOT = Path(__file__).parents[1]
DOCS, NETWORK = ROOT / "docs" / "results", ROOT / "perception" / "detection" / WEIGHTS
SCENES, SEEDS = 64, 5
QUICK = {"scenes": 2, "seeds": 1, "times": 1, "steps": 45, "pairs": 1}
WHOLE = {"times": 3, "steps": 75, "pairs": 8}  # of the tracker's situations, of their frames, and of pairs of renderings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK['scenes']} scenes, one seed, and less of all else")
    parser.add_argument("--scenes", type=int, default=SCENES, help=f"by default {SCENES}")
    parser.add_argument("--seeds", type=int, choices=range(1, SEEDS + 1), default=SEEDS, help=f"by default {SEEDS}")
    parser.add_argument("--out", type=Path, default=Path("runs/object_based"), help="folder for what has been done")
    parser.add_argument("--page", type=Path, default=DOCS, help="folder for the page and its picture")
    parser.add_argument("--json", type=Path, help="also write all rows here")
    parser.add_argument("--jobs", type=int, help="processes, by default one a core")
    given = parser.parse_args()
    size = QUICK if given.quick else WHOLE | {"scenes": given.scenes, "seeds": given.seeds}
    begun = time.perf_counter()
    failures: dict[str, str] = {}
    network = hashlib.sha256(NETWORK.read_bytes()).hexdigest()
    version = digest_of_code() + digest_of(object_based_cases, object_based_parts) + network

    def done(function: Callable[..., Mapping[str, Any]], jobs: Sequence[Job], title: str) -> Results:
        results = run(function, jobs, given.out / "jobs.jsonl", version=version, executor=local(given.jobs), title=title)
        failures.update(results.failures)
        return results

    small = [
        done(zones, list(zone_jobs(size["seeds"])), "zones"),
        done(tracked, list(track_jobs(size["seeds"], size["times"], size["steps"])), "tracks"),
        done(agreement, list(pair_jobs(size["pairs"])), "pairs of renderings"),
    ]
    chosen = {case.key: case for case in cases(size["scenes"], size["seeds"])}
    lights = done(illuminated, [Job(key, case.parameters) for key, case in chosen.items()], "scenes").rows
    scenes = [({"scene": chosen[row["key"]].scene, "moving": chosen[row["key"]].moving}, row) for row in lights]
    light = [row for scene, result in scenes for row in measures(scene, result)]
    measured = Measured(light, zone_rows(small[0].rows), track_rows(small[1].rows))
    if given.json:
        given.json.write_text(json.dumps({"light": light, "zones": measured.zones, "tracks": measured.tracks}, indent=1))
    how_much = "" if (given.scenes, given.seeds) == (SCENES, SEEDS) else f"--scenes {given.scenes} --seeds {given.seeds}"
    about = machine("torch", "numpy") | {
        "command": f"python benchmarks/object_based.py {'--quick' if given.quick else how_much}".strip(),
        "scenes": len(scenes),
        "seeds": "one seed" if size["seeds"] == 1 else f"{size['seeds']} seeds",
        "left_out": "".join(f"\n\nFailed: {key}: {reason}" for key, reason in failures.items()),
    }
    pairs = [{name: each for name, each in row.items() if isinstance(each, dict) and "dssim" in each} for row in small[2].rows]
    object_based_page.write(measured, [each for _, result in scenes for each in drawn(result)], pairs, example(), about, given.page)
    print(f"written: {given.page / object_based_page.NAME}, after {(time.perf_counter() - begun) / 60:.1f} minutes")
    if failures:
        sys.exit("\n".join(f"failed: {key}: {reason}" for key, reason in failures.items()))


def drawn(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The default's runs in a scene, with what a picture of them needs besides."""
    low_lm, full = result["lamps"][LOW]["flux_lm"], result["beams"][FULL]
    runs = enumerate(result["runs"][OURS])
    return [{**run, "low_lm": low_lm, "newcomer": full[seed].get(NEWCOMER, 0.0) >= FOUND} for seed, run in runs]


def example() -> object_based_page.Pictures:
    """The first scene, which stands, in low beam and full light, and as object-based lighting has it when a newcomer comes."""
    (case,) = cases(1, 1)
    simulation = Simulation.prepare(lit(case.scenario, case.parameters["variants"][OURS]))
    state = simulation.start()
    for _ in range(COMES):
        state, result = simulation.step(state)
    beams = beam_lights(simulation)
    lights = {LOW: beams[LOW], FULL: beams[FULL], "object-based": result.lights}
    view, camera, pipeline = simulation.world.lit(result.time_s), simulation.scenario.camera, simulation.pipeline
    assert pipeline is not None
    pictures = {}
    for name, each in lights.items():
        frame = expose(view.light(each)[1] + view.base, camera, FrameNoise.of(0, COMES, 0)) / (2**camera.bits - 1)
        found = pipeline.find(frame, view)
        flux = sum(flux_by_side(simulation.modules, each).values())
        pictures[f"{name}: {flux:.0f} lm"] = (frame.numpy(), found.boxes.tolist(), found.scores.amax(-1).tolist())
    return pictures


if __name__ == "__main__":
    main()
