"""The commands `luxloop rig ...`: a real rig, and the rig process, which simulates one."""

import re
import signal
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from luxloop.loop.commands.options import AllowCode, Count, Flag, Keys, Share, scenario_of, within
from luxloop.loop.commands.rig_calibration import board, calibrate, digitise, fit
from luxloop.loop.commands.rig_runs import connect, pixel_grids, read_rig
from luxloop.loop.report import terminal as tables
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.files import atomic_write, writing

if TYPE_CHECKING:
    from luxloop.loop.rig.blink import BlinkResult

Named = Annotated[str, Parameter(name="--scenario")]
rig_app = App(name="rig", help="A rig: a real lamp and a real camera in the loop, or a process that simulates both.")
for command in (board, calibrate, digitise, fit):
    rig_app.command(command)


@rig_app.command
def simulate(
    name: str,
    /,
    *,
    faults: Path | None = None,
    set: Keys = None,
    host: str = "127.0.0.1",
    light_port: int = 4048,
    camera_port: int = 8080,
    truth_port: int = 8081,
    ego: str = "127.0.0.1:4049",
    screen: str | None = None,
    allow_code: AllowCode = False,
) -> None:
    """Simulate a rig in real time until Ctrl-C: take light over the network, light road and objects, and serve the camera's pictures.

    Parameters
    ----------
    name
        Scenario file, or name of a shipped scenario.
    faults
        TOML file of the rig's faults (see docs/rig.md); by default it has none.
    set
        Keys to change, as key=value in TOML syntax: of the scenario, such as camera.width_px=640, or of the faults, such as
        faults.camera.latency_s=0.02.
    host
        Address to listen on; other machines can connect only if it is not 127.0.0.1.
    light_port
        UDP port for light (DDP), 0 for a free one.
    camera_port
        HTTP port of the camera, 0 for a free one.
    truth_port
        HTTP port of the ground truth for tests, 0 for a free one.
    ego
        Address HOST:PORT to which samples of the vehicle's sensors are sent, if the scenario has a vehicle.
    screen
        Address HOST:PORT of the page of a loop whose light is `screen`: the rig process is then the projector that shows this page, and
        opens no UDP port for light.
    """
    from luxloop.loop.rig.simulated.faults import read, split

    keys, changes = split(set or ())
    scenario, wrong = scenario_of(name, keys, allow_code=allow_code), read(faults, changes)
    from luxloop.loop.rig.simulated.rig import Ports, SimulatedRig

    addresses = _address("--ego", ego), None if screen is None else _address("--screen", screen)
    with SimulatedRig(scenario, wrong, Ports(host, light_port, camera_port, truth_port, *addresses)) as rig:

        def ready() -> None:
            print("\n".join([*rig.addresses(), "End it with Ctrl-C."]), flush=True)

        with _ending(rig.end):
            rig.run(ready)
        print(rig.summary(), flush=True)


@rig_app.command
def check(file: Path, /, *, scenario: Named = "snowflake", set: Keys = None, allow_code: AllowCode = False) -> None:
    """Check a rig without lighting it: the rig file, the lamp's address, and three seconds of the camera's pictures.

    Parameters
    ----------
    file
        Rig file.
    scenario
        Scenario whose lamp and camera the rig must fit.
    set
        Keys of the scenario to change, as key=value in TOML syntax.
    """
    from luxloop.loop.rig.arrays import pixels_in
    from luxloop.loop.rig.lights import open_light
    from luxloop.loop.rig.rig import look

    params = read_rig(file, allow_code)
    fitting = scenario_of(scenario, set, allow_code=allow_code)
    grids = pixel_grids(fitting)
    with locate(str(file)):
        open_light(params.light, grids).close()
    with connect(params, file, grids, fitting.camera, False) as rig:
        found = look(rig)
    rows = {
        "light": f"{params.light.kind}, {pixels_in(grids):,} pixels of {scenario}; not lit",
        "camera": f"{', '.join(f'{w} x {h} px' for w, h in found['sizes'])} at {found['rate_hz']:.1f} Hz, "
        f"{found['interval_worst_ms']:.0f} ms between two pictures at most, {found['late']:.0%} of them from a queue",
        "brightest": f"{found['brightest']:.0%} of the largest digital number",
        "timing": f"frames count from {1e3 * params.timing.clear_s:.0f} ms after the light on; measure it with luxloop rig blink",
        "limits": f"{params.limits.share:.0%} mean utilisation, {params.limits.change_per_s:g} change a second",
    }
    tables.show(tables.facts(rows))
    if found["refused"]:
        raise LuxloopError(f"{file}: {found['refused']}")


