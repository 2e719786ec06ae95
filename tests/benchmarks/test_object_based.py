"""The table of object-based lighting: scenes that nobody learnt from, measures that follow from runs, a page that says what was missed."""

import math
from typing import Any

import numpy as np
import object_based_cases
import object_based_goals as goals
import object_based_page
import object_based_parts
import pytest
import torch

LAMPS = {
    "low beam": {"flux_lm": 400.0, "watts": 20.0},
    "high beam": {"flux_lm": 1000.0, "watts": 35.0},
    "full light": {"flux_lm": 6000.0, "watts": 160.0},
}


def run(flux_lm: list[float], scores: dict[str, float], **other: Any) -> dict[str, Any]:
    names = {"tracked": dict.fromkeys(scores, 1.0), "found": dict.fromkeys(scores, 2)}
    base = {"watts": [10.0] * 105, "eyes_lx": [5.0] * 30 + [0.4] * 75, "newcomer_lx": [0.0] * 30, "dazzled": [], "searches": []}
    return {"flux_lm": flux_lm, "scores": scores, **names, **base, **other}


def measured(own: dict[str, Any], full: dict[str, float]) -> dict[str, Any]:
    beams = {"low beam": [dict.fromkeys(full, 0.0)], "high beam": [full], "full light": [full]}
    rows = goals.measures({"scene": 0, "moving": False}, {"lamps": LAMPS, "beams": beams, "runs": {"luxloop": [own]}})
    assert [row["variant"] for row in rows] == ["luxloop", "low beam", "high beam", "full light"]
    assert [row["kept"] for row in rows[1:]] == ([None] * 3 if max(full.values()) < goals.FOUND else [False, True, True])
    return rows[0]


def test_light_is_saved_against_beams_and_kept_against_full_light() -> None:
    own = run([400.0] * 60 + [40.0] * 45, {"a": 0.56, "b": 0.25, "faint": 0.0})
    found = measured(own, {"a": 0.6, "b": 0.55, "faint": 0.2})
    assert (found["saved_low"], found["saved_high"], found["watts_saved"]) == pytest.approx((0.9, 0.96, 10.0))
    assert (found["objects"], found["objects_kept"], found["kept"]) == (2, 1, False)
    assert found["gap"] == pytest.approx(0.3)
    assert found["eyes_lx"] == 0.4, "the first second does not count"
    assert measured(own, {"a": 0.6, "b": 0.27, "faint": 0.2})["kept"]
    assert measured(own, {"a": 0.2, "b": 0.27, "faint": 0.2})["kept"] is None


def test_frames_that_dazzle_count_once_and_after_the_first_second() -> None:
    late = [(40, "a", 2.0, True), (40, "b", 3.0, False), (41, "b", 3.0, False)]
    own = run([40.0] * 105, {"a": 0.6}, dazzled=[(5, "a", 2.0, True), *late])
    found = measured(own, {"a": 0.6})
    assert (found["dazzled"], found["dazzled_tracked"]) == (2 / 75, 1 / 75)


def test_what_is_lost_had_been_found() -> None:
    own = run([40.0] * 105, {"a": 0.0, "b": 0.0}, tracked={"a": 0.4, "b": 0.0}, found={"a": 5, "b": None})
    found = measured(own, {"a": 0.6, "b": 0.55})
    assert (found["lost"], found["never_found"]) == (1, 1)


def test_flux_has_settled_when_it_stays_near_its_end() -> None:
    flux = np.array([100.0] * 20 + [1.0] * 10 + [30.0] + [2.0] * 44)
    assert goals.settle_step(flux, 5.0) == 31
    assert goals.settle_step(flux, 50.0) == 20
    assert goals.settle_step(np.full(75, 3.0), 1.0) == 0


def test_searches_are_those_of_who_is_found_early() -> None:
    found = goals.searches_s({"searches": [[2, 32], [3, None], [40, 50]]})
    assert found == [1.0, None]
    row = {"variant": "luxloop", "moving": False, "searches_s": found}
    assert goals._searched([row] * 20) == math.inf
    assert goals._searched([row | {"searches_s": [1.0] * 19}, row]) == 1.0  # one of 21 is less than a tenth


def test_a_newcomer_is_lit_once_it_is_known_and_gets_half_of_its_light() -> None:
    lx = [0.1] * 3 + [4.0] + [9.0] * 26
    come = goals.COMES
    assert goals.newcomer_s({"found": {"newcomer": come + 2}, "newcomer_lx": lx}) == pytest.approx(4 / 30)
    assert goals.newcomer_s({"found": {"newcomer": come + 6}, "newcomer_lx": lx}) == pytest.approx(7 / 30), "light there by chance is none"
    assert goals.newcomer_s({"found": {"newcomer": None}, "newcomer_lx": lx}) is None
    assert goals.newcomer_s({"found": {"newcomer": come + 2}, "newcomer_lx": [0.0] * 30}) is None, "no light is not half of none"


