"""The version of the code: it follows every module that decides a figure, and none that only shows."""

from pathlib import Path

import pytest

from loop.recording import digest as code


@pytest.mark.parametrize(
    ("module", "decides"),
    [
        ("world/headlight/matrix.py", True),
        ("loop/objective.py", True),
        ("loop/lighting/report.py", True),
        ("loop/pictures/charts.py", False),
    ],
)
def test_the_version_follows_the_modules_that_decide(module: str, decides: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "files", lambda package: tmp_path / package.replace(".", "/"))
    file = tmp_path / module
    file.parent.mkdir(parents=True)
    file.write_text("a = 1\n")
    before = code.digest_of_code.__wrapped__()
    file.write_text("a = 2\n")
    assert (code.digest_of_code.__wrapped__() != before) == decides
