"""Scenario files: a typed, frozen model, which TOML, `--set key=value` and all other front ends edit."""

import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator
from torch import Tensor

from luxloop.controllers.functions.planner import Functions, LightingParams
from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.pixels.jpo import JpoParams
from luxloop.controllers.pixels.pixel_major import MrpcParams
from luxloop.loop.scenario.checks import Baseline, CheckParams
from luxloop.loop.scenario.disturbances import DisturbanceParams
from luxloop.loop.scenario.overrides import Override, is_file, overridden, resolve_paths, tables, texts
from luxloop.loop.scenario.plant import ModuleSourceParams, PlantParams, SimulatedPlantParams
from luxloop.loop.scenario.probes import ProbeParams
from luxloop.loop.scenario.shipped import find
from luxloop.perception.camera import CameraParams
from luxloop.perception.detection.detector import DetectorParams
from luxloop.perception.pixel_gains import PixelGainParams
from luxloop.perception.sensors import SensorParams
from luxloop.perception.trackers import AnyTracker
from luxloop.perception.tracking import TrackerParams
from luxloop.world.errors import LuxloopError, did_you_mean, locate
from luxloop.world.materials.library import RoadSurfaceParams, SpotParams
from luxloop.world.params import Degrees, Metres, NotNegative, Params, PlainName, Seed, ascending
from luxloop.world.plugin import PATTERN, Name, colon_remedy, refuse_code
from luxloop.world.regulation import beam_rules
from luxloop.world.roads.shapes import Flat, RoadParams
from luxloop.world.scene.air import AirParams
from luxloop.world.scene.scene import StreetLamp, SunParams
from luxloop.world.scene.vehicle import VehicleParams
from luxloop.world.traffic.generator import TrafficParams
from luxloop.world.traffic.objects import ObjectParams
from luxloop.world.validation import read_toml, validate_model

SCHEMA_VERSION: Final = 1
PIXEL_CONTROLLERS = ("ssc", "jpo")
OTHER_SEED: Final = 2**62  # added to the seed for the other car


class HeadlightParams(Params):
    """The vehicle's pair of headlamps."""

    model: str = Field("ssl-hd", min_length=1, description="preset, or lamp file: .npz, .toml, .ies or .ldt")
    intensity_cd: float | None = Field(
        None, gt=0, le=500_000, description="peak of the brightest module with all pixels on; left out: the model's own"
    )
    height_m: float = Field(0.75, gt=0.1, le=2.0, description="height of the lamps' origins above the road")
    distance_m: float = Field(1.2, ge=0, le=3, description="distance between the lamps' origins")
    lamps: tuple[Literal["left", "right"], ...] = Field(("left", "right"), min_length=1, description="lamps that shine")
    modules: tuple[str, ...] | None = Field(None, min_length=1, description="modules that shine; left out: all")
    swivel_deg: float = Field(0.0, ge=-30, le=30, description="rest position of modules that swivel, to the left")
    level_deg: float = Field(
        0.0, ge=-10, le=10, description="rest position, down: of modules within their range of levelling, else of the lamp"
    )
    standby_w: NotNegative = Field(5.0, description="electrical power of a dark lamp: electronics and fan")
    efficacy_lm_w: float = Field(40.0, gt=0, le=1000, description="luminous flux of a lamp per electrical power of its cold light sources")
    thermal_k_w: float = Field(
        0.0, ge=0, le=100, description="electrical thermal resistance of a lamp from the light sources' junctions to the air, in K/W"
    )
    efficacy_loss_percent_k: float = Field(
        0.0, ge=0, le=5, description="loss of efficacy in % of efficacy_lm_w by each K of the junctions over the air; 0: none"
    )
    droop: float = Field(
        0.0, ge=0, le=5, description="by how much more efficient pixels dimmed by current get towards darkness; 0: dimmed by pulse width"
    )
    delay_s: float = Field(
        0.0,
        ge=0,
        le=0.5,
        description="delay of the light after the newest motion sample that it is drawn for: computation and transmission",
    )
    rate_hz: float | None = Field(
        None, gt=0, le=1000, description="rate at which the lamps draw anew, for the newest measured motion; left out: once a control step"
    )

    @field_validator("lamps", "modules")
    @classmethod
    def _each_once(cls, names: tuple[str, ...] | None, info: ValidationInfo) -> tuple[str, ...] | None:
        if names is not None and len(set(names)) < len(names):
            raise ValueError(f"name each of the {info.field_name} once")
        return names

    def at_full_current(self, u: Tensor) -> Tensor:
        """Utilisations at full current that take as much power as utilisations u, `[n_p]` both.

        The efficacy of pixels dimmed by current falls linearly with their flux, as of the white LEDs of data sheets, to some 5 %.
        """
        return u / (1 + self.droop * (1 - u)) if self.droop else u

    def power_w(self, flux_lm: float) -> float:
        """Electrical power of one lamp in W at a luminous flux at full current, with its junctions at their steady temperature.

        Efficacy falls linearly with that temperature: `flux = efficacy (1 - loss thermal P) P`, P of the light sources (Hui and Qin, "A
        General Photo-Electro-Thermal Theory for Light Emitting Diode (LED) Systems", 2009). Raises LuxloopError beyond the greatest flux.
        """
        cold_w, loss = flux_lm / self.efficacy_lm_w, self.efficacy_loss_percent_k / 100 * self.thermal_k_w  # W, 1/W
        if 4 * loss * cold_w > 1:
            raise LuxloopError(
                f"headlight.thermal_k_w: a lamp of {flux_lm:.0f} lm gets too hot to give more than {self.efficacy_lm_w / (4 * loss):.0f}"
                " lm; lower thermal_k_w or efficacy_loss_percent_k"
            )
        return self.standby_w + 2 * cold_w / (1 + math.sqrt(1 - 4 * loss * cold_w))


