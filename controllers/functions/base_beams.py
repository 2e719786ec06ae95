"""The base beam: one of the lamp's beams, chosen by name or situation, bent into curves and levelled (T 3.4)."""

import math
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from luxloop.controllers.pixels.morphing import Morph, turn
from luxloop.controllers.situation import Situation
from luxloop.world.params import Params

BeamName = Literal["low", "high", "town", "motorway", "adverse", "full", "off"]
AUTOMATIC: tuple[BeamName, ...] = ("low", "town", "motorway", "adverse")  # what `chosen` chooses from

TOWN_BELOW_M_S = 50 / 3.6  # our choice, close to the limits of class V (town) and class E (motorway) in UN R149
MOTORWAY_ABOVE_M_S = 110 / 3.6


@dataclass(frozen=True)
class BaseBeam:
    """A beam by name and its morphing in rad: bend to the left, level nose down, roll right side down. share: factor on the beam, 0..1."""

    name: str
    bend: float = 0.0
    level: float = 0.0
    roll: float = 0.0
    share: float = 1.0

    @property
    def morph(self) -> Morph:
        return turn(self.roll, self.level, self.bend)


class BaseBeamParams(Params):
    """The light on which all functions are drawn."""

    beam: Literal[BeamName, "auto"] = Field("off", description="beam of the lamps; `auto` chooses by speed, wetness and street lighting")
    bend_deg: float = Field(0.0, ge=-20, le=20, description="digital turn to the left")
    level_deg: float = Field(0.0, ge=-10, le=10, description="digital turn down")
    roll_deg: float = Field(0.0, ge=-20, le=20, description="digital roll, right side down")
    follow_course: bool = Field(False, description="also bend the beam into curves by the car's course")
    look_ahead_s: float = Field(2.0, gt=0, le=5, description="how far ahead the bent beam points, as travel time at the car's speed")
    largest_bend_deg: float = Field(10.0, gt=0, le=20, description="limit of the bend by the course")

    @property
    def names(self) -> tuple[BeamName, ...]:
        """The beams that may be chosen."""
        return AUTOMATIC if self.beam == "auto" else (self.beam,)

    def at(self, now: Situation) -> BaseBeam:
        bend = math.radians(self.bend_deg)
        if self.follow_course:
            bend += bend_of_course(now.curvature_1_m, self.look_ahead_s * now.speed_m_s)
        largest = math.radians(self.largest_bend_deg)
        name = chosen(now) if self.beam == "auto" else self.beam
        bend = min(max(bend, -largest), largest) if self.follow_course else bend
        return BaseBeam(name, bend, math.radians(self.level_deg), math.radians(self.roll_deg))


class RawParams(Params):
    """Given pixel utilisations that replace the base beam of some modules (T 4.1)."""

    file: str = Field(
        min_length=1,
        examples=["./frames/*.png"],
        description="name of a shipped sequence, or path of an array (.npy, .npz, .csv) or grey picture (.png), a value a pixel of the "
        "modules, of a folder or pattern (./frames/*.png) of these, or of a video",
    )
    modules: tuple[str, ...] = Field((), description="lamps or modules that show them; left out: all")
    rate_hz: float | None = Field(None, gt=0, le=1000, description="frames per second; left out: the video's own rate, else 25")
    repeat: bool = Field(True, description="start again at the end; otherwise the last frame stays")


def chosen(now: Situation) -> BeamName:
    """The AFS beam for a situation (T 3.4): adverse weather first, then town, then motorway, else the low beam."""
    if now.wet:
        return "adverse"
    if now.street_lit or now.speed_m_s < TOWN_BELOW_M_S:
        return "town"
    return "motorway" if now.speed_m_s > MOTORWAY_ABOVE_M_S else "low"


def bend_of_course(curvature_1_m: float, distance_m: float) -> float:
    """Angle in rad to the left of the point on the car's circular course at a distance: half the angle of the arc."""
    return math.asin(min(max(curvature_1_m * distance_m / 2, -1.0), 1.0))
