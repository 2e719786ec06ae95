"""Fixtures shared by all tests: where third-party data lies, which devices there are."""

import os
from pathlib import Path

import pytest
import torch


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
