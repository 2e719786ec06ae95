"""A lamp's beam held against a regulation's set of test points."""

from collections.abc import Mapping
from types import MappingProxyType

from world.errors import LuxloopError
from world.headlight.lamp import Lamp
from world.regulation import Result, aim, check, rule_set
from world.regulation.results import Traffic

RULE_OF_BEAM: Mapping[str, str] = MappingProxyType(
    {"low": "r149-passing-c", "adverse": "r149-passing-c", "motorway": "r149-passing-c", "town": "r149-passing-v", "high": "r149-driving-b"}
)


def judge(
    lamp: Lamp, beam: str, rule: str | None = None, aimed: bool = False, traffic: Traffic = "right"
) -> tuple[str, tuple[Result, ...]]:
    """A title for the findings, and the findings. aimed: turn the lamp by its cut-off or maximum first, as the regulation says.

    Raises LuxloopError where the lamp has no such beam, there is no such rule, or no rule is given for a beam that has none of its own.
    """
    intensity = lamp.lit(lamp.beam(beam))
    if rule is None and beam not in RULE_OF_BEAM:
        raise LuxloopError(f"beam {beam!r} has no rule of its own; name one with --rule, `luxloop headlight rules` lists them")
    rules = rule_set(RULE_OF_BEAM[beam] if rule is None else rule)
    turn = aim(intensity, rules.id, traffic=traffic) if aimed else (0.0, 0.0)
    turned = f", aimed by {turn[0]:+.2f} deg to the right and {turn[1]:+.2f} deg up" if aimed else ""
    only = sum(module.headlight.n_pixels for module in lamp.modules) == 1
    what = lamp.name if only else f"{lamp.name}, beam {beam}"
    return f"{what}: {rules.title}{turned}", check(intensity, rules.id, aim=turn, traffic=traffic)


def kept(lamp: Lamp) -> list[str]:
    """A line for each of the lamp's beams that has a rule of its own: how much of it the beam keeps."""
    lines = []
    for beam in lamp.beams:
        if beam in RULE_OF_BEAM:
            asked = [each for each in judge(lamp, beam)[1] if each.verdict != "not applicable"]
            passed = sum(each.verdict == "pass" for each in asked)
            lines.append(f"{beam}: keeps {'all' if passed == len(asked) else passed} of {len(asked)} of {RULE_OF_BEAM[beam]}")
    return lines