class LightParams(Params):
    """Light besides the headlamps'."""

    ambient_lx: float = Field(0.3, ge=0, le=100_000, description="illuminance of a surface facing the sky")
    street_lamps: tuple[StreetLamp, ...] = Field((), description="point lights")
    sun: SunParams | None = Field(None, description="a low sun; left out: none")
    interreflection: bool = Field(False, description="whether surfaces in the light of the lamps light the road and each other")


class VideoParams(Params):
    """The run's video."""

    view: Literal["camera", "driver", "chase", "above", "oncoming"] = Field(
        "camera",
        description="camera: the camera's frames with boxes and outlines, one a step; others: in colour what people see",
    )
    width_px: int = Field(1280, ge=64, le=3840, description="width of the colour views, which are 16 : 9")
    rate_hz: float = Field(30.0, ge=1, le=120, description="frames a second of the colour views, which play in real time")
    exposure_ev: float | None = Field(
        None,
        ge=-20,
        le=20,
        description="exposure of the colour views: 1.2 cd/m^2 * 2^EV is shown at half of white; left out: 2 % of the first frame exceed it",
    )
    age_years: float = Field(40.0, ge=1, le=120, description="age of the observer, for disability glare in the colour views")


class RoadConditionParams(Params):
    """Rain and street lighting from one time on, for lighting functions."""

    time_s: NotNegative = Field(0.0, description="start of these conditions, which hold until the next entry")
    wet: bool = Field(False, description="whether it rains")
    street_lit: bool = Field(False, description="whether street lamps light the road")


class OtherCarParams(Params):
    """A second car, with the same lamps, camera and functions, which stands in the same night and draws other lots."""

    x_m: Metres = Field(30.0, description="position of its lamps' middle ahead of the car")
    y_m: Metres = Field(0.0, description="position of that to the left")
    yaw_deg: Degrees = Field(180.0, description="its heading, to the left of the car's: 180 faces the car")
    functions: Functions | None = Field(None, description="its lighting functions, by name; left out: those of the car")


