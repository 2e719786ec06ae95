"""The contract of a plant of the user's own."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from luxloop.loop.run import prepare
from luxloop.loop.scenario.model import validate
from luxloop.loop.simulation.build_plant import KEY, METHODS
from luxloop.loop.simulation.checked import ROUNDING_S, check_frames, check_image, check_objects, check_samples, check_time, pair
from luxloop.loop.simulation.lamps import lamp_modules
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Frame
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import World
from luxloop.loop.studies.contracts.values import Parts, check_calls, check_state, copied, difference, name_of, pure
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.plugin import Guard, Name, check_methods, construct

CALLS = {"start": (), "show": ("state", "exposure")}
GIVES = "(state, arrivals)"
EXPOSURES = 24  # more than those of the 10 steps by which the frames of a scenario's camera may be late
UNDER_WAY = 4  # more than those of a step by which they are late, so that some come that a state must have held
SCENARIO: dict[str, Any] = {
    "name": "check_plant",
    "camera": {"width_px": 320, "height_px": 180, "oversampling": 1},
    "headlight": {"model": "idealised-332x1024", "lamps": ["left"]},
    "renderer": "raycast",
    "functions": {"symbol": {"kind": "symbol", "image": "snowflake", "controller": "open"}},
}


def check_plant(plant: type, options: Mapping[str, Any] | None = None, device: str = "auto") -> None:
    """Check your own plant against the contract of `[plant]`, in a few seconds.

    plant: the class, of which a scenario makes `plant(scenario, modules, **options)`; see `check_controller` for why it is the class.
    options: those of `[plant]`. device: "auto", "cpu" or "cuda".

    It shows 24 exposures of 1/60 s, with and without a symbol in turn, to a camera of 320 x 180 px: each of them twice from the same state,
    and once more from that state at the end; then four more in a world whose camera is a step late, so that a plant that wraps
    `simulated_plant` must hand its state on. Raises LuxloopError with the likely cause and the remedy where a method is missing or fails,
    changes what it was given, or gives something else for the same state and exposure; where a state is no data; where its time does not go
    on; where a frame is of no exposure that was shown, comes twice or out of order, or has times that contradict each other; where an image
    is no tensor `[height, width]` of whole digital numbers within `camera.bits`; where a sample is of no sensor that there is, or has other
    values than that; and where no frame comes at all.
    """
    check_in(worlds(device), plant, options or {})


def check_in(worlds: tuple[Simulation, Simulation], plant: type, options: Mapping[str, Any]) -> None:
    """Raises LuxloopError as `check_plant`, of a plant in worlds that others can share."""
    name = name_of(plant)
    check_methods(plant, f"{KEY}: {name}", METHODS)
    for simulation, exposures in zip(worlds, (EXPOSURES, UNDER_WAY), strict=True):
        _check_shown(plant, name, options, simulation, exposures)


def _check_shown(plant: type, name: Name, options: Mapping[str, Any], simulation: Simulation, exposures: int) -> None:
    """Raises LuxloopError as `check_plant`, of one in a world and so many exposures."""
    own = construct(plant, name, KEY, {"scenario": simulation.scenario, "modules": lamp_modules(simulation.modules)}, options)
    check_calls(own, CALLS)
    _check_truth(own)
    shown: list[Shown] = []
    state, arrivals = _said(own, "start", {}, shown, simulation)
    for number in range(exposures):
        light = (
            simulation.symbol.projector.light(simulation.symbol.projector.target)
            if number % 2 == 0
            else simulation.symbol.projector.resting
        )
        exposure = Exposure(number, arrivals.time_s, simulation.scenario.shares[number % 2] / simulation.scenario.rate_hz, light)
        before = state
        state, arrivals = _said(own, "show", {"state": before, "exposure": exposure}, shown, simulation)
        shown.append(Shown(before, exposure, arrivals, copied((state, arrivals), GIVES)))
    if exposures == EXPOSURES and not any(each.arrivals.frames for each in shown):
        raise LuxloopError(
            f"{KEY}: {name}: no frame of {exposures} exposures has arrived or been reported lost; give frames in Arrivals.frames"
        )
    for each in shown:
        if differs := difference(each.gave, own.show(each.state, each.exposure), GIVES):
            raise LuxloopError(
                f"{KEY}: {name}: show gives another {differs} when an earlier state is shown its exposure again after others; keep what it "
                "remembers in the state and not in self, and make new tensors in place of writing into old ones"
            )


def worlds(device: str) -> tuple[Simulation, Simulation]:
    """One whose camera is in time, and one whose camera is a step late."""
    in_time = prepare(validate(SCENARIO, SCENARIO["name"]), device)
    late = validate(SCENARIO | {"camera": SCENARIO["camera"] | {"latency_steps": 1}}, SCENARIO["name"])
    return in_time, Simulation.prepare(late, in_time.device, in_time)


@dataclass(frozen=True)
class Shown:
    """An exposure, the state before it, and what came: arrivals, and the parts of all that the plant gave."""

    state: Any
    exposure: Exposure
    arrivals: Arrivals
    gave: Parts


def _check_truth(own: Guard) -> None:
    truth = getattr(own, "truth", None)
    if truth is not None and not isinstance(truth, World):
        raise LuxloopError(
            f"{own.key}: {own.name}: truth is of the type {type(truth).__name__}; give the truth of a simulated_plant, or leave it out"
        )


def _said(own: Guard, method: str, inputs: Mapping[str, Any], shown: Sequence[Shown], simulation: Simulation) -> tuple[Any, Arrivals]:
    """State and arrivals of a call after what was shown. Raises LuxloopError where these cannot be."""
    gave = pure(own, method, inputs, GIVES)
    where = f"{own.key}: {own.name}: {method}"
    with locate(where):
        state, arrivals = pair(gave)
    check_state(own, method, state)
    with locate(where):
        check_time(arrivals, inputs.get("exposure"))
        check_frames(arrivals)
        starts_s = [each.exposure.start_s for each in shown] + [each.start_s for each in inputs.values() if isinstance(each, Exposure)]
        came = [frame for each in shown for frame in each.arrivals.frames]
        for frame in arrivals.frames:
            _check_number(frame, len(starts_s), came)
            with locate(f"frame {frame.number}"):
                start_s, end_s = (*starts_s, arrivals.time_s)[frame.number : frame.number + 2]
                _check_times(frame, start_s, end_s, arrivals.time_s, came)
                _check_image(frame.image, simulation)
            came.append(frame)
        check_samples(arrivals, simulation.symbol.projector.target)
        check_objects(arrivals)
    return state, arrivals


def _check_number(frame: Frame, exposures: int, came: Sequence[Frame]) -> None:
    """exposures: how many were shown, numbered from 0."""
    if not 0 <= frame.number < exposures:
        raise LuxloopError(f"gives a frame of exposure {frame.number!r}, which was not shown; number it as its exposure, exposure.number")
    if frame.number in [each.number for each in came]:
        raise LuxloopError(f"gives the frame of exposure {frame.number} twice; give each once, and take it out of the state then")
    if came and frame.number < came[-1].number:
        raise LuxloopError(
            f"gives the frame of exposure {frame.number} after that of exposure {came[-1].number}; give them in the order of their "
            "exposures, a later one not before all earlier ones have come or are lost"
        )


def _check_times(frame: Frame, start_s: float, end_s: float, now_s: float, came: Sequence[Frame]) -> None:
    """start_s, end_s: of its exposure. now_s: the plant's time."""
    if frame.image is None and (math.isnan(frame.taken_s) or math.isnan(frame.arrived_s)):
        return
    if not start_s - ROUNDING_S <= frame.taken_s <= end_s + ROUNDING_S:
        raise LuxloopError(
            f"was taken at {frame.taken_s:g} s, but its exposure lasted from {start_s:g} to {end_s:g} s; give the plant's time in s"
        )
    last_s = max((each.arrived_s for each in came if not math.isnan(each.arrived_s)), default=-math.inf)
    if not max(frame.taken_s, last_s) <= frame.arrived_s + ROUNDING_S:
        than = f"it was taken at {frame.taken_s:g} s" if frame.taken_s > last_s else f"the frame that came before it at {last_s:g} s"
        raise LuxloopError(f"arrived at {frame.arrived_s:g} s, before {than}; give the plant's time in s, which never runs backwards")
    if frame.arrived_s > now_s + ROUNDING_S:
        raise LuxloopError(f"arrived at {frame.arrived_s:g} s, after time_s = {now_s:g}; give times in s, and a frame when it has come")


def _check_image(image: Tensor | None, simulation: Simulation) -> None:
    if image is None:
        return
    camera = simulation.scenario.camera
    check_image(image, camera, simulation.symbol.projector.target)
    if not image.equal(image.round()):
        most, shares = 2**camera.bits - 1, float(image.max()) <= 1
        what = "it seems to hold shares: multiply it by" if shares else "it may hold a luminance: give digital numbers of 0 to"
        raise LuxloopError(f"has an image whose values are no whole numbers; {what} {most}, and round it")