def test_zones_count_the_steps_until_they_stay() -> None:
    luminance = [0.1, 0.9, 0.5, 0.87, 0.9, 0.91]
    (row,) = goals.zone_rows([{"saturation_e": 8000.0, "zones": [{"reflectance": 0.2, "luminance": luminance}]}])
    assert row["steps"] == 3 and row["error"] == pytest.approx(0.01 / 0.9)


def test_an_identity_switches_between_numbers_and_not_at_gaps() -> None:
    found = object_based_parts._identity([None, 1, 1, None, 1, 2, None, 2, 1])
    assert found == {"switches": 2, "frames": 9, "found": 8, "lost": 2}


def test_a_track_stays_an_objects_while_it_overlaps() -> None:
    crossed = torch.tensor([[0.5, 0.8], [0.7, 0.4]])
    assert object_based_parts.matched({"a": 7, "b": 9}, ["a", "b"], [7, 9], crossed) == {"a": 7, "b": 9}
    assert object_based_parts.matched({}, ["a", "b"], [7, 9], crossed) == {"a": 9, "b": 7}
    apart = torch.tensor([[0.1, 0.8], [0.7, 0.0]])
    assert object_based_parts.matched({"a": 7, "b": 9}, ["a", "b"], [7, 9], apart) == {"a": 9, "b": 7}
    assert object_based_parts.matched({"a": 7}, ["a", "b"], [9], torch.tensor([[0.1], [0.2]])) == {}


def test_goals_are_missed_where_only_one_of_both_is_reached() -> None:
    rows = [{"variant": "luxloop", "moving": k % 2 == 1, "objects": 1, "saved_low": 0.99, "kept": False, "lost": 1} for k in range(4)]
    rows = [row | {"settle_s": 1.0, "newcomer": False, "newcomer_s": None, "eyes_lx": None, "searches_s": []} for row in rows]
    page = object_based_page.goals(goals.Measured(rows, [], []))
    assert "at least 85 % | 99.0% | reached" in page and "of the runs | 0.0% | **missed**" in page
    assert "newcomer lit within 0.5 s, at least 90 % | – | not measured" in page
    endless = object_based_page.goals(goals.Measured([row | {"searches_s": [None]} for row in rows], [], []))
    assert "90 % quantile | never | **missed**" in endless


def test_scenes_are_others_than_those_of_training_and_newcomers_have_room() -> None:
    from luxloop.loop.studies.training import scenes

    assert object_based_cases.FIRST > scenes.HELD_OUT + 100_000 > scenes.TRAINING
    case = list(object_based_cases.cases(2, 1))[1]
    assert case.moving and case.parameters["seeds"]["luxloop"] == 1
    given = object_based_cases.lit(case.scenario)
    newcomer, *others = (each.pose_track().pose_at(2.5)[:2, 3] for each in given.all_objects)
    assert len(others) > 2 and all(float((newcomer - other).norm()) > object_based_cases.FREE_M for other in others)


def test_the_jobs_run_through_the_whole_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a few steps each, which judge nothing, over both base beams."""
    for name, value in {"STEPS": 4, "COMES": 2, "END": range(1, 2), "LATE": range(3, 4)}.items():
        monkeypatch.setattr(object_based_cases, name, value)
    (case,) = object_based_cases.cases(1, 1)
    given = case.parameters
    variants = {name: given["variants"][name] for name in ("luxloop", "over the low beam")}
    found = object_based_cases.illuminated(given["scenario"], variants, dict.fromkeys(variants, 1))
    ((own,), (low,)) = (found["runs"][name] for name in variants)
    assert low["flux_lm"][0] > 2 * own["flux_lm"][0] and len(low["flux_lm"]) == 2, "an undimmed low beam, up to the newcomer"
    assert len(own["flux_lm"]) == 4 and len(own["newcomer_lx"]) == 2
    assert 0 < own["flux_lm"][-1] < found["lamps"]["high beam"]["flux_lm"] < found["lamps"]["full light"]["flux_lm"]
    jobs = list(object_based_parts.track_jobs(seeds=1, times=1, steps=2))
    assert len({job.key for job in jobs}) == 4 and all(object_based_cases.lit(job.parameters["scenario"]) for job in jobs)
    (objects,) = object_based_parts.tracked(**jobs[0].parameters)["objects"]
    assert [each["frames"] for each in objects] == [2, 2]


def test_a_lamp_with_less_overlap_gives_nearly_the_same_frame() -> None:
    (job,) = object_based_parts.pair_jobs(1)
    simulation = object_based_parts.Simulation.prepare(object_based_cases.lit(job.parameters["scenario"]))
    whole, reduced = (object_based_parts._frame(each) for each in (simulation, object_based_parts._with_less_overlap(simulation)))
    apart = object_based_parts._apart(whole, reduced)
    assert 0 < apart["mae"] < 1e-3 and not apart["alone"]
