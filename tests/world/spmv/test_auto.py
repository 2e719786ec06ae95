"""The fastest format is measured once and remembered; a bad cache costs nothing but the measurement."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch

from tests.world.spmv.matrices import random_matrix
from world.spmv import Csr, auto, fastest


@pytest.fixture
def csr() -> Csr:
    return Csr.from_scipy(random_matrix(1, 300, 40, 0.1))


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The formats of each measurement; the submatrix always wins."""
    calls: list[list[str]] = []

    def timings(forms: dict[str, object]) -> dict[str, float]:
        calls.append(list(forms))
        return {name: 1.0 if name == "submatrix" else 2.0 for name in forms}

    monkeypatch.setattr(auto, "timings", timings)
    return calls


def test_the_fastest_wins_and_is_remembered(csr: Csr, measured: list[list[str]], tmp_path: Path) -> None:
    cache = tmp_path / "new" / "formats.json"
    x = torch.linspace(0, 1, 40)
    for _ in range(2):
        form = fastest(csr, cache)
        assert form.name == "submatrix"
        np.testing.assert_allclose(form.multiply(x), csr.to_scipy() @ x.numpy(), rtol=1e-6)
    assert len(measured) == 1
    assert list(cache.parent.iterdir()) == [cache]
    (key,) = json.loads(cache.read_text())
    assert all(
        part in key for part in ("300 x 40", "float32", "1 threads" if torch.get_num_threads() == 1 else "threads", torch.__version__)
    )


def test_another_matrix_dtype_or_thread_count_is_measured_anew(csr: Csr, measured: list[list[str]], tmp_path: Path) -> None:
    cache = tmp_path / "formats.json"
    others = [csr, csr.with_values(2 * csr.values), csr.to(torch.float64)]
    for each in [*others, *others]:
        fastest(each, cache)
    assert len(measured) == 3
    threads = torch.get_num_threads()
    torch.set_num_threads(threads + 1)
    try:
        fastest(csr, cache)
    finally:
        torch.set_num_threads(threads)
    assert len(measured) == 4
    assert len(json.loads(cache.read_text())) == 4


@pytest.mark.parametrize("content", ["", "{", "[]", "3", '{"a": 1}', "\x00"])
def test_a_corrupted_cache_is_replaced(csr: Csr, measured: list[list[str]], tmp_path: Path, content: str) -> None:
    cache = tmp_path / "formats.json"
    cache.write_text(content)
    assert fastest(csr, cache).name == "submatrix"
    assert "submatrix" in json.loads(cache.read_text()).values()


def test_a_remembered_format_that_is_gone_is_measured_anew(csr: Csr, measured: list[list[str]], tmp_path: Path) -> None:
    cache = tmp_path / "formats.json"
    fastest(csr, cache)
    for gone in ("hyb", ["csr"]):
        cache.write_text(json.dumps(dict.fromkeys(json.loads(cache.read_text()), gone)))
        assert fastest(csr, cache).name == "submatrix"
    assert len(measured) == 3


def test_a_cache_that_cannot_be_written_is_no_error(csr: Csr, measured: list[list[str]], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for _ in range(2):
        assert fastest(csr, tmp_path / "file" / "formats.json").name == "submatrix"
    assert len(measured) == 2


def test_padding_without_end_is_no_candidate() -> None:
    long_row = np.zeros((1000, 500))
    long_row[:, 0] = 1
    assert "ell" in auto.candidates(Csr.from_scipy(sp.csr_matrix(long_row)))
    long_row[0] = 1
    names = auto.candidates(Csr.from_scipy(sp.csr_matrix(long_row)))
    assert "ell" not in names
    assert {"csr", "window", "submatrix"} <= set(names)
    assert "tiles" in auto.candidates(Csr.from_scipy(sp.csr_matrix(np.ones((200, 20)))))


def test_every_candidate_is_really_measured(device: torch.device, tmp_path: Path) -> None:
    csr = Csr.from_scipy(sp.kron(sp.eye_array(20), np.ones((10, 8)))).to(device)
    forms = {name: auto.FORMATS[name].from_csr(csr) for name in auto.candidates(csr)}
    times = auto.timings(forms)
    assert times.keys() == forms.keys()
    assert all(0 <= time < 1000 for time in times.values())
    assert fastest(csr, tmp_path / "formats.json").name in times


def test_choices_go_to_the_users_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert auto.cache_file().is_relative_to(tmp_path)
