"""When other values of keys act in a simulation that runs."""

from typing import Final, Literal

from luxloop.loop.scenario.model import Scenario

Acts = Literal["step", "prepared", "restart"]

# by the longest beginning of a key
ACTS: Final[dict[str, Acts]] = {
    "": "prepared",
    **dict.fromkeys(("name", "description", "steps", "judge_every", "checks", "conditions", "lighting", "functions"), "step"),
    **dict.fromkeys(("schema_version", "seed", "rate_hz", "off_share", "plant", "renderer", "pixel_controller"), "restart"),
    **dict.fromkeys(("headlight.model", "headlight.lamps", "headlight.modules"), "restart"),
    **dict.fromkeys(("camera.width_px", "camera.height_px", "camera.oversampling", "camera.bits"), "restart"),
    **dict.fromkeys(("detector", "detector_frames", "tracker"), "restart"),
}


def acts(before: Scenario, after: Scenario) -> Acts:
    """When what tells two scenarios apart acts: at the next step; once it is prepared, while the simulation goes on; or in one that starts
    anew.
    """
    found = {_acts(key) for key in _changed(before, after)}
    if before.shares != after.shares or (before.vehicle is None) != (after.vehicle is None):
        return "restart"
    if "restart" in found or (found - {"step"} and after.plant.kind != "simulated"):
        return "restart"
    longer = before.steps != after.steps and after.vehicle is not None  # for which its motion is integrated
    return "prepared" if "prepared" in found or longer or before.metered != after.metered else "step"


def _changed(before: Scenario, after: Scenario) -> list[str]:
    keys = [key for key in Scenario.model_fields if getattr(before, key) != getattr(after, key)]
    inner = {key: type(getattr(after, key)).model_fields for key in ("headlight", "camera") if key in keys}
    within = [f"{key}.{name}" for key, names in inner.items() for name in names if _of(before, key, name) != _of(after, key, name)]
    return [key for key in keys if key not in inner] + within


def _of(scenario: Scenario, key: str, name: str) -> object:
    return getattr(getattr(scenario, key), name)


def _acts(key: str) -> Acts:
    return ACTS.get(key) or ACTS.get(key.partition(".")[0]) or ACTS[""]
