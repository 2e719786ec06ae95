"""The scenario that a command line names."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from loop.scenario.shipped import find

if TYPE_CHECKING:
    from loop.scenario.model import Scenario


def scenario_of(name: str, set: Sequence[str] | None, controller: str | None = None, **given: Any) -> "Scenario":
    """Read a scenario by shipped name or path. set: overrides of its keys. controller: name of another controller, with its defaults.
    given: as for `load`.

    Raises LuxloopError, for an unknown name at once: the import of the model, which takes seconds, comes after.
    """
    find(name)
    from loop.scenario.model import load

    if controller is not None:
        given["controller"] = {"name": controller}
    return load(name, set or [], **given)
