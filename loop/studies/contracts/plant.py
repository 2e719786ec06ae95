"""Contract of a user's own plant."""

from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from luxloop.loop.simulation.build import KEY
from luxloop.loop.simulation.clock import check_arrivals, check_frame
from luxloop.loop.simulation.lamps import lamp_modules
from luxloop.loop.simulation.protocol import Arrivals, Exposure
from luxloop.loop.simulation.simulation import Simulation
from luxloop.loop.simulation.world import World
from luxloop.loop.studies.contracts.values import Parts, build_part, check_state, copy_parts, difference, pure, world
from luxloop.world.errors import LuxloopError, locate
from luxloop.world.plugin import Guard, construct

CALLS = {"start": (), "show": ("state", "exposure")}
GIVES = "(state, arrivals)"
EXPOSURES = 24  # more than those of 10 steps, the largest latency of a scenario's camera
UNDER_WAY = 4  # more than those of a step of latency, so that frames pass through the state
SCENARIO = """
name = "check_plant"
camera = { width_px = 320, height_px = 180, oversampling = 1 }
headlight = { model = "ssl-hd-lores", lamps = ["left"] }
renderer = "raycast"
functions.symbol = { kind = "symbol", image = "snowflake", controller = "open" }
"""


def check_plant(plant: type, options: Mapping[str, Any] | None = None, device: str = "auto") -> None:
    """Check your own plant against the contract of `[plant]`, in a few seconds.

    plant: the class, from which a scenario makes `plant(scenario, modules, **options)`. options: those of `[plant]`. device: "auto", "cpu"
    or "cuda".

    The check shows 24 exposures of 1/60 s, alternately with and without a symbol, to a camera of 320 x 180 px: each twice from the same
    state, and once more from that state at the end; then four more in a world whose camera is a step late, so that a plant that wraps
    `simulated_plant` must pass its state on. Raises LuxloopError with likely cause and remedy if a method is missing, fails, changes its
    arguments, or gives different results for the same state and exposure; if a state is no data; if time does not advance; if a frame
    belongs to no exposure, comes twice or out of order, or has contradictory times; if an image is no tensor `[height, width]` of whole
    digital numbers within `camera.bits`; if a sample has an unknown sensor, or a wrong number of values; and if no frame arrives.
    """
    for late, exposures in enumerate((EXPOSURES, UNDER_WAY)):
        simulation = world(SCENARIO, device, f"camera.latency_steps={late}")
        given = {"scenario": simulation.scenario, "modules": lamp_modules(simulation.modules)}
        own = build_part(plant, KEY, CALLS, lambda name, given=given: construct(plant, name, KEY, given, options or {}))  # type: ignore[misc]
        if (truth := getattr(own, "truth", None)) is not None and not isinstance(truth, World):
            raise LuxloopError(
                f"{KEY}: {own.name}: truth is of the type {type(truth).__name__}; give the truth of a simulated_plant, or leave it out"
            )
        _check_shows(own, simulation, exposures)


def _check_shows(own: Guard, simulation: Simulation, exposures: int) -> None:
    """Check a plant in one world with a number of exposures. Raises LuxloopError as `check_plant`."""
    projector, scenario, shown = simulation.symbol.projector, simulation.scenario, list[Show]()
    state, arrivals = _give(own, "start", {}, shown, simulation)
    for number in range(exposures):
        light = projector.light(projector.target) if number % 2 == 0 else projector.resting
        exposure = Exposure(number, arrivals.time_s, scenario.shares[number % 2] / scenario.rate_hz, light)
        before = state
        state, arrivals = _give(own, "show", {"state": before, "exposure": exposure}, shown, simulation)
        shown.append((exposure, before, arrivals, copy_parts((state, arrivals), GIVES)))
    where = f"{KEY}: {own.name}:"
    if exposures == EXPOSURES and not any(came.frames for _, _, came, _ in shown):
        raise LuxloopError(f"{where} no frame of {exposures} exposures has arrived or been reported lost; give frames in Arrivals.frames")
    for exposure, before, _, result in shown:
        if differs := difference(result, own.show(before, exposure), GIVES):
            raise LuxloopError(
                f"{where} show gives another {differs} when an earlier state is shown its exposure again after others; keep what it "
                "remembers in the state and not in self, and make new tensors in place of writing into old ones"
            )


# an exposure, the state before it, the arrivals, and a copy of everything the plant returned
Show = tuple[Exposure, Any, Arrivals, Parts]


def _give(own: Guard, method: str, inputs: Mapping[str, Any], shown: Sequence[Show], simulation: Simulation) -> tuple[Any, Arrivals]:
    """Checked state and arrivals of a call. shown: earlier exposures. Raises LuxloopError if they are impossible."""
    camera, like, exposure = simulation.scenario.camera, simulation.symbol.projector.target, inputs.get("exposure")
    gave = pure(own, method, inputs, GIVES)
    with locate(f"{own.key}: {own.name}: {method}"):
        state, arrivals = check_arrivals(gave, exposure, like)
        starts_s = [each.start_s for each, *_ in shown] + ([] if exposure is None else [exposure.start_s])
        came = [frame.number for _, _, earlier, _ in shown for frame in earlier.frames]
        for frame in arrivals.frames:
            _check_number(frame.number, len(starts_s), came)
            start_s, end_s = (*starts_s, arrivals.time_s)[frame.number : frame.number + 2]
            check_frame(frame, (start_s, end_s), arrivals.time_s, camera, like)
            _check_numbers(frame.image, 2**camera.bits - 1)
            came.append(frame.number)
    check_state(own, method, state)
    return state, arrivals


def _check_number(number: int, exposures: int, came: Sequence[int]) -> None:
    """Check the number of a frame. exposures: number of exposures so far. came: numbers of earlier frames."""
    if not 0 <= number < exposures:
        raise LuxloopError(f"gives a frame of exposure {number!r}, which was not shown; number it as its exposure, exposure.number")
    if number in came:
        raise LuxloopError(f"gives the frame of exposure {number} twice; give each once, and take it out of the state then")
    if came and number < came[-1]:
        raise LuxloopError(
            f"gives the frame of exposure {number} after that of exposure {came[-1]}; give them in the order of their "
            "exposures, a later one not before all earlier ones have come or are lost"
        )


def _check_numbers(image: Tensor | None, most: int) -> None:
    if image is not None and not image.equal(image.round()):
        shares = float(image.max()) <= 1
        what = "it seems to hold shares: multiply it by" if shares else "it may hold a luminance: give digital numbers of 0 to"
        raise LuxloopError(f"has an image whose values are no whole numbers; {what} {most}, and round it")