class Scenario(Params):
    """Everything that decides a run."""

    schema_version: Literal[1] = Field(SCHEMA_VERSION, description="version of this file format")
    name: str = Field(min_length=1, max_length=80, examples=["mine"], description="name, for tables and reports")
    description: str = Field("", description="what the scenario shows, in a sentence")
    steps: int = Field(40, ge=1, le=100_000, description="control steps")
    rate_hz: float = Field(30.0, ge=0.1, le=1000, description="control rate")
    seed: Seed = Field(0, description="seed of all noise")
    road: RoadParams = Field(Flat(), description="the road's shape")
    surface: RoadSurfaceParams = Field(RoadSurfaceParams(), description="the road's albedo")
    spots: tuple[SpotParams, ...] = Field((), description="spots on the road, unknown to the controller")
    objects: tuple[ObjectParams, ...] = Field((), description="objects on the road")
    traffic: TrafficParams | None = Field(None, description="further objects, drawn from a seed; left out: none")
    light: LightParams = Field(LightParams(), description="ambient light and street lamps")
    air: Annotated[tuple[AirParams, ...], ascending("time_s")] = Field(
        (), description="fog, rain and snow, in ascending time; left out: clear air"
    )
    headlight: HeadlightParams = Field(HeadlightParams(), description="the lamps")
    modules: Mapping[str, ModuleSourceParams] = Field({}, description="sources of modules' light, by module")
    camera: CameraParams = Field(CameraParams(), description="the camera")
    pixel_controller: str = Field("ssc", description="pixel controller: ssc, jpo, or your own as package.module:Name")
    ssc: MrpcParams = Field(MrpcParams(), description="SuperSampling Control, also the start of joint pixel optimisation")
    jpo: JpoParams = Field(JpoParams(), description='joint pixel optimisation, with pixel_controller = "jpo"')
    renderer: Literal["auto", "opengl", "raycast"] = Field("auto", description="source of the G-buffer")
    checks: Mapping[PlainName, CheckParams] = Field({}, description="bounds on columns of the recording, by name")
    disturbances: DisturbanceParams = Field(DisturbanceParams(), description="disturbances unknown to the controller")
    vehicle: VehicleParams | None = Field(None, description="the vehicle's motion; left out: it stands")
    other_car: OtherCarParams | None = Field(None, description="a second car, whose light is in the frames; left out: none")
    sensors: SensorParams = Field(SensorParams(), description="sensors of the vehicle's motion")
    plant: Annotated[PlantParams, Field(description="shows the light and exposes the frames")] = SimulatedPlantParams()
    judge_every: int = Field(1, ge=0, le=100_000, description="steps from one evaluation of a symbol under control to the next; 0: none")
    judge_causes: bool = Field(
        False,
        description="in steps of judge_every, draw held symbols anew, in open loop, for the body's true pose, the true road, and both; "
        "and say why heads are dazzled, objects have no track, and tracks show no object",
    )
    judge_projections: bool = Field(
        False,
        description="evaluate symbols on the road as the driver sees them, in steps of judge_every: place, intensity, contrast, strokes",
    )
    off_share: float = Field(0.5, gt=0, lt=1, description="share of a control step for which symbols under control are off")
    conditions: Annotated[tuple[RoadConditionParams, ...], ascending("time_s")] = Field(
        (RoadConditionParams(),), min_length=1, description="rain and street lighting, in ascending time"
    )
    pixel_gains: PixelGainParams | None = Field(
        None, description="estimates while driving what each pixel still gives, and lets others take over; left out: not at all"
    )
    lighting: LightingParams = Field(LightingParams(), description="base beam, and limits of all lighting functions")
    functions: Functions = Field({}, description="lighting functions, by name")
    detector: DetectorParams | None = Field(
        None, description="finds objects in the camera's frames; left out: lighting functions get the true positions of all objects"
    )
    detector_frames: Literal["on", "off", "both"] = Field(
        "on", description="with symbols under control: frames for the detector, with the measured symbols, without them, or both"
    )
    detector_every: int = Field(
        1, ge=1, le=100_000, description="steps from one detection to the next: the tracker predicts between them, functions learn at them"
    )
    tracker: AnyTracker = Field(TrackerParams(), description="follows detections from frame to frame")
    probes: Mapping[PlainName, ProbeParams] = Field({}, description="luxmeters for the light of the own lamps, by name")
    video: VideoParams = Field(VideoParams(), description="the run's video")

    @field_validator("pixel_controller")
    @classmethod
    def _known_or_own(cls, name: str) -> str:
        if name not in PIXEL_CONTROLLERS and not re.fullmatch(PATTERN, name):
            remedy = colon_remedy(name) or f"{did_you_mean(name, PIXEL_CONTROLLERS)} Give your own as package.module:Name"
            raise ValueError(f"there is no pixel controller {name!r}; {remedy}")
        return name if name in PIXEL_CONTROLLERS else Name(name)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for sentence in chain.from_iterable(
            topic(self) for topic in (_lamps, _modules, _exposures, _gains, _projections, _observers, _detection, _probes, _names, _meeting)
        ):
            raise ValueError(sentence)
        return self

    @property
    def all_objects(self) -> tuple[ObjectParams, ...]:
        """The objects of the scenario and of its traffic."""
        if self.traffic is None:
            return self.objects
        return self.objects + (self.traffic.along(self.vehicle, self.steps / self.rate_hz) if self.vehicle else self.traffic.objects())

    @property
    def of_other_car(self) -> Self:
        """The scenario of the other car, alone."""
        other = self.other_car
        functions = self.functions if other is None or other.functions is None else other.functions
        return self.model_copy(update={"other_car": None, "functions": functions, "seed": (self.seed + OTHER_SEED) % 2**63})

    def conditions_at(self, time_s: float) -> RoadConditionParams:
        """Conditions at a time; before their start the first ones."""
        return [self.conditions[0], *(each for each in self.conditions if each.time_s <= time_s)][-1]

    @cached_property
    def source(self) -> str:
        """Path and overrides of the scenario, for messages; its name if made in Python."""
        return self.name

    @property
    def digest(self) -> str:
        """SHA-256 of the resolved scenario, hexadecimal."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()

    @property
    def meters_light(self) -> bool:
        """Whether illuminances of surfaces are needed, for objects or functions, in addition to the camera's image."""
        lit = any(each.category for each in self.all_objects) or self.digitised_module is not None
        return lit or self.detector is not None or len(self.functions) > len(self.symbols)

    @property
    def digitised_module(self) -> str | None:
        """Name of the module whose light is digitised, None where all are simulated."""
        return next((name for name, each in self.modules.items() if each.source == "digitised"), None)

    @property
    def symbols(self) -> Mapping[str, SymbolFunctionParams]:
        """The symbols under control, by name."""
        functions = self.functions.items()
        return {name: each for name, each in functions if isinstance(each, SymbolFunctionParams) and each.controller is not None}

    @property
    def projections(self) -> Mapping[str, SymbolFunctionParams]:
        """The symbols on the road that `judge_projections` evaluates, by name: all but pictures for an observer."""
        functions = self.functions.items() if self.judge_projections else ()
        return {name: each for name, each in functions if isinstance(each, SymbolFunctionParams) and each.observer is None}

    @property
    def rules(self) -> tuple[str, ...]:
        """Rules of beams that checks name."""
        return tuple(rule for rule in beam_rules() if any(check.metric == f"rules.{rule}" for check in self.checks.values()))

    @property
    def symbol(self) -> SymbolFunctionParams:
        """The only symbol under control. Raises LuxloopError where there are several or none."""
        return self.symbols[only(self.symbols)]

    @property
    def frame_shares(self) -> tuple[float, ...]:
        """Shares of a control step, one a frame: with symbols under control and without them, halves for pixel gains, or the whole."""
        if self.symbols:
            return 1 - self.off_share, self.off_share
        return (1.0,) if self.pixel_gains is None else (0.5, 0.5)

    @property
    def drawings(self) -> tuple[int, ...]:
        """Number of exposures, one a frame; the first of each is in the frame, the others are drawn at `headlight.rate_hz`."""
        per_step = (self.headlight.rate_hz or 0.0) / self.rate_hz
        return tuple(max(math.ceil(round(share * per_step, 9)), 1) for share in self.frame_shares)

    @property
    def shares(self) -> tuple[float, ...]:
        """Shares of a control step, one an exposure."""
        return tuple(share / n for share, n in zip(self.frame_shares, self.drawings, strict=True) for _ in range(n))

    @property
    def lights(self) -> tuple[Baseline, ...]:
        """Baselines that checks may compare with."""
        return ("full_light", "low_beam", *(("open_loop",) if self.symbols else ()))


