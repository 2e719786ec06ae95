"""Messages of the studio's clients (docs/programs.md). The page's types are made from them by scripts/protocol.py."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from luxloop.world.errors import LuxloopError
from luxloop.world.messages import Arrays, given_arrays, understood, unpack
from luxloop.world.params import Metres, Params

PROTOCOL = 1
LARGEST = 2**22  # bytes of a client's message

View = Literal["scene", "light", "camera", "off", "symbol", "matrix", "marks", "frames", "depth", "instances", "materials", "truth"]
VIEWS: tuple[View, ...] = ("scene", "light", "camera", "matrix", "marks")  # of a client without a request
PICTURES: Mapping[View, str] = {"camera": "camera.on", "off": "camera.off", "symbol": "camera.symbol"}  # arrays of views
Text = Annotated[str, Field(max_length=4000)]
Override = Annotated[str, Field(max_length=100_000)]  # may hold a whole list
Overrides = Annotated[tuple[Override, ...], Field(max_length=100)]
Number = Annotated[int, Field(ge=0, lt=2**31)]
Point = tuple[Metres, Metres, Metres]


class FromClient(Params):
    """A client's message. ask: number of the answer `done` or `error`; without it there is no `done`."""

    ask: Number | None = None


class Hello(FromClient):
    """The first message."""

    type: Literal["hello"]
    token: Text
    name: Text = ""


class Want(FromClient):
    """Contents that the client shows; nothing else is computed for it. By default: scene, light, camera, matrix, marks.

    shared: whether arrays of steps come in shared memory of the same machine.
    """

    type: Literal["want"]
    shared: bool = False
    views: tuple[View, ...] = Field(max_length=20)


class Scrub(FromClient):
    """Show an earlier step, answered by `step` with `scrub`; no newer step is sent until step is null. A message `scenario` ends it,
    too.
    """

    type: Literal["scrub"]
    run: Number = 0
    step: Number | None


class AskSummary(FromClient):
    """Request the summary of a run so far."""

    type: Literal["summary"]
    run: Number = 0


class AskBeam(FromClient):
    """Request the result of a regulation's requirements for a lamp's light in a step, null for the newest."""

    type: Literal["beam"]
    run: Number = 0
    rule: Text
    side: Literal["left", "right"] = "left"
    step: Number | None = None


class AskMeter(FromClient):
    """Request the light where rays of sight meet the scene, or a wall 25 m ahead, in a step, null for the newest.

    eye_m, through_m: of the world; a ray goes from the eye through each of up to 3,000 points. side: the lamp to which angles, distance and
    luminous intensity refer, null for all lamps together; angles start at the origin of the lamp, or midway between those of all.
    """

    type: Literal["meter"]
    run: Number = 0
    step: Number | None = None
    on: Literal["scene", "wall"] = "scene"
    eye_m: Point
    through_m: tuple[Point, ...] = Field(min_length=1, max_length=3000)
    side: Literal["left", "right"] | None = None


class Acknowledge(FromClient):
    """A step was shown. id: of its message. While a step of a run is not shown, no newer one is sent."""

    type: Literal["shown"]
    id: Number


class Button(FromClient):
    """Take the pen (control), play, pause, do a step, restart, undo or redo edits, request the current scenario or the schema of its
    model.
    """

    type: Literal["pen", "play", "pause", "step", "reset", "undo", "redo", "save", "schema"]


class Speed(FromClient):
    """Largest speed as a multiple of real time, null without limit."""

    type: Literal["speed"]
    factor: float | None = Field(ge=0.001, le=1000)


class Open(FromClient):
    """Open another scenario with overrides as of `--set`, or the recording in a folder."""

    type: Literal["open"]
    name: Text = ""
    overrides: Overrides = ()
    recording: Text | None = None


class Set(FromClient):
    """Set keys, `KEY=VALUE` each. Answered by `edit` if the runs can continue, else by `scenario`."""

    type: Literal["set"]
    overrides: Overrides


class Record(FromClient):
    """Record all steps of the first run into a folder of this name below `runs`, until null or the last step."""

    type: Literal["record"]
    folder: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_. -]{0,79}$")] | None


class Drive(FromClient):
    """Drive the vehicles of all runs until the next message; null for both ends the drive. 1: full throttle, left; -1: brake, right."""

    type: Literal["drive"]
    throttle: float | None = Field(ge=-1, le=1)
    steering: float | None = Field(ge=-1, le=1)


class Compare(FromClient):
    """A second run beside the first, with overrides or from a recording; restarts both. Null for both removes the second run."""

    type: Literal["compare"]
    overrides: Overrides | None = None
    recording: Text | None = None


class Paint(FromClient):
    """Paint pixels of a module of the first run.

    box: first row, end row, first column, end column. The arrays `[rows, columns]` replace what was painted there: value, 255 for full
    utilisation; painted, the opacity, 255 for opaque; both u1. over: over the light of functions, else instead of it. stroke: messages with
    the same number above 0, unique among clients, are undone together.
    """

    type: Literal["paint"]
    stroke: Number = 0
    module: Number
    box: tuple[Number, Number, Number, Number]
    over: bool = True


class Place(FromClient):
    """Find the pixels that light a point of the world in the newest step.

    value: paint them, 255 for full utilisation; null: do not. stroke: as of `paint`.
    """

    type: Literal["place"]
    stroke: Number = 0
    point_m: Point
    value: int | None = Field(None, ge=0, le=255)
    over: bool = True


class Wish(FromClient):
    """Paint the pixels of all modules for wanted illuminances on the road ahead, or on a wall 25 m ahead.

    box_m: least and largest x, least and largest y on the road; on the wall heights and y. The arrays `[rows, columns]` of up to 20,000
    cells: lx, f2 or f4; painted, u1, 0 without a wanted illuminance.
    """

    type: Literal["wish"]
    on: Literal["road", "wall"] = "road"
    box_m: tuple[Metres, Metres, Metres, Metres]
    over: bool = True


Message = (
    Hello
    | (Want | Scrub | AskSummary | AskBeam | AskMeter | Acknowledge)
    | (Button | Speed | Open | Set | Record | Compare | Drive | Paint | Place | Wish)
)
ARRAYS: Mapping[str, Mapping[str, tuple[str, ...]]] = {  # dtypes of messages with a body, by type and name
    "paint": {"value": ("u1",), "painted": ("u1",)},
    "wish": {"lx": ("f2", "f4"), "painted": ("u1",)},
}
MESSAGE: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


@dataclass(frozen=True)
class Request:
    """Contents wanted by a client.

    at: run and step instead of the newest. shown: last `id` of a shown step. shared: whether arrays of steps go through shared memory.
    """

    wanted: frozenset[View] = frozenset(VIEWS)
    at: tuple[int, int] | None = None
    shown: int = 0
    shared: bool = False


def read(data: bytes | str) -> tuple[Message, Arrays]:
    """A client's message and its arrays. Raises LuxloopError with what is wrong with it."""
    with understood():
        head, arrays, body = unpack(data)
        message = MESSAGE.validate_python(head)
        return message, given_arrays(arrays, body, ARRAYS.get(message.type, {}))


def ask_of(data: bytes | str) -> int | None:
    """Number `ask` of a refused message, None without one."""
    with suppress(LuxloopError), understood():
        return FromClient(ask=unpack(data)[0].get("ask")).ask
    return None
