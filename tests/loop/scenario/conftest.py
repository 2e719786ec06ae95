"""A scenario file to change."""

from pathlib import Path

import pytest

from tests.loop.scenario.files import GOOD


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "my.toml"
    path.write_text(GOOD)
    return path
