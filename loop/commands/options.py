"""Exit codes, options and scenarios of several commands."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter, validators

from luxloop.loop.scenario.shipped import find

if TYPE_CHECKING:
    from luxloop.loop.scenario.model import Scenario

OK, DIFFERS, FAILED, UNREAD, WRONG, INTERRUPTED = 0, 1, 1, 1, 2, 130

Keys = Annotated[list[str] | None, Parameter(consume_multiple=True, negative=())]
AllowCode = Annotated[bool, Parameter(negative=(), help="Run Python modules that files name; for files and modules that you trust.")]
Points = Annotated[list[str] | None, Parameter(allow_leading_hyphen=True, negative=())]  # their numbers may be negative
Flag = Annotated[bool, Parameter(negative=())]
Json = Flag


def within(**bounds: float) -> Parameter:
    """An option that takes a number within bounds: gt, gte, lt, lte."""
    return Parameter(validator=validators.Number(**bounds))


Count = Annotated[int, within(gte=1)]
Seed = Annotated[int, within(gte=0)]
Share = Annotated[float, within(gt=0, lte=1)]
Weight = Annotated[float, within(gte=0, lt=math.inf)]
Device = Literal["auto", "cpu", "cuda"]


def scenario_of(
    name: str, set: Sequence[str] | None, controller: str | None = None, recorded: bool = False, allow_code: bool = False, **given: Any
) -> "Scenario":
    """Read a scenario by shipped name or path, or the scenario at the beginning of a recorded run by the recording's folder.

    set: overrides of keys. controller: name of another controller, with its defaults. given: top-level keys. Raises LuxloopError as `load`;
    for an unknown name before the import of the model, which takes seconds; and where a folder is no recording.
    """
    if not recorded:
        find(name)
    from luxloop.loop.scenario.model import load, load_data

    if controller is not None:
        given["controller"] = {"name": controller}
    if not recorded:
        return load(name, set or [], allow_code=allow_code, **given)
    from luxloop.loop.recording.manifest import Manifest

    return load_data(Manifest.read(Path(name)).scenario, Path(name), set or [], given, allow_code=allow_code)
