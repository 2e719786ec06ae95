"""What the acts of a step hand on: plan, drive, exposures, perception, control."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from controllers.functions.planner import Plan, States
from controllers.pixels.primitives import Primitives
from controllers.pixels.ssc import Utilisation
from controllers.situation import Situation
from controllers.symbol.sensing.projection import ProjectionCommand
from controllers.symbol.sensing.symbol_sensor import Measurement
from loop.lighting.controlled import Frames, HeldState, Moment
from loop.lighting.lamps import LampPower
from loop.plant.pairing import UnderWay
from loop.plant.protocol import Arrivals, Frame, Showing
from perception.detection.protocol import Detections
from perception.egomotion import Ego, Samples
from world.view import View

Lights = tuple[Utilisation, ...]  # of all modules
Parts = Mapping[str, Sequence[Primitives]]  # that functions draw, by name
Projections = Mapping[str, ProjectionCommand]  # of the symbols that are shown, by name


@dataclass(frozen=True, eq=False)
class StepPlan:
    """What is to be lit. ego, now: motion and situation. projections: by symbol. drawn: primitives by function.

    measured: names of the symbols that are off in all exposures but the first. plans: with all symbols, and without the measured ones.
    """

    ego: Ego | None
    now: Situation
    projections: Projections
    drawn: Parts
    measured: tuple[str, ...]
    plans: tuple[Plan, ...]


@dataclass(frozen=True, eq=False)
class StepDrive:
    """exposures: utilisations of each. projections: symbols that each shows. powers: of each plan, by the lamps' sides."""

    exposures: tuple[Lights, ...]
    projections: tuple[Projections, ...]
    powers: tuple[Mapping[str, LampPower], ...]


@dataclass(frozen=True, eq=False)
class Reception:
    """What the plant gave for the exposures of a step. plant: its state. samples: the newest of each sensor.

    frames: all that wait for their partner, of which `new` came in this step.
    """

    plant: Any
    arrivals: Arrivals
    samples: Samples
    frames: tuple[Frame, ...]
    new: tuple[Frame, ...]
    showings: tuple[Showing, ...]


@dataclass(frozen=True, eq=False)
class Perception:
    """What detector, tracker and learning functions know. view: of the camera from the ground frame, as the car believes.

    found, image: of the newest frame, None where none came; taken_s: its time, else that of the step. believed: views of the exposures
    whose frames have not come yet, by their number.
    """

    view: View
    tracks: Any
    functions: States
    found: Detections | None
    image: Tensor | None
    taken_s: float
    believed: Mapping[int, View]


@dataclass(frozen=True, eq=False)
class Control:
    """held: states of the controllers. measurements: of the symbols whose frames came. under_way, unpaired: exposures and frames that wait.

    frames: the newest on and off frame, taken at taken_s, None and NaN where none came.
    """

    held: Mapping[str, HeldState]
    measurements: Mapping[str, Measurement]
    under_way: UnderWay[Moment]
    unpaired: tuple[Frame, ...]
    frames: Frames | None
    taken_s: float


def without(drawn: Parts, names: Collection[str]) -> dict[str, Sequence[Primitives]]:
    """What the other functions draw."""
    return {name: each for name, each in drawn.items() if name not in names}
