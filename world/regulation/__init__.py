"""Headlamp regulations as numbers: test points and limits, and a beam judged by them. Second-hand figures, not for approval."""

from luxloop.world.regulation.aiming import aim_beam
from luxloop.world.regulation.checking import check_beam
from luxloop.world.regulation.results import Result, least_margin, passes
from luxloop.world.regulation.tables import Requirement, RuleSet, rule_set, sets

__all__ = ["Requirement", "Result", "RuleSet", "aim_beam", "check_beam", "least_margin", "passes", "rule_set", "sets"]
