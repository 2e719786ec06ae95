"""Scenario files: a typed, frozen model for each of the two kinds; TOML, `--set key=value` and every other front end edit it alone."""

import difflib
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from controllers.functions.planner import Functions, LightingParams
from controllers.jpo.controller import JpoParams
from controllers.pixels.mrpc import MrpcParams
from controllers.symbol import ControllerParams, LuxloopParams, refuse_place, refuse_start
from controllers.symbol.sensing.flat_model import FeatureParams
from controllers.symbol.sensing.projector import StartParams, SymbolParams
from loop.scenario.checks import CheckParams, Light, refuse_lights
from loop.scenario.disturbances import DisturbanceParams
from loop.scenario.overrides import Override, is_file, overridden, resolve_paths, tables, texts
from loop.scenario.plant import PlantParams, SimulatedPlantParams, refuse_long_exposures, refuse_shadow
from loop.scenario.shipped import find
from perception.camera import CameraParams
from perception.detection.params import DetectorParams
from perception.extraction import Extraction, ExtractionParams
from perception.sensors import SensorParams
from perception.trackers import AnyTracker
from perception.tracking import TrackerParams
from world.errors import LuxloopError, did_you_mean, located
from world.materials.library import RoadSurfaceParams
from world.materials.spots import SpotParams
from world.params import Params, PlainName
from world.plugin import PATTERN, Name, refuse_code
from world.roads.shapes import Flat, RoadParams
from world.scene.scene import StreetLamp
from world.scene.vehicle import VehicleParams
from world.traffic.generator import TrafficParams
from world.traffic.objects import ObjectParams
from world.validation import read_toml, validated

SCHEMA_VERSION: Final = 1
PIXEL_CONTROLLERS = ("ssc", "jpo")
LIT = ("lighting", "functions")  # tables of which a scenario of lighting functions has one at least


class HeadlightParams(Params):
    """The vehicle's pair of headlamps, and what of them draws the symbol."""

    model: str = Field("idealised-332x1024", min_length=1, description="preset, or lamp file: .npz, .toml, .ies or .ldt")
    intensity_cd: float | None = Field(
        None, gt=0, le=500_000, description="peak of the brightest module that draws, all pixels on; left out: the model's own"
    )
    height_m: float = Field(0.75, gt=0.1, le=2.0, description="height of the lamps' origins above the road")
    distance_m: float = Field(1.2, ge=0, le=3, description="distance between the lamps' origins")
    lamps: tuple[Literal["left", "right"], ...] = Field(("left",), min_length=1, description="lamps that draw the symbol")
    modules: tuple[str, ...] | None = Field(
        None, min_length=1, description="their modules that draw it; left out: the one with the finest pixels"
    )
    swivel_deg: float = Field(0.0, ge=-30, le=30, description="turns the modules that can be turned to the left (physical bending)")
    level_deg: float = Field(0.0, ge=-10, le=10, description="turns the modules that can be levelled down (physical levelling)")

    @field_validator("lamps", "modules")
    @classmethod
    def _each_once(cls, names: tuple[str, ...] | None, info: ValidationInfo) -> tuple[str, ...] | None:
        if names is not None and len(set(names)) < len(names):
            raise ValueError(f"name each of the {info.field_name} once")
        return names


class DrawingLampsParams(HeadlightParams):
    """The vehicle's pair of headlamps, and the base beam that a symbol is drawn into."""

    beam: str = Field(
        "off", min_length=1, description="what the modules that draw show beside the symbol: a beam of the lamp, such as low, full or off"
    )


class LightParams(Params):
    """Light that is there without the headlights."""

    ambient_lx: float = Field(0.3, ge=0, le=100_000, description="illuminance of a surface facing the sky")
    street_lamps: tuple[StreetLamp, ...] = Field((), description="point lights")


