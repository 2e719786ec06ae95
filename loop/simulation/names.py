"""Whether what a scenario's lighting names is there, and known."""

from typing import Any

from luxloop.loop.scenario.model import Scenario, objects_named
from luxloop.loop.scenario.plant import shadow_of
from luxloop.loop.simulation.columns import of_truth
from luxloop.loop.simulation.lamps import ShiningModule
from luxloop.perception.detection.detector import TruthParams
from luxloop.world.errors import LuxloopError, all_of, did_you_mean


def check_names(scenario: Scenario, modules: tuple[ShiningModule, ...]) -> None:
    """Raises LuxloopError where utilisations or a function are meant for a lamp, module or object that is not there."""
    _check_painted(scenario, modules)
    known = dict.fromkeys(word for module in modules for word in (*module.name.split(" ", 1), module.name))
    objects = [item.name for item in scenario.all_objects if item.category is not None]
    drawn: dict[str, Any] = {f"lighting.raw[{k}]": raw for k, raw in enumerate(scenario.lighting.raw)}
    functions = {f"functions.{name}": function for name, function in scenario.functions.items()}
    for where, each in (drawn | functions).items():
        for name in getattr(each, "modules", ()):
            if name not in known:
                raise LuxloopError(f"{where}.modules: there is no lamp or module {name!r}; there are {', '.join(known)}")
    for where, function in functions.items():
        for key, name in objects_named(function):
            if name not in objects:
                raise LuxloopError(
                    f"{where}.{key}: there is no object {name!r} with a category; there are "
                    f"{', '.join(objects) or 'none'}, an object is tracked if it has a category"
                )


def _check_painted(scenario: Scenario, modules: tuple[ShiningModule, ...]) -> None:
    sizes = {each.name: (each.headlight.pixel_rows, each.headlight.pixel_cols) for each in modules}
    for k, each in enumerate(scenario.lighting.painted):
        if each.module not in sizes:
            raise LuxloopError(f"lighting.painted[{k}].module: there is no module {each.module!r}; {did_you_mean(each.module, sizes)}")
        given, own = each.pictures[0].shape, sizes[each.module]
        if given != own:
            raise LuxloopError(
                f"lighting.painted[{k}].png: has {given[0]} x {given[1]} pixels, but the module {each.module!r} has {own[0]} x {own[1]}; "
                "bring it to this size"
            )


def refuse_unknown(scenario: Scenario, known: bool) -> None:
    """Raises LuxloopError that names all keys that need a plant which knows the truth, unless it is known, or the simulated world.

    In shadow, where nothing is shown, objects are merely unknown.
    """
    kind = scenario.plant.kind
    params, tracked = scenario.lighting, any(each.category for each in scenario.all_objects)
    wants = {
        "detector.kind": (isinstance(scenario.detector, TruthParams), "give a detector that looks at frames"),
        "objects": (
            tracked and scenario.detector is None and not shadow_of(scenario.plant),
            "give a [detector] that finds them in frames, or take them out",
        ),
        "lighting.street_lamps": (params.street_lamps, "leave it out"),
        "lighting.shadow_rays": (params.shadow_rays, "leave it out"),
        **{f"functions.{name}": (function.kind == "material", "take it out") for name, function in scenario.functions.items()},
    }
    truth = f"needs the truth, which the plant {kind} does not know"
    wrong = [f"{key}: {truth}; {remedy}" for key, (wanted, remedy) in wants.items() if wanted and not known]
    for name, check in scenario.checks.items():
        remedy = f"take it out with --set checks.{name}={{}}"
        if not known and of_truth(check.metric):
            wrong.append(f"checks.{name}.metric: {truth}; {remedy}")
        elif check.compare is not None and (kind != "simulated" or scenario.digitised):
            but = f"modules.{scenario.digitised} is digitised" if kind == "simulated" else f"the plant is {kind}"
            wrong.append(f"checks.{name}.compare: needs the simulated world to run another light in, but {but}; {remedy}")
    if wrong:
        raise all_of(wrong)