def _lamps(scenario: Scenario) -> Iterator[str]:
    """Contradictions between pixel controllers, lamps and the lights that checks compare with."""
    if scenario.pixel_controller != "jpo" and scenario.jpo != JpoParams():
        yield f'jpo: is for pixel_controller = "jpo", which is {scenario.pixel_controller!r} here; set that, or leave it out'
    for k, aim in enumerate(scenario.disturbances.aim):
        if aim.lamp is not None and aim.lamp not in scenario.headlight.lamps:
            yield f"disturbances.aim[{k}].lamp: the {aim.lamp} lamp is dark here; name it in headlight.lamps as well"
    for name, check in scenario.checks.items():
        if check.compare is not None and check.compare not in scenario.lights:
            lacking = "controller of a symbol" if check.compare == "open_loop" else "lighting function"
            yield (
                f"checks.{name}.compare: {check.compare} takes every {lacking} away, but there is none here; "
                f"give {' or '.join(scenario.lights)}, or leave compare out"
            )


def _modules(scenario: Scenario) -> Iterator[str]:
    """Contradictions between the sources of modules' light: at most one beam is digitised."""
    for name, each in scenario.modules.items():
        if each.source == "digitised" and name != (first := scenario.digitised_module):
            yield f"modules.{name}.source: {first} is digitised, too, and a camera cannot tell two beams apart; simulate one"
        if each.source == "simulated" and each != ModuleSourceParams():
            yield f'modules.{name}: latency_s and delay_body are for source = "digitised"; set that, or leave them out'
        if each.delay_body and scenario.vehicle is None:
            yield f"modules.{name}.delay_body: the vehicle stands, there is no [vehicle]; leave it out"


