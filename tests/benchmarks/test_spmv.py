"""The benchmark of sparse products runs, compares like with like and writes its page; how fast they are no test could hold."""

import json
import os
import re
import string
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spmv_lamps

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'benchmarks'}", "OMP_NUM_THREADS": "1"}


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Folder of the page, and the results."""
    folder = tmp_path_factory.mktemp("spmv")
    done = python("benchmarks/spmv.py", "--quick", "--json", str(folder / "results.json"), "--page", str(folder))
    assert done.returncode == 0, done.stderr
    return folder, json.loads((folder / "results.json").read_text())


def test_every_lamp_is_measured_beside_scipy(quick: tuple[Path, dict[str, Any]]) -> None:
    _, results = quick
    assert [lamp["name"] for lamp in results["fixed"]] == ["45 x 90", "125 x 250"]
    assert [lamp["texels"] for lamp in results["adaptive"]] == [[256, 256], [576, 576]]
    for lamp in (lamp for part in ("fixed", "adaptive", "long", "shipped") for lamp in results[part]):
        assert {"SciPy", "csr", "window", lamp["chosen"]} <= set(lamp["ms"])
        assert lamp["ratio"] == pytest.approx(lamp["ms"][lamp["chosen"]]["median"] / lamp["ms"]["SciPy"]["median"])
        assert all(0 < times["min"] <= times["q05"] <= times["median"] <= times["q95"] for times in lamp["ms"].values())
    assert len(results["goals"]) == 6


def test_bytes_are_those_of_the_chosen_format(quick: tuple[Path, dict[str, Any]]) -> None:
    """The window is what CSR would be of the lit rows alone; bytes, time and the copy's share belong together."""
    lamp = quick[1]["fixed"][0]
    lit, square = (next(each for each in quick[1]["memory"] if each["name"].endswith(part)) for part in ("lit rows", "square texture"))
    assert lit["texels"] < square["texels"] == 256**2
    assert lit["formats"]["csr"]["row_indices"] == lit["texels"] + 1 == square["formats"]["window"]["row_indices"] - 1
    assert lamp["copy_share"] == pytest.approx(1e-6 * lamp["bytes"] / lamp["ms"][lamp["chosen"]]["median"] / lamp["copy_gb_s"])


def test_the_page_has_its_tables_and_pictures(quick: tuple[Path, dict[str, Any]]) -> None:
    folder, results = quick
    text = (folder / "spmv.md").read_text("utf-8")
    for picture in re.findall(r"\]\((images/[^)]+)\)", text):
        assert (folder / picture).stat().st_size > 5000
    assert f"| 45 x 90 | 256 x 256 | {results['fixed'][0]['entries']:.2f} |" in text
    assert results["machine"]["processor"] in text and results["machine"]["date"] in text
    if results["machine"]["gpu"] == "none":
        assert "| not measured |" in text


@pytest.mark.parametrize("name", ["jpo", "results/object_based", "results/places", "results/spmv", "results/symbol_control"])
def test_pages_in_docs_were_written_by_their_templates(name: str) -> None:
    page = (ROOT / "docs" / f"{name}.md").read_text("utf-8")
    end = 0
    for words, _, _, _ in string.Formatter().parse((ROOT / "benchmarks" / f"{Path(name).name}_page.md").read_text("utf-8")):
        assert words in page[end:], f"docs/{name}.md has not, or not here: {words}"
        end = page.index(words, end) + len(words)
    assert page.endswith(words)


def test_a_format_that_does_other_work_is_refused() -> None:
    done = python("-c", "import sys; sys.argv = ['spmv.py', '--quick']; import spmv; spmv.FLOAT_TOLERANCE = -1.0; spmv.main()")
    assert done.returncode == 1
    assert "not the same work" in done.stderr


def test_lamps_are_those_of_the_tables() -> None:
    assert [spmv_lamps.adaptive_side(cols) for _, cols in spmv_lamps.SIZES] == [256, 576, 1728, 3008, 3840]
    lamp = spmv_lamps.of_the_thesis(45, 90, 512)
    lengths = np.diff(lamp.matrix.indptr)
    # A pixel of pitch p overlaps a quarter into its neighbours, so that it lights (1.25 p)^2.
    assert lengths[lengths > 0].mean() == pytest.approx(1.25**2, rel=0.03)
    assert set(lengths) == {0, 1, 2, 4}
    assert spmv_lamps.with_long_rows(32, 64, 128, 256, 24).matrix.nnz / 128 / 256 == pytest.approx(24, rel=0.1)
    assert set(np.diff(spmv_lamps.disjoint(32, 64).matrix.indptr)) == {1}
    assert set(np.diff(spmv_lamps.disjoint(32, 64).matrix.tocsc().indptr)) == {64 * 256 // (8 * 32)}
