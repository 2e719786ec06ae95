"""Messages of the studio's socket (docs/programs.md). The page's types are made from them by scripts/protocol.py."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from pydantic import Field, TypeAdapter

from luxloop.world.errors import LuxloopError
from luxloop.world.messages import Arrays, given_arrays, understood, unpack
from luxloop.world.params import Metres, Params

PROTOCOL: Final = 1
LARGEST: Final = 2**22  # bytes of a client's message

View = Literal["scene", "light", "camera", "matrix", "marks", "frames", "depth", "instances", "materials", "truth"]
VIEWS: Final[tuple[View, ...]] = ("scene", "light", "camera", "matrix", "marks")  # of a client that has not said what it shows
Text = Annotated[str, Field(max_length=4000)]
Override = Annotated[str, Field(max_length=100_000)]  # of which a whole list may be one
Overrides = Annotated[tuple[Override, ...], Field(max_length=100)]
Number = Annotated[int, Field(ge=0, lt=2**31)]


class FromClient(Params):
    """What a client says. ask: where it is given, `done` with the same number comes once this is done, or `error` with it."""

    ask: Number | None = None


class Hello(FromClient):
    """The first message."""

    type: Literal["hello"]
    token: Text
    name: Text = ""


class Want(FromClient):
    """What the client shows; nothing else is computed for it. Before the first one: scene, light, camera, matrix, marks.

    shared: arrays of steps come in memory of the same machine.
    """

    type: Literal["want"]
    shared: bool = False
    views: tuple[View, ...] = Field(max_length=20)


class Scrub(FromClient):
    """A step to see again, answered by `step` with `scrub`; no newer one is sent until step is null, which also goes after `scenario`."""

    type: Literal["scrub"]
    run: Number = 0
    step: Number | None


class AskSummary(FromClient):
    """Ask for the summary of a run so far."""

    type: Literal["summary"]
    run: Number = 0


class AskBeam(FromClient):
    """Ask for a regulation's verdict on a lamp's light in a step, null for the newest."""

    type: Literal["beam"]
    run: Number = 0
    rule: Text
    side: Literal["left", "right"] = "left"
    step: Number | None = None


class AskSchema(FromClient):
    """Ask for the schema of the scenario model."""

    type: Literal["schema"]


class Acknowledge(FromClient):
    """A step is shown. id: that of its message. While two steps of a run are not shown, no other is sent."""

    type: Literal["shown"]
    id: Number


class Button(FromClient):
    """Take the pen, run, pause, one step, start anew from step 0, undo or redo edits, ask for the scenario as it is now."""

    type: Literal["pen", "play", "pause", "step", "reset", "undo", "redo", "save"]


class Speed(FromClient):
    """Times real time at most, null without limit."""

    type: Literal["speed"]
    factor: float | None = Field(ge=0.001, le=1000)


class Open(FromClient):
    """Another scenario, with values as of `--set`, or the recording in a folder."""

    type: Literal["open"]
    name: Text = ""
    overrides: Overrides = ()
    recording: Text | None = None


class Set(FromClient):
    """Other values of keys, `KEY=VALUE` each. Answered by `edit` if the runs can go on, else by `scenario`."""

    type: Literal["set"]
    overrides: Overrides


class Record(FromClient):
    """Record all steps of the first run into a folder of this name below `runs`, until null or the last step."""

    type: Literal["record"]
    folder: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_. -]{0,79}$")] | None


class Drive(FromClient):
    """Drive the vehicles of all runs until another message comes; both null: nobody any more. 1: full throttle, left; -1: brake, right."""

    type: Literal["drive"]
    throttle: float | None = Field(ge=-1, le=1)
    steering: float | None = Field(ge=-1, le=1)


class Compare(FromClient):
    """A second run beside the first, with other values or of a recording, which starts both anew; both null for none."""

    type: Literal["compare"]
    overrides: Overrides | None = None
    recording: Text | None = None


class Paint(FromClient):
    """Pixels of a module of the first run are painted.

    box: first row, end row, first column, end column. Its arrays `[rows, columns]` take the place of what was painted there: value, 255 for
    full utilisation; painted, 255 where the value holds, 0 where nothing is painted, and shares between, both u1. over: over the light of
    functions, else in its place. stroke: successive messages of the same one, above 0 and unlike other clients', are undone together.
    """

    type: Literal["paint"]
    stroke: Number = 0
    module: Number
    box: tuple[Number, Number, Number, Number]
    over: bool = True


class Place(FromClient):
    """The pixels that light a point of the world as the newest step shows it.

    value: what they are painted with, 255 for full utilisation; null: nothing. stroke: as of `paint`.
    """

    type: Literal["place"]
    stroke: Number = 0
    point_m: tuple[Metres, Metres, Metres]
    value: int | None = Field(None, ge=0, le=255)
    over: bool = True


class Wish(FromClient):
    """Illuminances of the road before the car, or of a wall 25 m before it, for which the pixels of all modules are painted.

    box_m: least and largest x, least and largest y on the road; on the wall heights, and y. Its arrays `[rows, columns]`, along these, of
    up to 20,000 cells: lx, f2 or f4; painted, u1, 0 where nothing is wanted.
    """

    type: Literal["wish"]
    on: Literal["road", "wall"] = "road"
    box_m: tuple[Metres, Metres, Metres, Metres]
    over: bool = True


Message = (
    Hello
    | (Want | Scrub | AskSummary | AskBeam | AskSchema | Acknowledge)
    | (Button | Speed | Open | Set | Record | Compare | Drive | Paint | Place | Wish)
)
ARRAYS: Final[Mapping[str, Mapping[str, tuple[str, ...]]]] = {  # dtypes of messages with a body, by type and name
    "paint": {"value": ("u1",), "painted": ("u1",)},
    "wish": {"lx": ("f2", "f4"), "painted": ("u1",)},
}
MESSAGE: Final[TypeAdapter[Message]] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


@dataclass(frozen=True)
class Request:
    """What a client wants to see. at: run and step in place of the newest. shown: the last `id` of a step that it has shown.
    shared: whether arrays of steps go through memory.
    """

    wanted: frozenset[View] = frozenset(VIEWS)
    at: tuple[int, int] | None = None
    shown: int = 0
    shared: bool = False


def read(data: bytes | str) -> tuple[Message, Arrays]:
    """A client's message, and the arrays that messages of its type have. Raises LuxloopError that says what is wrong with it."""
    with understood():
        head, arrays, body = unpack(data)
        message = MESSAGE.validate_python(head)
        return message, given_arrays(arrays, body, ARRAYS.get(message.type, {}))


def ask_of(data: bytes | str) -> int | None:
    """The number `ask` of a message that is refused, None where it has none."""
    with suppress(LuxloopError), understood():
        return FromClient(ask=unpack(data)[0].get("ask")).ask
    return None
