"""A program's connection to a loop in a `luxloop studio`."""

import re
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from typing import Any, Self
from urllib.parse import urlsplit

import numpy as np
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as open_socket

from luxloop.loop.studio.inbox import Inbox, State, unpack
from luxloop.loop.studio.messages import View
from luxloop.loop.studio.shared import BlockReader
from luxloop.world.errors import LuxloopError
from luxloop.world.messages import encode, pack
from luxloop.world.validation import toml

VIEWS: tuple[View, ...] = ("frames", "light", "matrix")
LOOK_S = 0.5  # interval of checks for a lost connection while waiting


def connect(url: str, *, views: Collection[View] = VIEWS, shared: bool = False, run: int = 0) -> "Client":
    """Watch and steer the loop of a `luxloop studio` from another program.

    url: the printed address, with the token after `#`. views: contents of states: "frames", "light", "matrix" (utilisations), "camera",
    "off", "symbol" (the page's pictures), "depth", "instances", "materials", "truth" (of objects), "marks"; only requested contents are
    computed. shared: read arrays from shared memory instead of the socket, which is faster, on the studio's machine. run: 1 for the second
    run beside the first.

    Waits until the loop is prepared. Raises LuxloopError if no studio answers, or the token is wrong.
    """
    parts = urlsplit(url)
    if parts.scheme != "http" or not parts.hostname or not parts.fragment:
        raise LuxloopError(f"connect: {url!r} is no address of a studio; give the one that luxloop studio prints, with what follows the #")
    stack = ExitStack()
    try:
        socket = stack.enter_context(open_socket(f"ws://{parts.netloc}/socket", max_size=None, compression=None, proxy=None))
    except (OSError, InvalidHandshake, TimeoutError) as error:
        raise LuxloopError(f"connect: no studio answers at {parts.netloc} ({error}); start luxloop studio first") from error
    client = Client(socket, stack, shared, run)
    try:
        client.begin(parts.fragment, views)
    except BaseException:
        client.close()
        raise
    return client


