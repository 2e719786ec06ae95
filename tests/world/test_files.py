"""Files appear whole or not at all."""

from pathlib import Path

import pytest

from luxloop.world.errors import LuxloopError
from luxloop.world.files import whole


def test_a_file_takes_its_place_when_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with whole(target) as part:
        part.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert list(tmp_path.iterdir()) == [target]


def test_what_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), whole(tmp_path / "a.txt") as part:
        part.write_text("half")
        raise ZeroDivisionError
    with pytest.raises(LuxloopError, match="is a folder"), whole(tmp_path) as part:
        part.write_text("all")
    with pytest.raises(LuxloopError, match="check the folder"), whole(tmp_path / "no" / "a.txt") as part:
        part.write_text("all")
    (tmp_path / "file").write_text("")
    with pytest.raises(LuxloopError, match="cannot be written"), whole(tmp_path / "file" / "a.txt") as part:
        part.write_text("all")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