def _exposures(scenario: Scenario) -> Iterator[str]:
    """Contradictions between exposures and the control period, which has an on and an off frame with symbols under control, else an on
    frame.
    """
    exposure_s, light_hz = scenario.camera.exposure_s, scenario.headlight.rate_hz
    if light_hz is not None and sum(scenario.drawings) == len(scenario.frame_shares):
        least_hz = scenario.rate_hz / max(scenario.frame_shares)
        yield f"headlight.rate_hz: the lamps draw anew for each frame, at {least_hz:g} Hz; give more, or leave it out"
    elif light_hz is not None and exposure_s > 1 / light_hz:
        yield (
            f"camera.exposure_s: the lamps draw anew at {light_hz:g} Hz, during an exposure of {exposure_s:g} s; "
            f"give at most {1 / light_hz:.4g} s, or lower headlight.rate_hz"
        )
    if scenario.symbols or scenario.pixel_gains:
        share, rate_hz = min(scenario.frame_shares), scenario.rate_hz
        if exposure_s > share / rate_hz:
            part, nearer = ("half", "") if scenario.off_share == 0.5 else (f"{share:.3g} of", ", or set off_share nearer to 0.5")
            yield (
                f"camera.exposure_s: {exposure_s:g} s is longer than {part} a control period, "
                f"but an on and an off frame must fit into one; give at most {share / rate_hz:.4g} s or lower rate_hz{nearer}"
            )
    if scenario.symbols:
        return
    if scenario.off_share != 0.5:
        yield "off_share: no controller holds a symbol here; leave it out"
    for key in ("oncoming", "ambient") if scenario.pixel_gains is None else ():
        for k, each in enumerate(getattr(scenario.disturbances, key)):
            if each.frames == "off":
                yield f"disturbances.{key}[{k}].frames: without a held symbol, steps have no off frame; leave it out"


def _gains(scenario: Scenario) -> Iterator[str]:
    """Contradictions between pixel gains and what else alternates within a step."""
    if scenario.pixel_gains is None:
        return
    for name in scenario.symbols:
        yield f"functions.{name}.controller: measures a symbol by frames with and without it, which pixel_gains needs; leave one out"
    if scenario.lighting.power_limit is not None:
        yield "lighting.power_limit: limits the planned light, which pixel_gains raises; leave one out"
    if scenario.headlight.rate_hz is not None:
        yield "headlight.rate_hz: the lamps draw anew within a frame, but pixel_gains needs one light a frame; leave one out"


