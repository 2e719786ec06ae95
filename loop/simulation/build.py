"""Builds a simulation and its plant from a scenario: check by topic, then build the parts in order of dependence."""

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Any, cast

import torch

from luxloop.controllers.functions.commands import MOVEMENTS, CommandParams, DirectParams
from luxloop.controllers.functions.planner import Planner
from luxloop.controllers.pixels.primitives import names_module
from luxloop.controllers.pixels.secondary import PotentialLight
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.loop.scenario.model import Scenario, object_names
from luxloop.loop.scenario.plant import RecordedPlantParams, RemotePlantParams, RigPlantParams, SimulatedPlantParams, shadow_of
from luxloop.loop.scenario.shipped import find_file
from luxloop.loop.simulation.clock import FromZero
from luxloop.loop.simulation.columns import of_truth
from luxloop.loop.simulation.controlled import build_symbols, place
from luxloop.loop.simulation.detection import DetectionPipeline
from luxloop.loop.simulation.lamps import MountedModule, drawing_modules, lamp_modules, mount, shining_module
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.pixel_gain_loop import PixelGainLoop
from luxloop.loop.simulation.protocol import Arrivals, Exposure, Plant
from luxloop.loop.simulation.simulated import digitised_plant, simulated_plant
from luxloop.loop.simulation.truth import LampModule, true_camera
from luxloop.perception.camera import CameraParams, camera_view
from luxloop.perception.detection.detector import TruthParams
from luxloop.world import plugin
from luxloop.world.errors import LuxloopError, all_of, did_you_mean, locate
from luxloop.world.headlight.lamp import REST
from luxloop.world.rendering.rasterise import check_process

LEAST_PX = 4  # smallest extent of a target in either direction: two pixels for each quadrant
Sentences = Iterator[str]
Modules = Sequence[MountedModule]


def check(scenario: Scenario, modules: Modules) -> None:
    """Raises LuxloopError for the first error of a scenario, before anything is built.

    modules: the shining modules. Errors in a file's content, a user's class or the rendered light are raised later, where each is read.
    """
    for sentence in chain.from_iterable(topic(scenario, modules) for topic in (_lighting, _functions, _plant, _symbols, _movements)):
        raise LuxloopError(sentence)


def _lighting(scenario: Scenario, modules: Modules) -> Sentences:
    """Errors of beams, raw utilisations and painted pictures."""
    lighting, sizes = scenario.lighting, {each.name: (each.headlight.pixel_rows, each.headlight.pixel_cols) for each in modules}
    for k, painted in enumerate(lighting.painted):
        key, size = f"lighting.painted[{k}]", painted.pictures[0].shape
        if (own := sizes.get(painted.module)) is None:
            yield f"{key}.module: there is no module {painted.module!r}; {did_you_mean(painted.module, sizes)}"
        elif size != own:
            yield (
                f"{key}.png: has {size[0]} x {size[1]} pixels, but the module {painted.module!r} has {own[0]} x {own[1]}; "
                "bring it to this size"
            )
    for k, raw in enumerate(lighting.raw):
        yield from _unknown_modules(f"lighting.raw[{k}]", raw, modules)
    for module in modules:
        own_raw = [f"lighting.raw[{k}]" for k, raw in enumerate(lighting.raw) if names_module(raw.modules, module.name)]
        if len(own_raw) > 1:
            yield f"{' and '.join(own_raw[:2])} both apply to module {module.name!r}; name the modules of each in its modules"
        for beam in () if own_raw else lighting.base.names:
            try:
                module.lamp.require_beam(beam)
            except LuxloopError as error:
                yield f'lighting.base.beam: {error}; write beam = "full" for all pixels on'


def _functions(scenario: Scenario, modules: Modules) -> Sentences:
    """Functions with unknown modules or objects."""
    objects = [item.name for item in scenario.all_objects if item.category is not None]
    for key, function in ((f"functions.{name}", each) for name, each in scenario.functions.items()):
        yield from _unknown_modules(key, function, modules)
        for inner, name in object_names(function):
            if name not in objects:
                yield (
                    f"{key}.{inner}: there is no object {name!r} with a category; there are {', '.join(objects) or 'none'}, "
                    "an object is tracked if it has a category"
                )


def _unknown_modules(key: str, params: Any, modules: Modules) -> Sentences:
    known = dict.fromkeys(word for module in modules for word in (*module.name.split(" ", 1), module.name))
    for name in getattr(params, "modules", ()):
        if name not in known:
            yield f"{key}.modules: there is no lamp or module {name!r}; there are {', '.join(known)}"