class WorldScenario(Params):
    """What every scenario has: the world, the lamps, the camera, and how long it runs."""

    schema_version: Literal[1] = Field(SCHEMA_VERSION, description="version of this file format")
    name: str = Field(min_length=1, max_length=80, description="name, for tables and reports")
    description: str = Field("", description="what is to be seen, in a sentence")
    steps: int = Field(40, ge=1, le=100_000, description="control steps")
    rate_hz: float = Field(30.0, ge=0.1, le=1000, description="control rate")
    seed: int = Field(0, ge=0, lt=2**63, description="seed of all noise")
    road: RoadParams = Field(Flat(), description="the road's shape")
    surface: RoadSurfaceParams = Field(RoadSurfaceParams(), description="the road's albedo")
    spots: tuple[SpotParams, ...] = Field((), description="spots on the road, unknown to the controller")
    objects: tuple[ObjectParams, ...] = Field((), description="objects on the road")
    traffic: TrafficParams | None = Field(None, description="objects besides, made from a seed; left out: none")
    light: LightParams = Field(LightParams(), description="ambient light and street lamps")
    headlight: HeadlightParams = Field(HeadlightParams(), description="the lamps")
    camera: CameraParams = Field(CameraParams(), description="the camera")
    pixel_controller: str = Field("ssc", description="what drives the pixels: ssc, jpo, or one of your own as package.module:Name")
    ssc: MrpcParams = Field(MrpcParams(), description="SuperSampling Control, which joint pixel optimisation starts from")
    jpo: JpoParams = Field(JpoParams(), description='joint pixel optimisation, with pixel_controller = "jpo"')
    renderer: Literal["auto", "opengl", "raycast"] = Field("auto", description="source of the G-buffer")
    checks: Mapping[PlainName, CheckParams] = Field({}, description="bounds on what the recording shows, by name")
    disturbances: DisturbanceParams = Field(DisturbanceParams(), description="disturbances unknown to the controller")
    vehicle: VehicleParams | None = Field(None, description="how the vehicle drives; left out: it stands")
    sensors: SensorParams = Field(SensorParams(), description="sensors of the vehicle's motion")
    plant: Annotated[PlantParams, Field(description="what shows the light and exposes the frames")] = SimulatedPlantParams()
    judge_every: int = Field(1, ge=0, le=100_000, description="steps from one judgement of a symbol that is held to the next; 0: none")
    off_share: float = Field(0.5, gt=0, lt=1, description="share of a control step for which symbols that are held are off")
    metered: ClassVar[bool]  # whether the illuminance on objects is asked for, beside what the camera sees

    @field_validator("pixel_controller")
    @classmethod
    def _known_or_own(cls, name: str) -> str:
        if name not in PIXEL_CONTROLLERS and not re.fullmatch(PATTERN, name):
            known = did_you_mean(name, PIXEL_CONTROLLERS)
            raise ValueError(f"there is no pixel controller {name!r}; {known} One of your own is given as package.module:Name")
        return name if name in PIXEL_CONTROLLERS else Name(name)

    @model_validator(mode="after")
    def _jpo_at_work(self) -> Self:
        if self.pixel_controller != "jpo" and self.jpo != JpoParams():
            raise ValueError(f'jpo: is for pixel_controller = "jpo", which is {self.pixel_controller!r} here; set that, or leave it out')
        return self

    @model_validator(mode="after")
    def _compared_with_what_there_is(self) -> Self:
        refuse_lights(self.checks, self.lights)
        return self

    @property
    def holds(self) -> bool:
        """Whether a controller holds a symbol."""
        raise NotImplementedError

    @property
    def shares(self) -> tuple[float, ...]:
        """Of a control step, one an exposure: with the symbols that are held and without them, or the whole."""
        return (1 - self.off_share, self.off_share) if self.holds else (1.0,)

    @property
    def lights(self) -> tuple[Light, ...]:
        """Those that checks may compare with."""
        return ()

    @model_validator(mode="after")
    def _aimed_lamps_draw(self) -> Self:
        for k, aim in enumerate(self.disturbances.aim):
            if aim.lamp is not None and aim.lamp not in self.headlight.lamps:
                raise ValueError(f"disturbances.aim[{k}].lamp: the {aim.lamp} lamp is dark here; name it in headlight.lamps as well")
        return self

    @property
    def all_objects(self) -> tuple[ObjectParams, ...]:
        """The objects that are given one by one, and those of the traffic."""
        return self.objects + (self.traffic.objects() if self.traffic else ())

    @cached_property
    def source(self) -> str:
        """Where it was read, for messages; its name where it was made in Python."""
        return self.name

    @property
    def digest(self) -> str:
        """SHA-256 of the resolved scenario, hexadecimal."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()


class Scenario(WorldScenario):
    """Everything that decides a run of the closed loop around a symbol."""

    headlight: DrawingLampsParams = Field(DrawingLampsParams(), description="the lamps")
    symbol: SymbolParams = Field(description="what is projected, and where it shall lie")
    start: StartParams = Field(StartParams(), description="where the control starts")
    features: FeatureParams = Field(FeatureParams(), description="what of the symbol the controller looks at")
    extraction: Extraction = Field(ExtractionParams(), description="how the symbol is found in the image")
    controller: Annotated[ControllerParams, Field(description="the controller of the symbol")] = LuxloopParams()
    metered = False

    @property
    def holds(self) -> bool:
        return True

    @property
    def lights(self) -> tuple[Light, ...]:
        return ("open_loop",)

    @model_validator(mode="after")
    def _share_of_a_beam(self) -> Self:
        if self.symbol.quantity == "u_rel" and self.headlight.beam == "off":
            raise ValueError('symbol.quantity: u_rel is a multiple of the base beam, but there is none; give headlight.beam = "low", say')
        return self

    @model_validator(mode="after")
    def _can_be_held(self) -> Self:
        refuse_long_exposures(self.camera.exposure_s, self.off_share, self.rate_hz)
        refuse_place(self.controller, self.symbol.target, "symbol.")
        refuse_start(self.controller, self.start)
        return self


class CarLampsParams(HeadlightParams):
    """The vehicle's pair of headlamps, of which all modules shine unless some are named."""

    model: str = Field("ssl-hd", min_length=1, description="preset, or lamp file: .npz, .toml, .ies or .ldt")
    intensity_cd: float | None = Field(
        None, gt=0, le=500_000, description="peak of the brightest module, all pixels on; left out: the model's own"
    )
    lamps: tuple[Literal["left", "right"], ...] = Field(("left", "right"), min_length=1, description="lamps that shine")
    modules: tuple[str, ...] | None = Field(None, min_length=1, description="their modules that shine; left out: all")
    standby_w: float = Field(5.0, ge=0, le=1e6, description="electrical power of a lamp that is dark: its electronics and fan")
    efficacy_lm_w: float = Field(
        40.0, gt=0, le=1000, description="luminous flux that leaves a lamp for each watt that its light sources take"
    )

    def power_w(self, flux_lm: float) -> float:
        """Electrical power of one lamp that gives so much light."""
        return self.standby_w + flux_lm / self.efficacy_lm_w


