"""The scenario that a command line names."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from loop.scenario.shipped import find

if TYPE_CHECKING:
    from loop.scenario.model import Scenario


def scenario_of(name: str, set: Sequence[str] | None, controller: str | None = None, **given: Any) -> "Scenario":
    """It is looked up before the model is imported, which takes seconds, so that a mistyped name is told at once. controller: another one
    with its defaults. given: as for `load`. Raises LuxloopError.
    """
    find(name)
    from loop.scenario.model import load

    if controller is not None:
        given["controller"] = {"name": controller}
    return load(name, set or [], **given)
