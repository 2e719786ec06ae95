"""Edits of a scenario during its run: other values of keys from a step on."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Literal

from pydantic import Field

from luxloop.loop.scenario.model import Scenario, validate
from luxloop.loop.scenario.overrides import TAGS, overridden
from luxloop.world.errors import LuxloopError
from luxloop.world.params import Params
from luxloop.world.validation import toml

Acts = Literal["step", "prepared", "restart"]

# when a change of a key acts, by the longest known beginning of the key
ACTS: Final[dict[str, Acts]] = {
    "": "prepared",
    **dict.fromkeys(("name", "description", "steps", "judge_every", "checks", "conditions", "lighting", "functions", "probes"), "step"),
    **dict.fromkeys(("schema_version", "seed", "rate_hz", "off_share", "plant", "renderer", "pixel_controller"), "restart"),
    **dict.fromkeys(("headlight.model", "headlight.lamps", "headlight.modules"), "restart"),
    **dict.fromkeys(("camera.width_px", "camera.height_px", "camera.oversampling", "camera.bits"), "restart"),
    **dict.fromkeys(("detector", "detector_frames", "detector_every", "tracker"), "restart"),
}


class Edit(Params):
    """Other values of keys, as of `--set`, from the beginning of a step on. driven: whether a driver's controls made the edit."""

    step: int = Field(ge=0)
    overrides: tuple[str, ...]
    driven: bool = False


def add(edits: list[Edit], edit: Edit) -> None:
    """Add an edit to a list, in place of the last edit if it sets the same keys of the same step."""
    if edits and replaces(edit, edits[-1]):
        edits.pop()
    edits.append(edit)


def replaces(edit: Edit, last: Edit) -> bool:
    """Whether an edit replaces the last one: same step, same keys, and no tables, which are merged."""
    keys, before = ([each.partition("=")[0].strip() for each in one.overrides] for one in (edit, last))
    table = any(each.partition("=")[2].lstrip().startswith("{") for each in edit.overrides)
    return (edit.step, edit.driven, keys) == (last.step, last.driven, before) and not table


def with_overrides(scenario: Scenario, overrides: Sequence[str]) -> Scenario:
    """A scenario with other values of keys. Modules that the values name may run. Raises LuxloopError as `validate`."""
    return validate(overridden(scenario.model_dump(mode="json"), overrides), scenario.source)


def differences(before: Scenario, after: Scenario) -> tuple[str, ...]:
    """Overrides that turn one scenario into another. Raises LuxloopError where there are none."""
    found = tuple(overrides_between(before.model_dump(mode="json"), after.model_dump(mode="json")))
    if with_overrides(before, found) != after:
        raise LuxloopError(f"{after.name}: this change cannot be said in values of keys; open the scenario anew")
    return found


def overrides_between(before: Mapping[str, Any], after: Mapping[str, Any], within: str = "") -> Iterator[str]:
    """Overrides that turn one scenario's tables into another's; a missing key is set to {}. within: the key of both tables, with a dot."""
    for key in {**before, **after}:
        old, new, whole = before.get(key), after.get(key), f"{within}{key}"
        if old == new:
            continue
        if new is None:
            yield f"{whole}={{}}"
        elif isinstance(old, dict) and isinstance(new, dict) and all(old.get(tag) == new.get(tag) for tag in TAGS):
            yield from overrides_between(old, new, f"{whole}.")
        else:
            yield f"{whole}={toml(new)}"


def acts(before: Scenario, after: Scenario) -> Acts:
    """When a change of scenario acts: at the next step, after a preparation while the simulation continues, or only in a new run."""
    found = set[Acts]()
    for key in Scenario.model_fields:  # not `source`, which overrides change
        if (old := getattr(before, key)) != (value := getattr(after, key)):
            inner = [f"{key}.{name}" for name, each in value if each != getattr(old, name)] if key in ("headlight", "camera") else [key]
            found |= {ACTS.get(each) or ACTS.get(key) or ACTS[""] for each in inner}
    if before.shares != after.shares or (before.vehicle is None) != (after.vehicle is None):
        return "restart"
    if "restart" in found or (found - {"step"} and after.plant.kind != "simulated"):
        return "restart"
    longer = before.steps != after.steps and after.vehicle is not None  # its motion is integrated over all steps
    return "prepared" if "prepared" in found or longer or before.meters_light != after.meters_light else "step"
