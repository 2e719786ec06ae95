"""Shared by all tests: where third-party data lies, which devices there are, and that a worker's memory stays small."""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from hypothesis import settings

settings.register_profile("tests", deadline=None)  # a busy machine takes its time
settings.load_profile("tests")

GROWTH_BYTES = 300_000_000
floor_bytes = 0


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def pytest_runtest_logfinish() -> None:
    """Free garbage and return free memory once a process has grown by GROWTH_BYTES.

    Python counts objects, not bytes, and glibc keeps what lies between live blocks: a worker grew to 13 GB and was killed by the system.
    """
    global floor_bytes
    if sys.platform == "linux" and resident_bytes() > floor_bytes + GROWTH_BYTES:
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        floor_bytes = resident_bytes()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of a browser come first: with `--dist loadfile` the rest goes beside them, and no long file is left for the end."""
    items.sort(key=lambda item: "browser" not in item.path.name)


@pytest.fixture(autouse=True)
def environment_stays() -> Iterator[None]:
    """The command line sets variables for its child processes; in the process of a test they end with it."""
    before = os.environ.copy()
    yield
    if os.environ != before:
        os.environ.clear()
        os.environ.update(before)


@pytest.fixture(autouse=True)
def forget_own_modules(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Modules that a test wrote are forgotten with it: the next test's own of that name lies elsewhere."""
    before = sys.modules.copy()
    yield
    written = str(tmp_path_factory.getbasetemp())
    for name in sys.modules.copy().keys() - before:  # to look at all of them takes a tenth of a second
        if str(getattr(sys.modules[name], "__file__", "")).startswith(written):
            del sys.modules[name]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with `roads/` and `ies/`: `LUXLOOP_DATA`, else `../shared/data` beside the checkout."""
    for candidate in (os.environ.get("LUXLOOP_DATA"), Path(__file__).parents[2] / "shared" / "data"):
        if candidate and Path(candidate).is_dir():
            return Path(candidate)
    pytest.skip("third-party road scans are not here: set LUXLOOP_DATA to a folder that has them")


@pytest.fixture(params=["cpu", *(["cuda"] if torch.cuda.is_available() else [])])
def device(request: pytest.FixtureRequest) -> torch.device:
    return torch.device(request.param)
