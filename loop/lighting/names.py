"""Whether what a scenario's lighting names is there."""

from collections.abc import Iterator

from loop.lighting.lamps import ShiningModule
from loop.scenario.model import LightingScenario
from world.errors import LuxloopError


def check_names(scenario: LightingScenario, modules: tuple[ShiningModule, ...]) -> None:
    """Raises LuxloopError where raw utilisations or a function are meant for a lamp, module or object that is not there."""
    known = dict.fromkeys(word for module in modules for word in (*module.name.split(" ", 1), module.name))
    objects = [item.name for item in scenario.all_objects if item.category is not None]
    for key, each in (("raw", scenario.lighting.raw), ("functions", scenario.lighting.functions)):
        for number, item in enumerate(each):
            for name in getattr(item, "modules", ()):
                if name not in known:
                    where = f"lighting.{key}[{number}].modules"
                    raise LuxloopError(f"{where}: there is no lamp or module {name!r}; there are {', '.join(known)}")
    for number, function in enumerate(scenario.lighting.functions):
        for key, name in _objects_named(function):
            if name not in objects:
                raise LuxloopError(
                    f"lighting.functions[{number}].{key}: there is no object {name!r} with a category; there are "
                    f"{', '.join(objects) or 'none'}, an object is tracked if it has a category"
                )


def _objects_named(function: object) -> Iterator[tuple[str, str]]:
    """The objects that a function names, each after its key."""
    for table in ("", "when.", "unless."):
        selection = getattr(function, table[:-1], None) if table else function
        yield from ((f"{table}names", name) for name in getattr(selection, "names", None) or ())
    if (observer := getattr(function, "observer", None)) is not None and observer.name is not None:
        yield "observer.name", observer.name
