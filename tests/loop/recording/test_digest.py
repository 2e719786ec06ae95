"""The version of the code: it follows every file that may decide a figure, new ones too, and none that only shows."""

from pathlib import Path

from luxloop.loop.recording import sources


def test_the_version_follows_a_file_that_is_added_or_changed(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "files", lambda package: tmp_path)
    for package in sources.LAYERS:
        (tmp_path / package).mkdir()
    for file, decides in (
        ("world/headlight/new.py", True),
        ("world/rendering/shaders/new.frag", True),
        ("loop/new.py", True),
        ("loop/campaign_of_roads.py", True),  # whatever its name
        ("loop/simulation/report.py", True),
        ("loop/new_folder/new.py", True),
        ("loop/studies/training/new.py", False),
        ("loop/report/new.py", False),
    ):
        versions = [sources.digest_of_code.__wrapped__()]
        for text in ("a = 1\n", "a = 2\n"):
            (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / file).write_text(text)
            versions.append(sources.digest_of_code.__wrapped__())
        assert len(set(versions)) == (3 if decides else 1), file


def test_the_folders_that_only_show_are_there():
    assert all((Path(__file__).parents[3] / each).exists() for each in sources.WITHOUT_EFFECT)