def _plant(scenario: Scenario, modules: Modules) -> Sentences:
    """A digitised module with an unsuitable plant, or a true camera below the road."""
    plant, error = scenario.plant, scenario.disturbances.calibration
    if scenario.digitised_module is not None and not isinstance(plant, SimulatedPlantParams | RecordedPlantParams):
        yield (
            f"modules.{scenario.digitised_module}.source: a digitised beam lights the simulated world, but the plant is {plant.kind}; "
            'set plant.kind = "simulated"'
        )
    if scenario.headlight.rate_hz is not None and (
        scenario.digitised_module or not isinstance(plant, SimulatedPlantParams | RecordedPlantParams)
    ):
        yield "headlight.rate_hz: only the simulated world shows more exposures than frames; leave it out"
    if error.z_m and (z_m := scenario.camera.z_m + error.z_m) <= 0:
        yield f"disturbances.calibration.z_m: the camera is at {z_m:.3g} m, not above the road; lower it less"


def _symbols(scenario: Scenario, modules: Modules) -> Sentences:
    """Symbol targets outside the camera's view."""
    for name, given in scenario.symbols.items():
        with locate(f"functions.{name}"):
            symbol = place(given, scenario)
        target = f"functions.{name}: the target at x_m = {symbol.x_m:g}, y_m = {symbol.y_m:g}"
        if not _in_the_image(symbol.held, scenario.camera):
            yield f"{target} is outside of the camera's view; move it, or turn the camera"
        elif not _in_the_image(symbol.held, true_camera(scenario)):
            yield f"{target} is outside of the view of the true camera; reduce disturbances.calibration"


def _in_the_image(symbol: SymbolParams, camera: CameraParams) -> bool:
    view = camera_view(camera)
    x = symbol.x_m + symbol.length_m * torch.tensor([-0.5, -0.5, 0.5, 0.5], dtype=torch.float64)
    y = symbol.y_m + symbol.width_m * torch.tensor([-0.5, 0.5, -0.5, 0.5], dtype=torch.float64)
    uv, depth = view.project(torch.stack([x, y, torch.zeros_like(x)]))
    size = torch.tensor([view.width, view.height], dtype=torch.float64)
    extent = torch.minimum(uv.amax(-1), size) - uv.amin(-1).clamp(min=0)
    return bool((depth > 0).all() and (extent >= LEAST_PX).all())


def _movements(scenario: Scenario, modules: Modules) -> Sentences:
    """Functions whose modules cannot move, or draw a closed-loop symbol."""
    drawing = [(name, modules[k]) for name, symbol in scenario.symbols.items() for k in drawing_modules(symbol, modules)]
    for name, function in scenario.functions.items():
        if isinstance(function, DirectParams):
            if all(getattr(function, movement) == getattr(REST, movement) for movement in MOVEMENTS):
                continue
            how = "turned or dimmed"
        elif isinstance(function, CommandParams):
            how = MOVEMENTS[function.movements[0]]
            if not any(map(function.moves, modules)):
                yield f"functions.{name}.modules: none of these modules can be {how}; name others, or take another lamp as headlight.model"
        else:
            continue
        yield from (at_rest(symbol, module.name, f"{how} by functions.{name}") for symbol, module in drawing if function.moves(module))


def at_rest(symbol: str, module: str, how: str) -> str:
    """Error text: a module that draws a closed-loop symbol must be at rest. how: turned or dimmed, and by which function."""
    return (
        f"functions.{symbol}.modules: {module!r} is {how}, but a controller can hold a symbol only with modules at rest; "
        "name another module here, or other modules in the function that moves them"
    )


