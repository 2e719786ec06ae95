"""Check a lamp's beam against a regulation's test points."""

from collections.abc import Mapping
from types import MappingProxyType

from luxloop.world.errors import LuxloopError
from luxloop.world.headlight.lamp import Lamp
from luxloop.world.regulation import Result, aim_beam, check_beam, rule_set
from luxloop.world.regulation.tables import Traffic

RULE_OF_BEAM: Mapping[str, str] = MappingProxyType(
    {"low": "r149-passing-c", "adverse": "r149-passing-c", "motorway": "r149-passing-c", "town": "r149-passing-v", "high": "r149-driving-b"}
)


def judge(
    lamp: Lamp, beam: str | None = None, rule: str | None = None, aimed: bool = False, traffic: Traffic = "right"
) -> tuple[str, tuple[Result, ...]]:
    """Title and results of a check of a beam against a rule. aimed: first aim the lamp by its cut-off or maximum, as the regulation does.

    beam: by default that which the rule is for, low or high, or full where the lamp has none; without a rule its default beam. Raises
    LuxloopError for an unknown beam or rule, and where no rule is given for a beam that RULE_OF_BEAM does not list.
    """
    rules = None if rule is None else rule_set(rule)
    if rules is None and (beam or lamp.default_beam) not in RULE_OF_BEAM:
        why = f"{lamp.name} has no low beam, whose rule would be the default" if beam is None else f"no rule is known for beam {beam!r}"
        raise LuxloopError(f"{why}; name a rule with --rule, `luxloop headlight rules` lists them")
    if beam is None:
        wanted = "low" if rules is None or rules.beam == "low" else "high"
        beam = wanted if wanted in lamp.beams else "full"
    intensity = lamp.lit(lamp.beam(beam))
    rules = rules or rule_set(RULE_OF_BEAM[beam])
    turn = aim_beam(intensity, rules.id, traffic=traffic) if aimed else (0.0, 0.0)
    turned = f", aimed by {turn[0]:+.2f} deg to the right and {turn[1]:+.2f} deg up" if aimed else ""
    only = sum(module.headlight.n_pixels for module in lamp.modules) <= 1
    what = lamp.name if only else f"{lamp.name}, beam {beam}"
    return f"{what}: {rules.title}{turned}", check_beam(intensity, rules.id, aim=turn, traffic=traffic)


def kept(lamp: Lamp) -> list[str]:
    """One line for each of the lamp's beams in RULE_OF_BEAM: how many requirements of its rule the beam meets."""
    lines = []
    for beam in lamp.beams:
        if beam in RULE_OF_BEAM:
            asked = [each for each in judge(lamp, beam)[1] if each.verdict != "not applicable"]
            passed = sum(each.verdict == "pass" for each in asked)
            lines.append(f"{beam}: keeps {'all' if passed == len(asked) else passed} of {len(asked)} of {RULE_OF_BEAM[beam]}")
    return lines
