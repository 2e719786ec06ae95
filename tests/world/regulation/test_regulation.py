"""The tables against the numbers they were taken from, and verdicts on light that is known in closed form or was measured."""

import json
import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from luxloop.world.regulation import Result, aim_beam, check_beam, least_margin, passes, rule_set
from luxloop.world.regulation.checking import inflection
from tests.refusal import refusal

Intensity = Callable[[Tensor], Tensor]


def field(of_angles: Callable[[Tensor, Tensor], Tensor]) -> Intensity:
    """Intensity as a function of h (right) and v (up) in deg."""

    def intensity(directions: Tensor) -> Tensor:
        x, y, z = directions
        return of_angles(torch.rad2deg(torch.atan2(-y, x)), torch.rad2deg(torch.atan2(z, torch.hypot(x, y))))

    return intensity


def uniform(cd: float) -> Intensity:
    return field(lambda h, v: torch.full_like(h, cd))


def rows(results: tuple[Result, ...]) -> dict[str, Result]:
    return {each.id: each for each in results}


def low_beam(v_cutoff_deg: float = -0.57, h_kink_deg: float = 0.0, decades_per_deg: float = 2.5) -> Intensity:
    """20 kcd below a cut-off with a shoulder of 15 deg, 200 cd above it, falling exponentially between."""

    def light(h: Tensor, v: Tensor) -> Tensor:
        edge = v_cutoff_deg + (h - h_kink_deg).clamp(0, 4) * math.tan(math.radians(15))
        return 10 ** (math.log10(2000) + decades_per_deg * (edge - v)).clamp(math.log10(200), math.log10(20_000))

    return field(light)


# The tables


def short(shared_id: str) -> str:
    name = shared_id.lower().replace("_adb_", "-").replace("_", "-")
    return name.replace("r149-01", "r149")


def test_tables_hold_the_shared_numbers(data_dir):
    shared = [json.loads((data_dir / "regulation" / f"{name}_points.json").read_text())["sets"] for name in ("ece_r149", "fmvss108")]
    for published in (each for group in shared for each in group):
        ours = {each.id: each for each in rule_set(short(published["id"])).requirements if each.kind != "flux"}
        assert set(ours) == {each["id"] for each in published["requirements"]}, published["id"]
        for theirs in published["requirements"]:
            requirement = ours[theirs["id"]]
            assert requirement.where == geometry(theirs), (published["id"], theirs["id"])
            if theirs["kind"] == "relative":
                assert (getattr(requirement, theirs["bound"]), requirement.of) == (theirs["factor"], theirs["of"])
            else:
                assert (requirement.min, requirement.max, requirement.kind) == (theirs.get("min"), theirs.get("max"), theirs["kind"])
            assert bool(requirement.only_if) == ("only_if" in theirs)


def geometry(published: dict[str, Any]) -> tuple[tuple[float, float], ...]:
    if "v" in published and "h" in published:
        return ((published["h"], published["v"]),)
    if "v" in published:
        h0, h1 = published["h0"], published["h1"]
        return ((-90 if h0 is None else h0, published["v"]), (90 if h1 is None else h1, published["v"]))
    if "region" in published:
        left, right, top = (published["region"][key] for key in ("h0", "h1", "v_max"))
        return ((left, top), (right, top), (right, -90), (left, -90))
    points = published.get("polygon") or published.get("points") or [published["point"]] if published["kind"] != "imax" else []
    return tuple(map(tuple, points))


def test_an_unknown_rule_names_its_neighbours():
    with refusal(r"'r149-passing-x'.*did you mean 'r149-passing"):
        rule_set("r149-passing-x")
    with refusal("known are fmvss108-lb1m, "):
        rule_set("jis-d-5500")


def test_ids_may_be_typed_loosely_and_r112_is_r149_of_the_00_series():
    assert rule_set("FMVSS108_LB2V").id == "fmvss108-lb2v"
    assert rule_set("r149-00-passing-b") == rule_set("r112-passing-b")


# Verdicts


def test_flux_is_integrated_and_counts_only_on_its_condition():
    found = rows(check_beam(uniform(1000.0), "r149-passing-c"))["Flux 15D to 1U"]
    solid_angle = math.radians(60) * (math.sin(math.radians(1)) + math.sin(math.radians(15)))
    assert found.value == pytest.approx(1000 * solid_angle, rel=1e-6)  # midpoint rule at 0.1 deg
    assert found.verdict == "not applicable" and found.note == "only if objective flux of the sources below 1000 lm"
    counted = rows(check_beam(uniform(1000.0), "r149-passing-c", conditional=True))["Flux 15D to 1U"]
    assert counted.verdict == "fail" and counted.margin == pytest.approx(1000 * solid_angle / 400 - 1, rel=1e-6)


def test_the_worst_point_of_a_ramp_is_at_the_end_of_its_segment_and_at_the_corner_of_its_zone():
    found = rows(check_beam(field(lambda h, v: 400 + 20 * h + 10 * v), "r149-passing-c"))
    assert found["Zone III"].where == pytest.approx((8, 4)) and found["Zone III"].value == pytest.approx(600)
    assert found["Segment 25"].where == pytest.approx((-9, -1.72)) and found["Segment 25"].value == pytest.approx(400 - 180 - 17.2)
    left = rows(check_beam(field(lambda h, v: 400 + 20 * h + 10 * v), "r149-passing-c", traffic="left"))
    assert left["P"].where == pytest.approx((7, 0)) and left["P"].value == pytest.approx(540)


