"""The commands `luxloop rig ...`: a real rig, and the rig process, which simulates one."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import App

from luxloop.loop.commands.given import scenario_of
from luxloop.loop.commands.options import AllowCode, Keys
from luxloop.loop.commands.rig_calibration import board, calibrate, digitise, fit
from luxloop.loop.commands.rig_pictures import light, take
from luxloop.loop.commands.rig_runs import blink, check
from luxloop.world.errors import LuxloopError

if TYPE_CHECKING:
    from luxloop.loop.rig.simulated.camera import End

rig_app = App(name="rig", help="A rig: a real lamp and a real camera in the loop, or a process that simulates both.")
for command in (check, light, take, blink, board, calibrate, digitise, fit):
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
    from luxloop.loop.rig.simulated.camera import End
    from luxloop.loop.rig.simulated.rig import Ports, Rig

    addresses = _address("--ego", ego), None if screen is None else _address("--screen", screen)
    end = End()
    with Rig(scenario, wrong, Ports(host, light_port, camera_port, truth_port, *addresses)) as rig:

        def ready() -> None:
            print("\n".join([*rig.addresses(), "End it with Ctrl-C."]), flush=True)

        with _ending(end):
            rig.run(end, ready)
        print(rig.summary(), flush=True)


@contextmanager
def _ending(end: "End") -> Iterator[None]:
    """Ctrl-C, SIGTERM and SIGHUP request the end, in place of an exception that could be raised while a lock is held."""
    ends = [each for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if signal.getsignal(each) is not signal.SIG_IGN]
    before = [(each, signal.signal(each, lambda *_: end.ask())) for each in ends]
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