def _projections(scenario: Scenario) -> Iterator[str]:
    """An evaluation of symbols on the road without symbols or steps."""
    if scenario.judge_projections and not scenario.projections:
        yield "judge_projections: there is no symbol on the road here, so it has no effect; leave it out"
    if scenario.judge_causes and not scenario.symbols and scenario.detector is None:
        yield "judge_causes: there is no symbol with a controller and no detector here, so it has no effect; leave it out"
    for key in ("judge_causes", "judge_projections"):
        if getattr(scenario, key) and not scenario.judge_every:
            yield f"{key}: judge_every = 0 evaluates no step; set it to 1 or more, or leave {key} out"


def _observers(scenario: Scenario) -> Iterator[str]:
    """Moving observers of symbols under control."""
    for name, symbol in scenario.symbols.items():
        who = None if symbol.observer is None else symbol.observer.name
        moving = {each.name: each.path is not None or len(each.track) > 1 for each in scenario.all_objects}
        if who is not None and (scenario.vehicle is not None or moving.get(who)):
            what = "the car drives" if scenario.vehicle is not None else f"{who!r} moves"
            yield (
                f"functions.{name}.observer.name: {what}, but a controller draws for an eye that stays in its place beside the car; "
                "give eye_m, or leave out the controller"
            )


def _detection(scenario: Scenario) -> Iterator[str]:
    """Contradictions between detector, tracker and the objects that functions name."""
    if scenario.detector_frames != "on" and not (scenario.symbols and scenario.detector):
        lacking = "detector" if scenario.symbols else "symbol that a controller holds"
        yield f"detector_frames: there is no {lacking} here, so it has no effect; leave it out"
    if scenario.detector is None:
        if scenario.detector_every != 1:
            yield "detector_every: there is no detector here, so it has no effect; leave it out"
        if scenario.tracker != TrackerParams():
            yield 'tracker: follows what a detector finds, but there is none; give one, detector = {kind = "network"} say'
        return
    if keys := {f"functions.{name}.{key}": name for name, each in scenario.functions.items() for key, _ in object_names(each)}:
        emptied = " ".join(f"{key}=[]" for key in keys if key.endswith("names"))
        remedies = [*([f"--set {emptied}"] if emptied else []), *(f"leave {key} out" for key in keys if not key.endswith("names"))]
        yield (
            f"functions.{next(iter(keys.values()))}: names objects, but a detector knows only their class; "
            f"{' and '.join(remedies)}, or take the [detector] out"
        )


def _probes(scenario: "Scenario") -> Iterator[str]:
    """Frames of probes that nothing has."""
    objects = [each.name for each in scenario.all_objects]
    frames = ["world", "car", *objects]
    for name, probe in scenario.probes.items():
        if probe.frame in ("world", "car") and probe.frame in objects:
            yield f"probes.{name}.frame: {probe.frame!r} is also the name of an object; give the object another name"
        if probe.frame not in frames:
            yield f"probes.{name}.frame: there is no object {probe.frame!r}; {did_you_mean(probe.frame, frames)}"


def _names(scenario: Scenario) -> Iterator[str]:
    """Duplicate names."""
    names = [each.name for each in scenario.all_objects]
    if doubled := [name for name in names if names.count(name) > 1]:
        yield f"objects: the name {doubled[0]!r} occurs twice, but recordings identify objects by name; rename one"


def _meeting(scenario: Scenario) -> Iterator[str]:
    """What a meeting of two cars excludes."""
    if scenario.other_car is None:
        return
    if scenario.vehicle is not None or not isinstance(scenario.plant, SimulatedPlantParams) or scenario.digitised_module is not None:
        yield "other_car: both cars stand, in the simulated world; leave vehicle, plant and digitised modules out"
    if len(scenario.shares) > 1 or len(scenario.of_other_car.shares) > 1:
        yield "other_car: both cars expose once a step; leave headlight.rate_hz, pixel_gains and controllers of symbols out"


def object_names(function: Any) -> Iterator[tuple[str, str]]:
    """Names of objects in a function's parameters, each after its key."""
    for table in ("", "when.", "unless."):
        selection = getattr(function, table[:-1], None) if table else function
        yield from ((f"{table}names", name) for name in getattr(selection, "names", None) or ())
    if (observer := getattr(function, "observer", None)) is not None and observer.name is not None:
        yield "observer.name", observer.name


