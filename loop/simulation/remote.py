"""An external simulator as a plant, in lockstep over a socket (docs/programs.md): light out; frames, samples and objects in."""

import re
import socket
import struct
import threading
import weakref
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from queue import Empty, SimpleQueue
from typing import Any, Final, Literal

import numpy as np
import torch
from torch import Tensor
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from luxloop.loop.scenario.model import Scenario
from luxloop.loop.scenario.plant import RemotePlantParams
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame, Objects
from luxloop.loop.simulation.remote_messages import PROTOCOL, Answer, Failure, Hello, largest, object_of, read, track_objects
from luxloop.loop.simulation.truth import LampModule
from luxloop.perception.camera import camera_view, saturation_luminance
from luxloop.perception.egomotion import Sample
from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import REST
from luxloop.world.messages import ArrayBytes, Arrays, pack, raw

GREET_S: Final = 10.0  # time limit for the hello of a connected program
CLOSE_S: Final = 1.0  # time limit for its reply to the end of the connection
LOOK_S: Final = 0.5  # interval of checks whether Python ends
REFUSED: Final = 4400  # close code for a breach of the protocol
BUSY: Final = 4409  # close code if another simulator is already the plant
HERE: Final = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")  # origins of pages on this machine


class Link:
    """The connection to one simulator. timeout_s: time limit for its connection and for each answer. size: height and width of its
    frames.
    """

    def __init__(self, address: str, timeout_s: float, size: tuple[int, int]) -> None:
        self.address, self._timeout_s, self._size = address, timeout_s, size
        self._opened, self._ending, self._over = ExitStack(), threading.Event(), threading.Event()
        self._met: tuple[ServerConnection, str] | None = None  # connection and name of the simulator

    def meet(self, welcome: Mapping[str, Any]) -> None:
        """Wait for a simulator and welcome it, unless one is connected. Raises LuxloopError without one, or for an unusable address."""
        if self._met is not None:
            return
        came, refused = SimpleQueue[tuple[ServerConnection, str]](), list[str]()
        self._listen(came, refused)
        try:
            self._met = came.get(timeout=self._timeout_s)
        except Empty:
            self.close()
            others = f"; refused: {refused[-1]}" if refused else ""
            raise LuxloopError(
                f"no simulator has connected to ws://{self.address} within {self._timeout_s:g} s; start one, or raise "
                f"plant.timeout_s{others}"
            ) from None
        self._send({"type": "welcome", "protocol": PROTOCOL, **welcome})

    def ask(self, head: Mapping[str, Any], arrays: Mapping[str, ArrayBytes] | None = None) -> tuple[Answer, Arrays]:
        """Send a message and wait for its answer, arrivals of the same `number`.

        Raises LuxloopError and closes the connection if the simulator disconnects, exceeds the time limit, breaks the protocol, or
        reports an error.
        """
        self._send(head, arrays)
        assert self._met is not None
        connection, name = self._met
        try:
            message, frames = read(connection.recv(self._timeout_s), self._size)
            if isinstance(message, Failure):
                self.close()
                raise LuxloopError(f"{name}: fails ({message.text})")
            if not isinstance(message, Answer) or message.number != head.get("number"):
                number = f" of exposure {message.number}" if isinstance(message, Answer) else ""
                raise LuxloopError(f"gives {message.type}{number}, but was asked for arrivals with number {head.get('number')}")
        except TimeoutError as error:
            raise self._broken(f"does not answer within {self._timeout_s:g} s; raise plant.timeout_s if it needs longer") from error
        except ConnectionClosed as error:
            raise self._broken(f"has gone ({error})") from error
        except LuxloopError as error:
            raise error if self._met is None else self._broken(str(error)) from error
        return message, frames

    def close(self, text: str = "") -> None:
        """End the connection with a last message: the end of the run, or an error text."""
        self._ending.set()
        met, self._met = self._met, None
        if met is not None:
            _dismiss(met[0], {"type": "error", "text": text} if text else {"type": "end"}, REFUSED if text else 1000)
        self._over.set()
        self._opened.close()

    def _listen(self, came: SimpleQueue[tuple[ServerConnection, str]], refused: list[str]) -> None:
        """Accept connections: the first simulator goes to the queue came, refusals of other programs to the list refused."""
        host, _, port = self.address.rpartition(":")
        size, ending, over, taken = self._size, threading.Event(), threading.Event(), threading.Lock()
        seconds, rest = divmod(self._timeout_s, 1)
        send_timeout = struct.pack("@ll", int(seconds), int(1e6 * rest))  # for the socket only: a Python timeout would also limit reading

        def greet(connection: ServerConnection) -> None:
            try:
                connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, send_timeout)
                hello, _ = read(connection.recv(GREET_S), size)
                if not isinstance(hello, Hello) or hello.protocol != PROTOCOL:
                    raise LuxloopError(f"a program must first say hello, with protocol {PROTOCOL}")
            except (LuxloopError, OSError, ConnectionClosed) as error:
                refused.append(str(error) or "a program said nothing")
                _dismiss(connection, {"type": "error", "text": refused[-1]}, REFUSED)
                return
            if ending.is_set():  # the simulator reconnects for the next run
                return
            if not taken.acquire(blocking=False):
                _dismiss(connection, {"type": "error", "text": "another simulator is the plant of this run"}, BUSY)
                return
            came.put((connection, hello.name))
            while not over.wait(LOOK_S) and threading.main_thread().is_alive():
                pass

        try:
            server = serve(
                greet,
                host.strip("[]"),
                int(port),
                origins=[None, HERE],
                compression=None,
                open_timeout=GREET_S,
                ping_interval=None,  # a simulator may compute for longer than a ping interval
                close_timeout=CLOSE_S,
                max_size=largest(size),
                max_queue=2,
                family=socket.AF_INET6 if ":" in host else socket.AF_INET,
            )
        except (OSError, OverflowError, UnicodeError) as error:
            raise LuxloopError(
                f"cannot listen on {self.address} ({getattr(error, 'strerror', None) or error}); set plant.address to another port"
            ) from error
        self._ending, self._over = ending, over
        self._opened.callback(server.shutdown)
        threading.Thread(target=server.serve_forever, name="remote plant", daemon=True).start()

    def _send(self, head: Mapping[str, Any], arrays: Mapping[str, ArrayBytes] | None = None) -> None:
        if self._met is None:
            raise LuxloopError("no simulator is connected any more; start the run anew")
        try:
            self._met[0].send(pack(head, arrays))
        except ConnectionClosed as error:
            raise self._broken(f"has gone, or does not read within {self._timeout_s:g} s ({error})") from error

    def _broken(self, text: str) -> LuxloopError:
        name = "" if self._met is None else f"{self._met[1]}: "
        self.close(text)
        return LuxloopError(f"{name}{text}")


