"""Headlamp regulations as numbers: test points and limits, and a beam checked by them. Second-hand figures, not for approval."""

from luxloop.world.regulation.checking import aim_beam, check_beam
from luxloop.world.regulation.tables import Requirement, Result, RuleSet, beam_rules, least_margin, passes, rule_set, sets

__all__ = ["Requirement", "Result", "RuleSet", "aim_beam", "beam_rules", "check_beam", "least_margin", "passes", "rule_set", "sets"]