class RoadConditionParams(Params):
    """Rain and street lighting from one time on, as lighting functions know them."""

    time_s: float = Field(0.0, ge=0, le=1e6, description="time from which on this holds, until the next entry")
    wet: bool = Field(False, description="whether it rains")
    street_lit: bool = Field(False, description="whether street lamps light the road")


class LightingScenario(WorldScenario):
    """Everything that decides a run of lighting functions."""

    headlight: CarLampsParams = Field(CarLampsParams(), description="the lamps")
    conditions: tuple[RoadConditionParams, ...] = Field(
        (RoadConditionParams(),), min_length=1, description="rain and street lighting, in ascending time"
    )
    lighting: LightingParams = Field(LightingParams(), description="base beam, and what holds for all lighting functions")
    functions: Functions = Field({}, description="lighting functions, each by its name")
    detector: DetectorParams | None = Field(
        None, description="what finds objects in the camera's frames; left out: lighting functions get the true places of all"
    )
    detector_frames: Literal["on", "off", "both"] = Field(
        "on", description="where controllers hold symbols: frames that the detector gets, with the measured symbols, without them, or both"
    )
    tracker: AnyTracker = Field(TrackerParams(), description="follows detections from frame to frame")
    metered = True

    @property
    def holds(self) -> bool:
        return bool(self.controlled)

    @property
    def controlled(self) -> tuple[str, ...]:
        """Names of the symbols that a controller holds."""
        return tuple(name for name, each in self.functions.items() if getattr(each, "controller", None) is not None)

    @property
    def lights(self) -> tuple[Light, ...]:
        return ("full_light", "low_beam", *(("open_loop",) if self.controlled else ()))

    @model_validator(mode="after")
    def _has_on_frames_alone(self) -> Self:
        if self.controlled:
            refuse_long_exposures(self.camera.exposure_s, self.off_share, self.rate_hz)
            return self
        if self.off_share != 0.5:
            raise ValueError("off_share: no controller holds a symbol here that could be off; leave it out")
        for key in ("oncoming", "ambient"):
            if off := [k for k, each in enumerate(getattr(self.disturbances, key)) if each.frames == "off"]:
                raise ValueError(
                    f"disturbances.{key}[{off[0]}].frames: without a symbol that a controller holds steps have no off frame; leave it out"
                )
        return self

    @model_validator(mode="after")
    def _knows_what_was_drawn(self) -> Self:
        refuse_shadow(self.plant, self.controlled)
        return self

    @model_validator(mode="after")
    def _tracks_what_is_detected(self) -> Self:
        if self.detector_frames != "on" and not (self.controlled and self.detector):
            lacking = "detector" if self.controlled else "symbol that a controller holds"
            raise ValueError(f"detector_frames: there is no {lacking} here, so that it means nothing; leave it out")
        if self.detector is None and self.tracker != TrackerParams():
            raise ValueError('tracker: follows what a detector finds, but there is none; give one, detector = {kind = "network"} say')
        if self.detector is not None and (named := [name for name, each in self.functions.items() if _names_objects(each)]):
            raise ValueError(
                f"functions.{named[0]}: names objects, but a detector knows them by class alone; leave names out, "
                "or take the [detector] out"
            )
        return self

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        times = [each.time_s for each in self.conditions]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError(f"conditions: time_s must ascend from entry to entry, here {times}")
        names = [each.name for each in self.all_objects]
        if doubled := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"objects: the name {doubled[0]!r} is there twice, but recordings tell objects by name; rename one")
        return self