def check_truth(scenario: Scenario, known: bool) -> None:
    """Raises LuxloopError with all keys that need the truth or the simulated world, if the plant lacks it. known: whether the plant knows
    the truth.

    A shadow run shows no light and may have unknown objects.
    """
    kind, lighting = scenario.plant.kind, scenario.lighting
    objects = any(each.category for each in scenario.all_objects) and scenario.detector is None and not shadow_of(scenario.plant)
    needs = {
        "detector.kind": (isinstance(scenario.detector, TruthParams), "give a detector that looks at frames"),
        "objects": (objects, "give a [detector] that finds them in frames, or take them out"),
        "judge_causes": (scenario.judge_causes, "leave it out"),
        "judge_projections": (scenario.judge_projections, "leave it out"),
        "probes": (bool(scenario.probes), "take them out, or --probe"),
        "lighting.street_lamps": (lighting.street_lamps, "leave it out"),
        "lighting.shadow_rays": (lighting.shadow_rays, "leave it out"),
        **{f"functions.{name}": (function.kind == "material", "take it out") for name, function in scenario.functions.items()},
    }
    truth = f"needs the truth, which the plant {kind} does not know"
    wrong = [f"{key}: {truth}; {remedy}" for key, (needed, remedy) in needs.items() if needed and not known]
    for name, check in scenario.checks.items():
        remedy = f"take it out with --set checks.{name}={{}}"
        if not known and of_truth(check.metric):
            wrong.append(f"checks.{name}.metric: {truth}; {remedy}")
        elif check.compare is not None and (kind != "simulated" or scenario.digitised_module):
            but = f"modules.{scenario.digitised_module} is digitised" if kind == "simulated" else f"the plant is {kind}"
            wrong.append(f"checks.{name}.compare: needs the simulated world to run another light in, but {but}; {remedy}")
    if wrong:
        raise all_of(wrong)


KEY = "plant.kind"
METHODS = ("start", "show")


def build(scenario: Scenario, device: torch.device, cache: PartCache) -> dict[str, Any]:
    """Fields of `Simulation`. Raises LuxloopError as `check`, for a missing or broken file, or if a user's part fails."""
    check_process()
    mounts = cache("mounted modules", mount, scenario.headlight, str(device))
    check(scenario, mounts)
    planner = Planner.prepare(scenario.functions, scenario.lighting, lambda image: find_file(image, "symbols"))
    modules = tuple(shining_module(scenario, each, cache) for each in mounts)
    plant = build_plant(scenario, cache("lamp modules", lamp_modules, mounts), cache)
    truth, view, detector = getattr(plant, "truth", None), camera_view(scenario.camera), scenario.detector
    check_truth(scenario, truth is not None)
    pipeline = None
    if detector is not None:
        parts = detector, scenario.tracker, scenario.camera
        pipeline = cache("pipeline", lambda *_: DetectionPipeline.prepare(detector, scenario.tracker, view, device), *parts)
    asked = scenario.pixel_gains
    gains = None if asked is None else PixelGainLoop(asked, modules, scenario.camera, view)
    return {
        "planner": planner,
        "modules": modules,
        "lights": tuple((module.name, PotentialLight.of(module.headlight, module.T_world_module)) for module in modules),
        "view": view,
        "plant": plant,
        "pipeline": pipeline,
        "gain_loop": gains,
        "controlled": build_symbols(scenario, modules, planner, truth, cache),
    }


class Unconnected:
    """A hardware plant without a rig, for checking a scenario; it cannot be started."""

    def start(self) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        raise LuxloopError(f"{KEY}: no rig is connected; run it with `luxloop run NAME --rig FILE`, or play a recording of it with --plant")

    def show(self, state: Any, exposure: Exposure) -> tuple[Any, Arrivals]:
        """Raises LuxloopError."""
        return self.start()


def build_plant(scenario: Scenario, modules: Sequence[LampModule], cache: PartCache) -> Plant:
    """A scenario's plant, with time from 0. Raises LuxloopError for a missing or broken file, or a user's plant that cannot be made."""
    params = scenario.plant
    if isinstance(params, SimulatedPlantParams):
        return (simulated_plant if scenario.digitised_module is None else digitised_plant)(scenario, modules, cache)
    if isinstance(params, RecordedPlantParams):
        from luxloop.loop.simulation.frames import recorded_plant

        return recorded_plant(scenario, params, modules)
    if isinstance(params, RigPlantParams):
        return Unconnected()
    if isinstance(params, RemotePlantParams):
        from luxloop.loop.simulation.remote import remote_plant

        return from_zero(remote_plant(scenario, params, modules), scenario, modules)
    given = {"scenario": scenario, "modules": modules}
    return from_zero(cast(Plant, plugin.make(params.kind, KEY, given, params.options, METHODS)), scenario, modules)


def from_zero(plant: Plant, scenario: Scenario, modules: Sequence[LampModule]) -> Plant:
    """The plant with its clock shifted to 0 at the start, and its arrivals checked."""
    return FromZero(plant, f"{KEY}: {scenario.plant.kind}", scenario.camera, modules[0].headlight.matrix.values)