@rig_app.command
def light(
    file: Path,
    /,
    *,
    arm: Flag = False,
    scenario: Named = "snowflake",
    set: Keys = None,
    level: Share = 1.0,
    seconds: Annotated[float, within(gt=0, lte=3600)] = 60.0,
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

    from luxloop.loop.rig.arrays import pixels_in
    from luxloop.loop.rig.light import Shine

    params = read_rig(file, allow_code, mark=None)
    grids = pixel_grids(scenario_of(scenario, set, allow_code=allow_code))
    if not arm:
        count = pixels_in(grids)
        print(f"{file}: all {count:,} pixels would be lit for {seconds:g} s; give --arm to light them")
        return
    on = tuple(np.full(grid, level, np.float32) for grid in grids)
    with connect(params, file, grids, None, True) as rig, tables.progress("light", max(round(seconds), 1)) as advance:
        until_s, number = time.monotonic() + seconds, 0
        while time.monotonic() < until_s:
            shown, _ = rig.expose(Shine(number, on), 1.0)
            number += 1
            if shown.dimmed < 1:
                raise LuxloopError(f"limits: let {shown.dimmed:.0%} of it through; give a lower --level, or raise power")
            advance()
    print("dark again")


@rig_app.command
def take(
    file: Path,
    /,
    *,
    out: Path = Path("boards"),
    count: Count = 20,
    every_s: Annotated[float, within(gte=0, lte=60)] = 1.0,
    allow_code: AllowCode = False,
) -> None:
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

    from luxloop.loop.rig.rectification import grey
    from luxloop.loop.rig.rig import CAMERA_S

    single = out.suffix == ".png"
    if out.exists():
        raise LuxloopError(f"{out}: is there already; name another, or remove it")
    params = read_rig(file, allow_code, mark=None)
    paths = [out] if single else [out / f"{k:03d}.png" for k in range(count)]
    with connect(params, file, (), None, False) as rig, tables.progress("pictures", len(paths)) as advance:
        for k, path in enumerate(paths):
            time.sleep(every_s if k else 0.0)
            rig.camera.forget()
            picture = rig.picture(time.monotonic() + CAMERA_S)
            if picture is None:
                raise LuxloopError(f"camera: {rig.camera.reason}")
            codes: Any = grey(picture.data)
            encoded = cv2.imencode(".png", codes)[1].tobytes()
            with writing(path.parent, "name another folder"):
                path.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(path, encoded)
            advance()
    print(f"{out} written" if single else f"{out} written: {count} pictures")


@rig_app.command
def blink(
    file: Path,
    /,
    *,
    arm: Flag = False,
    scenario: Named = "snowflake",
    set: Keys = None,
    blinks: int = 100,
    level: Share = 1.0,
    write: Flag = False,
    allow_code: AllowCode = False,
) -> None:
    """Measure the delay from light to frame: all pixels go on and off at random times, for half a second each.

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
    blinks
        Number of changes of the light.
    level
        Utilisation of all pixels; the limits of the rig file may dim it.
    write
        Write the result as [timing] into the rig file.
    """
    from luxloop.loop.rig.arrays import pixels_in
    from luxloop.loop.rig.blink import evaluate, record

    params = read_rig(file, allow_code)
    grids = pixel_grids(scenario_of(scenario, set, allow_code=allow_code))
    if not arm:
        print(f"{file}: all {pixels_in(grids):,} pixels would blink {blinks} times; give --arm to light them")
        return
    with connect(params, file, grids, None, True) as rig, tables.progress("blink", blinks + 2) as advance:
        found = evaluate(record(rig, grids, blinks, level, advance), blinks)
    tables.show(tables.facts(_delays(found)))
    if found.warning:
        tables.say(found.warning)
    text = "[timing]\n" + "".join(f"{name} = {value:g}\n" for name, value in found.timing.items())
    if write:
        write_timing(file, found.timing)
        print(f"{file}: [timing] written")
    else:
        print(f"\n{text}\nWith --write these go into {file}.")


def write_timing(file: Path, timing: Mapping[str, float]) -> None:
    """Write values of `[timing]` into a rig file and change nothing else. Raises LuxloopError if the file cannot be written."""
    text = file.read_text("utf-8")
    table = re.search(r"^\[timing\][^\n]*\n(?:(?!\[)[^\n]*\n?)*", text, re.M)
    old = table[0] if table else "\n[timing]\n"
    new = old if old.endswith("\n") else f"{old}\n"
    for name, value in reversed(list(timing.items())):
        line, pattern = f"{name} = {value:g}", rf"^{name}\s*=[^\n]*"
        if re.search(pattern, new, re.M):
            new = re.sub(pattern, line, new, flags=re.M)
        else:
            new = re.sub(r"(\[timing\][^\n]*\n)", rf"\1{line}\n", new)
    made = text.replace(old, new) if table else f"{text.rstrip()}\n{new}"
    try:
        understood = tomllib.loads(made)["timing"].items() >= {name: float(f"{value:g}") for name, value in timing.items()}.items()
    except tomllib.TOMLDecodeError:
        understood = False
    if not understood:  # [timing] has another notation
        raise LuxloopError(f"{file}: timing: is not written as a table [timing] of its own, with a line for each key; rewrite it so")
    atomic_write(file, made)


def _delays(found: "BlinkResult") -> dict[str, str]:
    (interval, longest), (median, most, worst) = found.interval_s, (1e3 * each for each in found.first_s)
    return {
        "light to frame": f"{median:.0f} ms (median), {most:.0f} ms (95 %), {worst:.0f} ms (worst), in {found.blinks} blinks",
        "latency": f"{1e3 * found.latency_s:.1f} ms to a frame that begins with the light",
        "jitter": f"{1e3 * found.jitter_s:.1f} ms, the worst that was measured with a quarter and 8 ms on it",
        "exposure and readout": f"{1e3 * found.rolling_s:.1f} ms",
        "drift": "{:+.1f} ± {:.1f} ms a minute".format(*(1e3 * each for each in found.drift_s_per_min)),
        "pictures": f"every {1e3 * interval:.1f} ms (median), {1e3 * longest:.0f} ms (worst), {found.queued:.0%} queued",
    }


@contextmanager
def _ending(end: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP call `end` in place of an exception, which could be raised while a lock is held."""
    ends = [each for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if signal.getsignal(each) is not signal.SIG_IGN]
    before = [(each, signal.signal(each, lambda *_: end())) for each in ends]
    try:
        yield
    finally:
        for each, handler in before:
            signal.signal(each, handler)


def _address(option: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and 0 < int(port) < 65536):
        raise LuxloopError(f"{option} {text}: is no address; write HOST:PORT, such as 127.0.0.1:4049")
    return host, int(port)