def _dismiss(connection: ServerConnection, head: Mapping[str, Any], code: int) -> None:
    with suppress(ConnectionClosed):
        connection.send(pack(head))
    connection.close(code)


Window = tuple[int, int, int, int]  # first row, end row, first column, end column
RemoteState = tuple[int, Objects | None]  # number of exposures since the start, objects last reported


@dataclass(frozen=True, eq=False)
class RemotePlant:
    """A simulator behind a link. The simulator holds the world, so the loop cannot return to an earlier state.

    welcome: first message to the simulator. like: tensor with the dtype and device of frames and samples.
    """

    link: Link
    welcome: Mapping[str, Any]
    modules: tuple[LampModule, ...]
    sends: Literal["utilisation", "texture"]
    like: Tensor

    def start(self) -> tuple[RemoteState, Arrivals]:
        """Arrivals before the first exposure, once a simulator is connected. Raises LuxloopError if none connects or it fails."""
        self.link.meet(self.welcome)
        answer, frames = self.link.ask({"type": "start", "number": None})
        return self._came(0, None, answer, frames)

    def show(self, state: RemoteState, exposure: Exposure) -> tuple[RemoteState, Arrivals]:
        """Arrivals by the end of an exposure. Raises LuxloopError if the simulator fails or disconnects, and for an earlier state."""
        shown, objects = state
        if exposure.number != shown:
            raise LuxloopError(
                f"exposure {exposure.number} does not follow exposure {shown - 1}; a simulator goes on from its own state alone"
            )
        head, arrays = self.parts(exposure)
        answer, frames = self.link.ask(head, arrays)
        return self._came(shown + 1, objects, answer, frames)

    def parts(self, exposure: Exposure) -> tuple[dict[str, Any], dict[str, ArrayBytes]]:
        """Head and arrays of the message for an exposure."""
        commands, windows, arrays = exposure.commands or (REST,) * len(self.modules), list[Window](), dict[str, ArrayBytes]()
        for k, (module, light, command) in enumerate(zip(self.modules, exposure.lights, commands, strict=True)):
            lamp = module.headlight
            if self.sends == "texture":
                rows = lamp.rows_of(light.band)
                window, part = lit((command.intensity * lamp.light_rows(light.u, rows)).float().cpu().numpy(), rows.start)
            else:
                window, part = lit(light.u.view(lamp.pixel_rows, lamp.pixel_cols).float().cpu().numpy())
            windows.append(window)
            arrays[f"light.{k}"] = raw(part)
        head = {"type": "show", **{name: getattr(exposure, name) for name in ("number", "start_s", "duration_s")}}
        return {**head, "commands": [asdict(each) for each in commands], "windows": windows}, arrays

    def close(self) -> None:
        """End the connection and the run."""
        self.link.close()

    def _came(self, shown: int, before: Objects | None, answer: Answer, frames: Arrays) -> tuple[RemoteState, Arrivals]:
        objects = None if answer.objects is None else track_objects(before or (), map(object_of, answer.objects), answer.time_s)
        samples = (Sample(each.sensor, each.measured_s, each.arrived_s, self.like.new_tensor(each.values)) for each in answer.samples)
        come = (
            Frame(
                each.number,
                each.taken_s,
                each.arrived_s,
                None if each.lost else torch.from_numpy(frames[f"frame.{each.number}"].astype(np.float32)).to(self.like),
            )
            for each in answer.frames
        )
        return (shown, objects), Arrivals(answer.time_s, tuple(come), tuple(samples), objects)


