"""Headlamp regulations as numbers: test points and limits, and a beam judged by them. Second-hand figures, not for approval."""

from world.regulation.aiming import aim
from world.regulation.checking import check
from world.regulation.results import Result, least_margin, passes
from world.regulation.tables import Requirement, RuleSet, rule_set, sets

__all__ = ["Requirement", "Result", "RuleSet", "aim", "check", "least_margin", "passes", "rule_set", "sets"]
