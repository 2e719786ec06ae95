"""Frames to find something in."""

import pytest

from luxloop.loop.studies.training.scenes import HELD_OUT, draw, read
from tests.loop.studies.training.lit import Lit

SEED = HELD_OUT + 3


@pytest.fixture(scope="session")
def lit(tmp_path_factory: pytest.TempPathFactory) -> Lit:
    folder = str(tmp_path_factory.mktemp("scenes"))
    return Lit(read({**draw(SEED, folder), "seed": SEED, "folder": folder}))
