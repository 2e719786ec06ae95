"""What the doctor says of a machine that is well, and of broken ones."""

import json
import os
import shutil
import subprocess
import sys
from importlib import metadata

from luxloop.loop.commands import doctor
from luxloop.loop.scenario import data


def test_every_check_reports_and_mends(lux):
    code, out, _ = lux("doctor", "--json")
    found = json.loads(out)
    assert code == (0 if found["ok"] else 1)
    results = [doctor.Check(**each) for each in found["checks"]]
    names = {check.name for check in results}
    assert len(names) == len(results) > 10
    assert {"Python", "OpenGL", "ray caster", "devices", "video", "data", "working folder"} <= names
    for check in results:
        assert check.found and "\n" not in check.found and (check.status == "ok") == (check.remedy == ""), check


def test_a_warning_does_not_keep_luxloop_from_running():
    ok, warn, fail = (doctor.Check("x", status, "y") for status in ("ok", "warn", "fail"))
    assert doctor.all_good([ok, warn])
    assert not doctor.all_good([ok, fail])


def test_old_python_and_missing_and_old_packages_name_the_command_that_installs_them():
    check = doctor.python_check((3, 10, 4))
    assert check.status == "fail" and check.found.startswith("3.10.4") and "python3" in check.remedy
    good, missing, old = map(doctor.package_check, ["numpy>=2", "no-such-package[extra]>=1", "torch>=999"])
    assert (good.status, missing.status, old.status) == ("ok", "fail", "fail") and good.found.startswith("2")
    assert missing.name == "no-such-package" and missing.remedy.endswith('-m pip install "no-such-package[extra]>=1"')
    assert "torch>=999" in old.found and old.remedy


def test_extras_that_are_not_here_are_named_with_the_command_that_adds_them(monkeypatch):
    assert doctor.extras_check().status == "ok"
    here = metadata.version
    monkeypatch.setattr(doctor.metadata, "version", lambda name: here("no-such-package" if name == "stable-baselines3" else name))
    check = doctor.extras_check()
    assert check.status == "ok" and "gym" in check.found.partition(";")[0] and "sb3" in check.found.partition("'luxloop[")[2]


def test_distribution_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: metadata.distribution("no-such-distribution"))
    (check,) = doctor.package_checks()
    assert check.status == "fail" and "-e" in check.remedy


def test_opengl_without_its_platform_or_driver(tmp_path):
    """No failure: rays take OpenGL's place. With an empty folder of drivers EGL finds none: a machine without Mesa."""
    check = doctor.opengl_check({**os.environ, "PYOPENGL_PLATFORM": "nonsense"})
    assert check.status == "warn" and "nonsense" in check.found and check.remedy == "unset PYOPENGL_PLATFORM"
    check = doctor.opengl_check({**os.environ, "PYOPENGL_PLATFORM": "egl", "__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path)})
    assert check.status == "warn" and check.found and "libegl1" in check.remedy


def test_a_crashing_driver_does_not_take_the_doctor_along(monkeypatch):
    crash = [sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"]
    run = subprocess.run
    monkeypatch.setattr(doctor.subprocess, "run", lambda command, **options: run(crash, **options))
    check = doctor.opengl_check(os.environ)
    assert check.status == "warn" and "signal 11" in check.found and check.remedy


def test_unused_gpu_is_worth_a_warning(monkeypatch):
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    check = doctor.device_check()
    assert check.status == "warn" and "torch" in check.remedy
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert doctor.device_check().status == "ok"


def test_broken_library_is_a_finding(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)  # makes `import av` fail
    check = doctor.video_check()
    assert check.status == "fail" and "av" in check.found and "pip install" in check.remedy


def test_data_folders(tmp_path, monkeypatch):
    monkeypatch.setattr(data, "cache_folder", lambda: tmp_path / "fetched")
    (tmp_path / "belgian_block.crg").touch()
    for folder, status, words, remedy in (
        (None, "warn", f"LUXLOOP_DATA is not set, fetched files are in {tmp_path / 'fetched'}", "luxloop data get all"),
        (tmp_path, "ok", f"LUXLOOP_DATA is {tmp_path},", ""),
        (tmp_path / "nowhere", "fail", "nowhere", "unset LUXLOOP_DATA"),
    ):
        monkeypatch.delenv("LUXLOOP_DATA", raising=False)
        if folder:
            monkeypatch.setenv("LUXLOOP_DATA", str(folder))
        found = doctor.data_check()
        assert (found.status, found.remedy) == (status, remedy) and words in found.found
        assert found.found.startswith("1 of ") == (status == "ok")


def test_folder_that_cannot_be_written_to(tmp_path):
    assert doctor.folder_check(tmp_path).status == "ok"
    missing = doctor.folder_check(tmp_path / "gone")
    assert missing.status == "fail" and "--out" in missing.remedy