class Client:
    """A connection to a studio, made by `connect`; a context manager that closes it. Use it from one thread.

    Every method raises LuxloopError with the server's reason if the server refuses, and if the connection is lost.
    """

    def __init__(self, socket: ClientConnection, stack: ExitStack, shared: bool, run: int) -> None:
        """stack: closes the socket."""
        self._socket, self._stack, self._shared, self._run = socket, stack, shared, run
        self._blocks = BlockReader()
        self._news = threading.Condition()
        self._got = Inbox(run)
        self._number, self._lost = 0, ""
        self._given: State | None = None  # the last state returned to the program
        self._thread = threading.Thread(target=self._listen, name="studio", daemon=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin(self, token: str, views: Collection[View]) -> None:
        """Log in and wait for the first state. Called by `connect`."""
        self._thread.start()
        self._send({"type": "hello", "token": token, "name": "program"})
        self._wait(lambda: self._got.state is not None or bool(self._got.failed))
        if self._got.state is None:
            raise LuxloopError(self._got.failed)
        self.want(*views)

    def close(self) -> None:
        """Close the connection; the loop continues."""
        self._stack.close()
        if self._thread.is_alive():
            self._thread.join()
        self._blocks.close()

    @property
    def scenario(self) -> Mapping[str, Any]:
        """Message `scenario`: name, steps, rate_hz, runs (with modules, camera, columns) and model, the current scenario."""
        return self._got.scenario

    @property
    def facts(self) -> Mapping[str, Any]:
        """Facts of the run, an item of `scenario["runs"]`."""
        return dict(self._got.facts)

    @property
    def role(self) -> str:
        """Role of the token: "edit" or "watch"."""
        return str(self._got.welcome["role"])

    @property
    def state(self) -> State:
        """Newest state."""
        self._check()
        assert self._got.state is not None
        self._given = self._got.state
        return self._given

    @property
    def playing(self) -> bool:
        """Whether the loop runs freely."""
        return bool(self._got.playing)

    @property
    def over(self) -> bool:
        """Whether all steps of the scenario are done."""
        return self._got.done_steps >= self.scenario["steps"]

    def rows(self) -> dict[str, np.ndarray]:
        """Values of all steps so far, `[steps]` float32, by column of the recording."""
        with self._news:
            return self._got.table()

    def want(self, *views: View) -> State:
        """Request these views and no others; returns the first state with them."""
        wanted = set(views)
        self._ask("want", views=list(views), shared=self._shared)
        return self._wait_for(lambda state: wanted <= set(state.head["views"]))

    def take_pen(self) -> None:
        """Take control; the first client with an address for editing has it from the start."""
        self._ask("pen")

    def set(self, values: Mapping[str, Any]) -> None:
        """Set keys from the next step on: `{"functions.symbol.x_m": 18.0}`. None removes a table."""
        self._ask("set", overrides=[f"{key}={'{}' if value is None else toml(_plain(value))}" for key, value in values.items()])

    def command(self, module: str, swivel_deg: float = 0.0, level_deg: float = 0.0, intensity: float = 1.0) -> None:
        """Turn and dim a module, such as "left hires", from the next step until the next command, within the module's limits.

        swivel_deg: to the left positive. level_deg: down positive. intensity: share of its maximum.
        """
        values = {"swivel_deg": swivel_deg, "level_deg": level_deg, "intensity": intensity}
        name = re.sub("[^a-z0-9]+", "_", module.lower())
        self.set({f"functions.commanded_{name}": {"kind": "command", "modules": [module], **values}})

    def show(self, module: str, u: np.ndarray | None) -> None:
        """Set raw utilisations `[pixel rows, columns]` of a module, such as "left hires", instead of the functions' light, until the next
        call.

        u: 0 to 1, or uint8 with 255 for full utilisation, which is the sent format. None: the functions' light.
        """
        names = [each["name"] for each in self.facts["modules"]]
        if module not in names:
            raise LuxloopError(f"show: there is no module {module!r}; there are {', '.join(names)}")
        number = names.index(module)
        size = self.facts["modules"][number]["pixel_rows"], self.facts["modules"][number]["pixel_cols"]
        given = np.zeros(size, np.uint8) if u is None else np.asarray(u)
        if given.shape != size:
            raise LuxloopError(f"show: u has the shape {given.shape}, but {module!r} has {size[0]} x {size[1]} pixels")
        value = given if given.dtype == np.uint8 else (255 * np.clip(given, 0, 1)).round().astype(np.uint8)
        painted = np.full(size, 0 if u is None else 255, np.uint8)
        box = [0, size[0], 0, size[1]]
        self._ask("paint", {"value": value, "painted": painted}, module=number, box=box, over=u is None)

    def step(self) -> State:
        """Do one step; returns its state."""
        before = self._got.done_steps
        done = self._ask("step")["steps"][self._run]
        if done == before:
            raise LuxloopError(f"step: all {before} steps are done; call reset() first, or set steps")
        return self._wait_for(lambda state: state.step >= done - 1)

    def play(self) -> None:
        """Run freely; `for state in client` yields the newest states."""
        self._ask("play")

    def pause(self) -> None:
        """Pause after the current step."""
        self._ask("pause")

    def reset(self) -> State:
        """Restart from step 0; returns its state."""
        self._ask("reset")
        return self._wait_for(lambda state: state.step == 0)

    def summary(self) -> Mapping[str, Any]:
        """Results of all steps so far, as the summary of a recording."""
        self._ask("summary", run=self._run)
        return dict(self._got.answers["summary"]["summary"])

    def __iter__(self) -> Iterator[State]:
        """Newest states; states that arrive while the program works are skipped. Ends when the loop pauses.

        Raises LuxloopError if the loop has failed.
        """
        while True:
            self._wait(lambda: self._got.state is not self._given or self._got.at_rest)
            if (state := self._got.state) is self._given or state is None:
                if self._got.failed:
                    raise LuxloopError(self._got.failed)
                return
            self._given = state
            yield state

    def _wait_for(self, fits: Callable[[State], bool]) -> State:
        """First newest state that fits."""
        self._wait(lambda: self._got.state is not None and fits(self._got.state))
        return self.state

    def _ask(self, kind: str, arrays: Mapping[str, np.ndarray] | None = None, **values: Any) -> Mapping[str, Any]:
        """Send a request and wait for its completion; returns the answer `done`."""
        self._check()
        ask = self._number = self._number + 1
        self._got.replies.clear()
        self._send({"type": kind, "ask": ask, **values}, arrays)
        self._wait(lambda: bool(self._got.replies.keys() & {ask, None}))
        done = self._got.replies.get(ask) or self._got.replies[None]
        if done["type"] == "error":
            raise LuxloopError(done["text"])
        self._wait(lambda: self._got.knows(done))
        return done

    def _send(self, head: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None) -> None:
        try:
            self._socket.send(pack(head, {name: encode(each) for name, each in (arrays or {}).items()}))
        except ConnectionClosed as error:
            raise LuxloopError(self._reason(error)) from error

    def _wait(self, until: Callable[[], bool]) -> None:
        with self._news:
            while not until():
                self._check()
                self._news.wait(LOOK_S)

    def _check(self) -> None:
        """Raise LuxloopError if the connection is lost."""
        if self._lost:
            raise LuxloopError(self._lost)

    def _listen(self) -> None:
        """Receive messages in a thread, so that states are the newest."""
        try:
            for data in self._socket:
                assert isinstance(data, bytes)
                head, arrays = unpack(data)
                there = self._blocks.arrays(head["shared"], head["id"]) if "shared" in head else {}
                with self._news:
                    if there is not None:
                        self._got.take(head, arrays | there)
                    self._news.notify_all()
                if head["type"] == "step":
                    self._socket.send(pack({"type": "shown", "id": head["id"]}))
            lost = "the studio has ended"
        except ConnectionClosed as error:
            lost = self._reason(error)
        except LuxloopError as error:
            lost = str(error)
        except Exception as error:
            lost = f"the studio's messages are not understood ({type(error).__name__}: {error}); use the same version here and there"
        with self._news:
            self._lost = lost
            self._news.notify_all()

    @staticmethod
    def _reason(error: ConnectionClosed) -> str:
        reason = error.rcvd.reason if error.rcvd is not None else ""
        return reason or "the connection to the studio is lost; connect again"


def _plain(value: Any) -> Any:
    """Value without NumPy numbers and arrays."""
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