def test_the_largest_intensity_is_found_between_samples_and_h_v_is_checked_by_it():
    peak = field(lambda h, v: 50_000 * torch.exp(-(((h - 0.513) / 2) ** 2) - ((v - 0.227) / 0.5) ** 2))
    found = rows(check_beam(peak, "r149-driving-a"))
    # Refined samples lie 0.01 deg apart: at most 0.005 deg off a peak that is 0.5 deg wide.
    assert found["Imax"].value == pytest.approx(50_000, rel=2e-4)
    assert found["Imax"].where == pytest.approx((0.513, 0.227), abs=0.01)
    assert found["H-V"].min == pytest.approx(40_000, rel=2e-4) and found["H-V"].verdict == "fail"
    turn = aim_beam(peak, "r149-driving-a")
    assert turn == pytest.approx((-0.513, -0.227), abs=0.02)
    assert rows(check_beam(peak, "r149-driving-a", aim=turn))["H-V"].verdict == "pass"


# The cut-off


def test_the_cut_off_is_found_at_its_height_and_as_sharp_as_it_is():
    v_deg, sharpness = inflection(low_beam(-0.8), -2.5, -0.57)
    assert sharpness == pytest.approx(0.25, abs=1e-9)
    assert v_deg == pytest.approx(-0.8, abs=0.05)  # the middle of one decade of constant slope, in steps of 0.05 deg
    checked = rows(check_beam(low_beam(), "r149-passing-c"))
    assert checked["Cut-off sharpness"].verdict == checked["Cut-off straightness"].verdict == "pass"
    assert rows(check_beam(low_beam(decades_per_deg=6), "r149-passing-c"))["Cut-off sharpness"].verdict == "fail"
    assert rows(check_beam(low_beam(h_kink_deg=-4), "r149-passing-c"))["Cut-off straightness"].verdict == "fail"


@pytest.mark.parametrize("traffic", ["right", "left"])
def test_a_lamp_is_aimed_by_its_cut_off(traffic):
    beam = low_beam(-0.9, 0.6)
    turned = beam if traffic == "right" else lambda d: beam(d * torch.tensor([[1.0], [-1.0], [1.0]]))
    turn = aim_beam(turned, "r149-passing-v", traffic=traffic)
    sign = 1 if traffic == "right" else -1
    # The scan's step is 0.05 deg, and the shoulder rises by 0.27 deg per deg. The beam fails at any aim: its foreground is too bright.
    assert turn == pytest.approx((-0.6 * sign, 0.33), abs=0.2)
    where = rows(check_beam(turned, "r149-passing-v", aim=turn, traffic=traffic))["Cut-off sharpness"].where
    assert where == pytest.approx((-2.5 * sign, -0.57), abs=0.05)


# A production headlamp


@pytest.mark.parametrize(("beam", "set_id"), [("upper_beam", "fmvss108-ub2"), ("lower_beam", "fmvss108-lb2v")])
def test_a_production_headlamp_passes_as_its_report_says(beam, set_id, data_dir):
    measured = json.loads((data_dir / "regulation" / "headlamp_measured_2016_ford_focus.json").read_text())[beam]
    points = torch.tensor(measured["rows"], dtype=torch.float64)

    def nearest(h: Tensor, v: Tensor) -> Tensor:
        """Only what was measured: elsewhere there is no number."""
        distance = (h[:, None] - points[:, 0]).abs() + (v[:, None] - points[:, 1]).abs()
        near = distance.min(1)
        return torch.where(near.values <= 0.05 + 1e-6, points[near.indices, 2], torch.nan)  # printed to 0.1 deg

    for requirement in rule_set(set_id).requirements:
        if requirement.kind == "point":
            (h, v) = torch.tensor(requirement.where, dtype=torch.float64).T
            value = float(nearest(h, v))
            assert (requirement.min or 0) <= value <= (requirement.max or math.inf), requirement.id
    failed = {(float(h), float(v)) for h, v, cd in points if beam == "lower_beam" and misses(set_id, float(h), float(v), float(cd))}
    assert failed == ({(-1.7, 0.5), (2.9, 0.5)} if beam == "lower_beam" else set())


def misses(set_id: str, h: float, v: float, cd: float) -> bool:
    """Whether a measured point lies on a line of the set and beyond its limits."""
    lines = [each for each in rule_set(set_id).requirements if each.kind == "segment"]
    on = [each for each in lines if abs(each.where[0][1] - v) < 0.01 and each.where[0][0] <= h <= each.where[1][0]]
    return any(not (each.min or 0) <= cd <= (each.max or math.inf) for each in on)


def test_a_beam_made_of_formulas_passes_class_b_of_r112_and_fails_class_c_where_it_should():
    assert passes(check_beam(low_beam(), "r112-passing-b"))
    failed = {each.id for each in check_beam(low_beam(), "r149-passing-c") if each.verdict == "fail"}
    assert failed == {"75R", "Segment 10 and below"}  # less light close below the cut-off than class C wants, too much in the foreground


def test_a_projections_unknown_limits_are_unknown_and_pass_nothing():
    results = check_beam(uniform(1.0), "r149-projection")
    assert {each.verdict for each in results} == {"unknown"} and all(math.isnan(each.value) for each in results)
    assert not passes(results) and least_margin(results) == math.inf


def test_a_projections_known_limit_holds_in_its_zone_alone():
    for cd, inside, verdict in ((215_000, True, "pass"), (215_001, True, "fail"), (300_000, False, "pass")):
        beam = field(lambda h, v, cd=cd, inside=inside: torch.where((v < -0.99) == inside, float(cd), 0.0).double())
        results = rows(check_beam(beam, "gb4599-projection"))
        assert results["Projection zone"].verdict == verdict and results["Place"].verdict == "not applicable"
        assert passes(tuple(results.values())) == (verdict == "pass")
