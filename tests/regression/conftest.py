"""The flag that replaces recorded trajectories, `pytest tests/regression --re-record`."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--re-record", action="store_true", help="replace the recorded trajectories of the shipped scenarios, print what changes"
    )


@pytest.fixture
def re_record(request: pytest.FixtureRequest) -> bool:
    """Whether to replace recordings. The flag is unknown to runs that were not started in this folder."""
    return bool(request.config.getoption("--re-record", default=False))
