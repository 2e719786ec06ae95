"""`luxloop rig take`, pictures of the camera, and `luxloop rig light`, all pixels on: both are needed for a calibration."""

import time
from pathlib import Path
from typing import Any

from luxloop.loop.commands.given import scenario_of
from luxloop.loop.commands.options import AllowCode, Flag, Keys
from luxloop.loop.commands.rig_runs import Named, await_rig, pixel_grids
from luxloop.loop.report.progress import progress
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import whole


def take(file: Path, /, *, out: Path = Path("boards"), count: int = 20, every_s: float = 1.0, allow_code: AllowCode = False) -> None:
    """Take pictures with a rig's camera, such as of a calibration board, and save them unchanged; the lamp is not opened.

    Parameters
    ----------
    file
        Rig file.
    out
        Folder for the pictures; a name that ends in .png takes a single picture.
    count
        Number of pictures.
    every_s
        Time between two pictures in s, to move the board.
    """
    import cv2

    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.rectified import grey
    from luxloop.loop.rig.rig import CAMERA_S, opened

    single = out.suffix == ".png"
    if out.exists():
        raise LuxloopError(f"{out}: is there already; name another, or remove it")
    if count < 1 or not 0 <= every_s <= 60:
        raise LuxloopError("--count is at least 1, --every-s from 0 to 60")
    params = load_rig(file, allow_code=allow_code).model_copy(update={"mark": None})
    paths = [out] if single else [out / f"{k:03d}.png" for k in range(count)]
    with locate(str(file)), opened(params, (), None, armed=False) as rig, progress("pictures", len(paths)) as advance:
        await_rig(rig)
        for k, path in enumerate(paths):
            time.sleep(every_s if k else 0.0)
            rig.camera.forget()
            if params.triggered:
                rig.camera.trigger()
            picture = rig.camera.next(time.monotonic() + CAMERA_S)
            if picture is None:
                raise LuxloopError(f"camera: {rig.camera.reason}")
            codes: Any = grey(picture.data)
            encoded = cv2.imencode(".png", codes)[1].tobytes()
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise LuxloopError(f"{path.parent}: cannot be made ({error.strerror}); name another folder") from error
            with whole(path) as part:
                part.write_bytes(encoded)
            advance()
    print(f"{out} written" if single else f"{out} written: {count} pictures")


def light(
    file: Path,
    /,
    *,
    arm: Flag = False,
    scenario: Named = "snowflake",
    set: Keys = None,
    level: float = 1.0,
    seconds: float = 60.0,
    allow_code: AllowCode = False,
) -> None:
    """Light all pixels for some time, or until Ctrl-C, to aim the lamp, focus the camera or read a luxmeter.

    Parameters
    ----------
    file
        Rig file.
    arm
        Light the lamp. Without it, no device is opened.
    scenario
        Scenario with the rig's lamp.
    set
        Keys of the scenario to change, as key=value in TOML syntax.
    level
        Utilisation of all pixels; the command ends if the limits of the rig file dim it.
    seconds
        Duration in s.
    """
    import numpy as np

    from luxloop.loop.rig.light import Shine
    from luxloop.loop.rig.params import load_rig
    from luxloop.loop.rig.rig import opened

    if not 0 < level <= 1 or not 0 < seconds <= 3600:
        raise LuxloopError("--level is a utilisation above 0, up to 1; --seconds up to 3600")
    params = load_rig(file, allow_code=allow_code).model_copy(update={"mark": None})
    grids = pixel_grids(scenario_of(scenario, set, allow_code=allow_code))
    if not arm:
        count = sum(rows * columns for rows, columns in grids)
        print(f"{file}: all {count:,} pixels would be lit for {seconds:g} s; give --arm to light them")
        return
    on = tuple(np.full(grid, level, np.float32) for grid in grids)
    with locate(str(file)), opened(params, grids, None, armed=True) as rig, progress("light", max(round(seconds), 1)) as advance:
        await_rig(rig)
        until_s, number = time.monotonic() + seconds, 0
        while time.monotonic() < until_s:
            given, _ = rig.expose(Shine(number, on), 1.0)
            number += 1
            if given.dimmed < 1:
                raise LuxloopError(f"limits: let {given.dimmed:.0%} of it through; give a lower --level, or raise power")
            advance()
    print("dark again")