def only(held: Iterable[str]) -> str:
    """Name of the only symbol under control. Raises LuxloopError where there are several or none."""
    names = tuple(held)
    if len(names) != 1:
        raise LuxloopError(
            f"symbols that a controller holds: {', '.join(names) or 'none'}, where exactly one is needed; take another scenario, "
            f"or give one function of kind 'symbol' a controller"
        )
    return names[0]


EXAMPLES: Final = "`luxloop new FILE` writes a complete file, `luxloop new FILE --like NAME` copies one of `luxloop list`"


def load(name: str, overrides: Sequence[Override] = (), *, allow_code: bool = False, **values: Any) -> Scenario:
    """Read a scenario by shipped name or path.

    overrides: each `key.sub=value` or `list[0].sub=value` in TOML syntax, the path of a TOML file of such keys, or nested tables; they
    change single keys, also of tables with defaults. values: top-level keys, below the overrides; `controller` is that of the only symbol
    under control. allow_code: whether modules that files name may run; modules in values and other overrides always may. Raises
    LuxloopError that names the file, the key and the remedy.
    """
    path = find(name)
    data = read_toml(path)
    resolve_paths(data, path.parent)
    return load_data(data, path, overrides, values, allow_code=allow_code)


def load_data(data: dict[str, Any], path: Path, overrides: Sequence[Override], values: Mapping[str, Any], *, allow_code: bool) -> Scenario:
    """A scenario from plain data read at a path; other arguments and errors as of `load`."""
    keys = tables(values)
    if "controller" in keys:
        _only_symbol(data, path)["controller"] = keys.pop("controller")
    data.update(keys)
    if overrides:
        with suppress(LuxloopError):  # overrides may mend errors of the data
            data = validate(data, "").model_dump(mode="json")
        data = overridden(data, overrides)
    changes = [
        *(f"{key}={_name(value)}" for key, value in values.items()),
        *dict.fromkeys(override if isinstance(override, str) else "these changes" for override in overrides if override),
    ]
    scenario = validate(data, f"{path} with {' '.join(changes)}" if changes else str(path))
    if not allow_code:
        typed = texts([tables(each) for each in (values, *overrides) if not is_file(each)])
        refuse_code(scenario, scenario.source, typed={text for _, text in typed})
    return scenario


def _name(value: Any) -> Any:
    """Name or folder in a table, for messages; other values as they are."""
    return next((value[key] for key in ("name", "folder") if key in value), value) if isinstance(value, dict) else value


def validate(data: Mapping[str, Any], source: str) -> Scenario:
    """The scenario of plain data. Modules that the data name may run. source: of the data, for messages.

    Raises LuxloopError that names the source, the key and the remedy.
    """
    version = data.get("schema_version", SCHEMA_VERSION)
    if version != SCHEMA_VERSION:
        raise LuxloopError(
            f"{source}: schema_version: this luxloop reads version {SCHEMA_VERSION}, not {version!r}; get another luxloop for it"
        )
    with locate(source):
        if "symbol" in data:
            raise LuxloopError('symbol: unknown key; a symbol is a lighting function, write [functions.NAME] with kind = "symbol"')
        return validate_model(Scenario, _spelt_out(data), EXAMPLES).model_copy(update={"source": source})


def _spelt_out(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Plain data with a table for each controller that a function gives by name."""
    functions = data.get("functions")
    if not isinstance(functions, Mapping):
        return data

    def table(function: Any) -> Any:
        name = function.get("controller") if isinstance(function, Mapping) else None
        return {**function, "controller": {"name": name}} if isinstance(name, str) else function

    return {**data, "functions": {name: table(function) for name, function in functions.items()}}


def _only_symbol(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """Table of the only symbol under control. Raises LuxloopError where there are several or none."""
    functions = data.get("functions")
    items = functions.items() if isinstance(functions, dict) else ()
    held = {name: each for name, each in items if isinstance(each, dict) and "controller" in each}
    if len(held) == 1:
        return next(iter(held.values()))
    why = f"several symbols have one: {', '.join(held)}; set functions.NAME.controller" if held else "none of its functions has one"
    raise LuxloopError(f"{path}: controller: {why}")
