"""The fastest format is measured once and remembered; a bad cache costs nothing but the measurement."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch

from tests.world.spmv.matrices import random_matrix
from world.spmv import Csr, auto, build, fastest


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
    # As many pixels a texel, but no two texels share theirs.
    assert "tiles" not in auto.candidates(Csr.from_scipy(sp.kron(sp.eye_array(200), np.ones((1, 20)))))


def test_every_candidate_is_really_measured(device: torch.device, tmp_path: Path) -> None:
    csr = Csr.from_scipy(sp.kron(sp.eye_array(20), np.ones((10, 8)))).to(device)
    forms = {name: auto.FORMATS[name].from_csr(csr) for name in auto.candidates(csr)}
    times = auto.timings(forms)
    assert times.keys() == forms.keys()
    assert all(0 <= time < 1000 for time in times.values())
    assert fastest(csr, tmp_path / "formats.json").name in times


class Clock:
    """Products that take as long as they are said to: `products` counts them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, milliseconds: dict[str, float]) -> None:
        self.now_s, self.products = 0.0, dict.fromkeys(milliseconds, 0)
        forms = dict.fromkeys(milliseconds, auto.FORMATS["csr"](Csr.from_scipy(sp.eye_array(2))))
        monkeypatch.setattr(auto, "_steps", lambda forms: {name: partial(self.step, name, ms) for name, ms in milliseconds.items()})
        monkeypatch.setattr(auto, "_milliseconds", lambda step, device: step())
        monkeypatch.setattr(auto.time, "monotonic", lambda: self.now_s)
        self.times = auto.timings(forms)

    def step(self, name: str, ms: float) -> float:
        self.products[name] += 1
        self.now_s += 1e-3 * ms
        return ms


def test_measuring_takes_about_a_second_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest lamp of table A.2, with its times on one machine."""
    clock = Clock(monkeypatch, {"scipy": 15.6, "csr": 19.4, "window": 14.7, "submatrix": 28.3, "sell": 60.7})
    assert clock.now_s < 1.1
    assert clock.products["sell"] == 2  # once to warm up, once measured
    assert min(clock.times, key=clock.times.__getitem__) == "window"


def test_close_formats_are_measured_often_and_slow_ones_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch, {"a": 1.0, "b": 1.25, "c": 1.5, "d": 2.5, "e": 3.1})
    assert clock.products["e"] == 2 < clock.products["d"] < clock.products["c"] < clock.products["a"] == clock.products["b"] == 200
    assert clock.times == {"a": 1.0, "b": 1.25, "c": 1.5, "d": 2.5, "e": 3.1}
    assert Clock(monkeypatch, {"a": 1.0, "b": 4.0}).products == {"a": 2, "b": 2}


@pytest.mark.skipif(not torch.cuda.is_available(), reason="CUDA graphs need CUDA")
def test_graphs_are_timed_on_cuda(csr: Csr, monkeypatch: pytest.MonkeyPatch) -> None:
    """A format whose product is many launches must not lose to one whose product is a single one."""
    replays: list[str] = []
    replay = auto.CapturedProduct.replay
    monkeypatch.setattr(auto.CapturedProduct, "replay", lambda self: replays.append(self.form.name) or replay(self))
    forms = {name: build(csr.to(torch.device("cuda")), name) for name in ("csr", "sell")}
    monkeypatch.setattr(auto, "ROUNDS", 1)
    auto.timings(forms)
    assert replays == ["csr", "sell", "csr", "csr", "sell", "sell"]


def test_choices_go_to_the_users_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert auto.cache_file().is_relative_to(tmp_path)