def _names_objects(function: Any) -> bool:
    selections = (function, *(getattr(function, key, None) for key in ("when", "unless")))
    observer = getattr(function, "observer", None)
    return any(getattr(each, "names", None) for each in selections) or (observer is not None and observer.name is not None)


AnyScenario = Scenario | LightingScenario
EXAMPLES: Final[dict[type[AnyScenario], str]] = {
    Scenario: "`luxloop new FILE` writes a complete example; lighting functions come in [functions.NAME] instead of [symbol]",
    LightingScenario: "`luxloop list` shows examples of all functions, `luxloop new FILE --like path_projection` copies one, say, and "
    "`--like obl` one with a detector",
}


def load(name: str, overrides: Sequence[Override] = (), *, allow_code: bool = False, **values: Any) -> Scenario:
    """Read the scenario of a symbol, as `load_any` does. Raises LuxloopError for a lighting scenario as well."""
    return _of_a_symbol(load_any(name, overrides, allow_code=allow_code, **values), name)


def validate(data: Mapping[str, Any], source: str) -> Scenario:
    """Check the scenario of a symbol, as `validate_any` does. Raises LuxloopError for a lighting scenario as well."""
    return _of_a_symbol(validate_any(data, source), source)


def validate_lighting(data: Mapping[str, Any], source: str) -> LightingScenario:
    """Check the scenario of lighting functions, as `validate_any` does. Raises LuxloopError for that of a symbol as well."""
    scenario = validate_any(data, source)
    if isinstance(scenario, Scenario):
        raise LuxloopError(f"{source}: is the scenario of a [symbol], but this needs one with [functions]; `luxloop run` runs both kinds")
    return scenario


def load_any(name: str, overrides: Sequence[Override] = (), *, allow_code: bool = False, **values: Any) -> AnyScenario:
    """Read a scenario by shipped name or path; values are top-level keys, overrides on top of them.

    allow_code: whether modules that a file names may run; those named in values and in overrides that are no files always may.

    An override is `key.sub=value` or `list[0].sub=value` in TOML syntax, the path of a TOML file of such keys, or nested tables; it changes
    single keys of tables that have defaults, too. Raises LuxloopError that names the file, the key and the remedy.
    """
    path = find(name)
    data = read_toml(path)
    resolve_paths(data, path.parent)
    keys = tables(values)
    if "controller" in keys and "functions" in data:
        _of_the_controlled(data, path)["controller"] = keys.pop("controller")
    data.update(keys)
    if overrides:
        data = overridden(_with_defaults(data), overrides)
    given = [
        *(f"{key}={value['name'] if isinstance(value, dict) and 'name' in value else value}" for key, value in values.items()),
        *(override for override in overrides if isinstance(override, str)),
    ]
    scenario = validate_any(data, f"{path} with {' '.join(given)}" if given else str(path))
    if not allow_code:
        refuse_code(scenario, scenario.source, typed=set(texts([tables(each) for each in (values, *overrides) if not is_file(each)])))
    return scenario


