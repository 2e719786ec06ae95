"""The first run and the half day of docs/rig.md, word for word, against the rig processes that they start; only the ports are others."""

import re
import shlex
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from luxloop.loop.rig.calibration.digitise import Nominal
from luxloop.loop.rig.params import load_rig
from luxloop.loop.rig.simulated.faults import read
from luxloop.loop.rig.simulated.scene import RigScene
from luxloop.loop.scenario.model import load
from luxloop.world.headlight import Headlight
from luxloop.world.lamps import archive
from tests.loop.rig.conftest import ENVIRONMENT, PROGRAM, ROOT, SimulatedRigProcess
from tests.loop.rig.simulated.conftest import seen_px

pytestmark = pytest.mark.slow
WALL_M = 4.0


def commands_of(title: str) -> list[list[str]]:
    """The commands of a section of the page, without `luxloop`."""
    sections = re.split(r"^## ", (ROOT / "docs/rig.md").read_text("utf-8"), flags=re.M)
    page = next(each for each in sections if each.startswith(title))
    text = "\n".join(re.findall(r"^ *```sh\n(.*?)^ *```", page, re.M | re.S)).replace("\\\n", " ")
    return [shlex.split(line)[1:] for line in text.splitlines() if line.strip()]


def follow(commands: Sequence[Sequence[str]], folder: Path, edit: Callable[[Sequence[str], str], str]) -> dict[str, str]:
    """What the commands print. edit: the rig file after a command, with the ports of the rig process in place of the page's."""
    rig: SimulatedRigProcess | None = None
    said = dict[str, str]()
    try:
        for command in commands:
            if "simulate" in command:
                ports = None if rig is None else (rig.light, rig.camera, rig.port)
                if rig is not None:
                    rig.kill()
                rig = SimulatedRigProcess(command[2:], folder, ports)
                continue
            done = subprocess.run([*PROGRAM, *command], env=ENVIRONMENT, cwd=folder, capture_output=True, text=True)
            assert done.returncode == 0, f"{command}\n{done.stderr}"
            said[" ".join(command)] = done.stdout
            with suppress(FileNotFoundError):
                text = (folder / "rig.toml").read_text()
                if "new" in command and rig is not None:
                    text = text.replace("bits = 16", f"bits = 16\nport = {rig.light}", 1).replace(":8080/", f":{rig.camera}/")
                (folder / "rig.toml").write_text(edit(command, text))
    finally:
        if rig is not None:
            rig.kill()
    return said


def iou_in(text: str) -> float:
    found = re.search(r"as the camera sees it +IoU (0\.\d+)", text)
    return float(found[1])


def test_the_first_run_of_the_page(tmp_path):
    commands = commands_of("First run")
    assert len(commands) == 6
    said = follow(commands, tmp_path, lambda _, text: text)
    assert "the lamp stays dark" in next(out for name, out in said.items() if "runs/dry" in name)
    assert iou_in(next(out for name, out in said.items() if "runs/rig" in name)) > 0.85
    assert 0.02 < load_rig(tmp_path / "rig.toml").timing.latency_s < 0.1


def test_half_a_day_on_a_rig(tmp_path, monkeypatch):
    """Calibration from nothing, a digitised lamp, and a symbol by it."""
    monkeypatch.chdir(tmp_path)
    commands = commands_of("A table-top rig")

    def edit(command: Sequence[str], text: str) -> str:
        text = text.replace("dark_after_s = 0.1", "dark_after_s = 0.5")  # that of this rig process, which a busy machine keeps
        return text + '\n[calibration]\nfile = "rig.npz"\n' if "digitise" in command else text  # as the page says

    said = follow(commands, tmp_path, edit)
    iou = iou_in(list(said.values())[-1])
    first = next(each for each in commands if "simulate" in each and any("rig_table" in word for word in each))
    places_px, intensities = _errors(first[first.index("--set") + 1 :])
    print(f"\nplaces {places_px:.3f} px rms, intensities {intensities:.2%} rms, IoU {iou}")
    assert iou > 0.88
    assert places_px < 0.1  # the goals
    assert intensities < 0.02


def _errors(keys: list[str]) -> tuple[float, float]:
    """Of the pixels that shine, against the lamp as it truly is: root mean squares of their places in px and of their fluxes, relative."""
    rig_scene = RigScene(load("rig_table.toml", keys), read(Path("rig_table_faults.toml")))
    (module,) = rig_scene.modules
    true, nominal = module.headlight, Nominal.of(0, "", module.headlight)
    places = seen_px(rig_scene, nominal.y.ravel(), nominal.z.ravel(), WALL_M)
    with np.load("digitised_pixels.npz") as pixels:
        good = ~(pixels["0_dead"] | pixels["0_stuck"]).ravel()
        off = np.hypot(pixels["0_u_px"].ravel() - places[:, 0], pixels["0_v_px"].ravel() - places[:, 1])
    flux, measured = _flux(true), _flux(archive.load(Path("digitised.npz")).module("matrix").headlight)
    good &= flux > 0
    return float(np.sqrt((off[good] ** 2).mean())), float(np.sqrt(((measured[good] / flux[good] - 1) ** 2).mean()))


def _flux(light: Headlight) -> np.ndarray:
    """Luminous flux of each pixel in lm, `[n_p]`."""
    y, z = (each.numpy() for each in light.tangents())
    area = (light.left - light.right) / light.cols * (light.top - light.bottom) / light.rows
    return np.asarray(light.matrix.to_scipy().T @ (area * (1 + y**2 + z[:, None] ** 2) ** -1.5).ravel())