def remote_plant(scenario: Scenario, params: RemotePlantParams, modules: Sequence[LampModule]) -> RemotePlant:
    """The remote plant of a scenario; `start` opens the connection, garbage collection ends it."""
    camera = scenario.camera
    link = Link(params.address, params.timeout_s, (camera.height_px, camera.width_px))
    plant = RemotePlant(link, _welcome(scenario, params, modules), tuple(modules), params.sends, modules[0].headlight.matrix.values)
    weakref.finalize(plant, link.close)
    return plant


def lit(values: np.ndarray, first: int = 0) -> tuple[Window, np.ndarray]:
    """Smallest window around the non-zero values of an array `[rows, columns]`, and its values. first: number of the first row."""
    rows, columns = np.flatnonzero(values.any(1)), np.flatnonzero(values.any(0))
    if not len(rows):
        return (0, 0, 0, 0), values[:0, :0]
    top, end, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    return (first + top, first + end, left, right), values[top:end, left:right]


def _welcome(scenario: Scenario, params: RemotePlantParams, modules: Sequence[LampModule]) -> dict[str, Any]:
    camera, view = scenario.camera, camera_view(scenario.camera)
    return {
        "name": scenario.name,
        "sends": params.sends,
        "steps": scenario.steps,
        "rate_hz": scenario.rate_hz,
        "shares": scenario.shares,
        "seed": scenario.seed,
        "camera": {
            **{name: getattr(view, name) for name in ("width", "height", "fx", "fy", "cx", "cy")},
            "bits": camera.bits,
            "gamma": camera.gamma,
            "exposure_s": camera.exposure_s,
            "saturation_cd_m2": saturation_luminance(camera),
            "T_body_camera": view.T_world_view.flatten().tolist(),
        },
        "modules": [_module(each) for each in modules],
        "model": scenario.model_dump(mode="json"),
    }


def _module(module: LampModule) -> dict[str, Any]:
    names = ("rows", "cols", "left", "right", "bottom", "top", "pixel_rows", "pixel_cols", "peak_cd")
    facts = {name: getattr(module.headlight, name) for name in names}
    return {"name": module.name, **facts, "T_body_module": module.T_body_headlight.double().flatten().tolist()}