def validate_any(data: Mapping[str, Any], source: str) -> AnyScenario:
    """Check a scenario given as plain data; its table [symbol], or [lighting] or [functions], tells the kinds apart.

    Modules that it names may run: it is for data of the caller's own, and for what `load_any` has let pass.
    Raises LuxloopError that names the source, the key and the remedy.
    """
    version = data.get("schema_version", SCHEMA_VERSION)
    if version != SCHEMA_VERSION:
        raise LuxloopError(
            f"{source}: schema_version: this luxloop reads version {SCHEMA_VERSION}, not {version!r}; get another luxloop for it"
        )
    lighting, lit = data.get("lighting"), next((key for key in LIT if key in data), None)
    if "symbol" in data and isinstance(lighting, Mapping) and lighting.get("raw"):
        raise LuxloopError(
            f"{source}: lighting.raw: the controller of a [symbol] moves a primitive, which raw utilisations have none of; take one of the "
            "two out, or give a lamp file the utilisations as a beam (docs/lampfiles.md) and draw the symbol into it with headlight.beam"
        )
    if "symbol" in data and lit:
        raise LuxloopError(
            f"{source}: has both a [symbol] and [{lit}]; a scenario is of one kind, take one of the two out (what a lighting "
            "function draws is its own image, as in functions.NAME.image)"
        )
    if "symbol" in data and (strange := [key for key in data if key in LightingScenario.model_fields and key not in Scenario.model_fields]):
        raise LuxloopError(
            f"{source}: {strange[0]}: goes with [lighting], but this is the scenario of a [symbol]; leave it out, or take one with "
            "lighting functions, such as obl"
        )
    if "controller" in data and lit:
        raise LuxloopError(f"{source}: controller: a scenario with [{lit}] has no controller; leave it out")
    kind = _kind(data)
    with located(source):
        return validated(kind, _spelt_out(data), EXAMPLES[kind]).model_copy(update={"source": source})


def _spelt_out(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The same data with tables where functions give a controller by its name alone."""
    functions = data.get("functions")
    if not isinstance(functions, Mapping):
        return data

    def table(function: Any) -> Any:
        name = function.get("controller") if isinstance(function, Mapping) else None
        return {**function, "controller": {"name": name}} if isinstance(name, str) else function

    return {**data, "functions": {name: table(function) for name, function in functions.items()}}


def _kind(data: Mapping[str, Any]) -> type[AnyScenario]:
    """By its table; where it has neither, by the others that it has, or by one that may have been meant."""
    if any(key in data for key in ("symbol", *LIT)):
        return Scenario if "symbol" in data else LightingScenario
    strange = [key for key in data if key not in Scenario.model_fields]
    meant = any(key in LightingScenario.model_fields or difflib.get_close_matches(key, LIT, cutoff=0.8) for key in strange)
    return LightingScenario if meant else Scenario


def _of_the_controlled(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """The table of the only symbol that a controller holds. Raises LuxloopError where there are several or none."""
    functions = data["functions"] if isinstance(data["functions"], dict) else {}
    held = {name: each for name, each in functions.items() if isinstance(each, dict) and "controller" in each}
    if len(held) == 1:
        return next(iter(held.values()))
    told = f"several symbols have one: {', '.join(held)}; set functions.NAME.controller" if held else "none of its functions has one"
    raise LuxloopError(f"{path}: controller: {told}")


def _with_defaults(data: dict[str, Any]) -> dict[str, Any]:
    """The same scenario with all defaults in place; data that is none, which overrides may mend, stays as it is."""
    try:
        return validate_any(data, "").model_dump(mode="json")
    except LuxloopError:
        return data


def _of_a_symbol(scenario: AnyScenario, source: str) -> Scenario:
    if isinstance(scenario, LightingScenario):
        raise LuxloopError(f"{source}: is a lighting scenario, but this needs one with a [symbol]; `luxloop run` runs both kinds")
    return scenario
