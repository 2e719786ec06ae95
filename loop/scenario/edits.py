"""Changes of a scenario while it runs: other values of keys from a step on."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import Field

from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import TAGS, overridden
from luxloop.world.errors import LuxloopError
from luxloop.world.params import Params
from luxloop.world.validation import toml


class Edit(Params):
    """Other values of keys, as `--set` has them, from the beginning of a step on. driven: by somebody who drives."""

    step: int = Field(ge=0)
    overrides: tuple[str, ...]
    driven: bool = False


def add(edits: list[Edit], edit: Edit) -> None:
    """Add an edit to others, in place of the last one where it sets the same keys of the same step anew."""
    if edits and replaces(edit, edits[-1]):
        edits.pop()
    edits.append(edit)


def replaces(edit: Edit, last: Edit) -> bool:
    """Whether nothing of the last one is left; tables add up."""
    keys, before = ([each.partition("=")[0].strip() for each in one.overrides] for one in (edit, last))
    table = any(each.partition("=")[2].lstrip().startswith("{") for each in edit.overrides)
    return (edit.step, edit.driven, keys) == (last.step, last.driven, before) and not table


def changed(scenario: Scenario, overrides: Sequence[str]) -> Scenario:
    """A scenario with other values of keys. Modules that they name may run. Raises LuxloopError as `validate`."""
    return validate(overridden(scenario.model_dump(mode="json"), overrides), scenario.source)


def differences(before: Scenario, after: Scenario) -> tuple[str, ...]:
    """Overrides that make one scenario of another. Raises LuxloopError where there are none."""
    found = tuple(_differences(before.model_dump(mode="json"), after.model_dump(mode="json")))
    if changed(before, found) != after:
        raise LuxloopError(f"{after.name}: this change cannot be said in values of keys; open the scenario anew")
    return found


def _differences(before: Mapping[str, Any], after: Mapping[str, Any], within: str = "") -> Iterator[str]:
    for key in {**before, **after}:
        old, new, whole = before.get(key), after.get(key), f"{within}{key}"
        if old == new:
            continue
        if new is None:
            yield f"{whole}={{}}"
        elif isinstance(old, dict) and isinstance(new, dict) and all(old.get(tag) == new.get(tag) for tag in TAGS):
            yield from _differences(old, new, f"{whole}.")
        else:
            yield f"{whole}={toml(new)}"
