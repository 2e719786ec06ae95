"""How well MapReduce control draws rectangles, beside the joint optimum of all pixels: `python benchmarks/evaluation.py [--quick]`.

Goes on where an earlier run in the same folder was, and writes docs/results/evaluation.md with its figures.
"""

import argparse
from pathlib import Path

from luxloop.loop.studies.evaluation import figures
from luxloop.loop.studies.evaluation.evaluate import evaluate
from luxloop.loop.studies.evaluation.report import page
from luxloop.loop.studies.jobs.executors import local

DOCS = Path(__file__).parents[1] / "docs" / "results"
HEAD = (Path(__file__).parent / "evaluation_page.md").read_text("utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description="Evaluate MapReduce control and write docs/results/evaluation.md.")
    parser.add_argument("--quick", action="store_true", help="45 setpoints and coarser sensitivities")
    parser.add_argument("--out", type=Path, default=Path("runs/evaluation"), help="folder for results")
    parser.add_argument("--jobs", type=int, help="processes, by default one a core")
    given = parser.parse_args()
    found = evaluate(given.out, quick=given.quick, executor=local(given.jobs))
    for key, reason in found.failures.items():
        print(f"failed: {key}: {reason}")
    figures.draw(found, DOCS / "images", "evaluation-")
    (DOCS / "evaluation.md").write_text(HEAD + "\n" + page(found, "images/evaluation-"), "utf-8")
    print(f"written: {DOCS / 'evaluation.md'}")


if __name__ == "__main__":
    main()
