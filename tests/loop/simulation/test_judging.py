"""Whether light adds up on the road, and how bright it is on the heads of those who come towards the car."""

from typing import Any

import pytest
import torch

from luxloop.loop.recording.functions_summary import summarise
from luxloop.loop.recording.manifest import table_of
from luxloop.loop.recording.record import row, schema
from luxloop.loop.simulation.attribution import WHY, attribute
from luxloop.loop.simulation.detection import recognise
from luxloop.perception.detection.detector import Detections
from luxloop.perception.tracking import TrackedBoxes
from tests.loop.conftest import simulated, toml

COMING = toml("{ kind = 'car', name = 'coming', seed = 1, path = { points_m = [[30, 3.5, 0], [0, 3.5, 0]], speed_m_s = 10.0 } }")
AHEAD = toml("{ kind = 'car', name = 'ahead', seed = 1, path = { points_m = [[30, 0, 0], [90, 0, 0]], speed_m_s = 10.0 } }")
BAND = toml("{ kind = 'path', control_m = [[18.0, 0.0], [26.0, 0.0]], width_m = 3.0, quantity = 'E_v', value = 3.0 }")


LIT = """
name = "lit"
rate_hz = 10
renderer = "raycast"
headlight = { model = "ssl-hd", modules = ["lores", "hires"] }
camera = { width_px = 320, height_px = 180, pitch_deg = 1.5, oversampling = 1 }
detector.kind = "truth"
"""


def rows(steps: int, beam: str, **changes: Any) -> list[dict[str, Any]]:
    return [row(result) for result in simulated(LIT, f"steps={steps}", f"lighting.base.beam={beam}", **changes).evaluations()]


@pytest.mark.parametrize(("share", "least", "most"), [(True, 0.8, 1.15), (False, 1.5, 4.1)], ids=["shared", "each gives the whole"])
def test_four_modules_give_one_setpoint_unless_each_gives_the_whole(share, least, most):
    (one,) = rows(1, "low", functions={"band": BAND | {"share": share}})
    assert least < one["road_lx_ratio_max"] < most  # lores pixels miss by a tenth; two to four modules reach the band


def test_the_light_of_one_module_alone_adds_up_with_nothing():
    band = BAND | toml("{ control_m = [[18.0, -1.2], [18.0, 1.2]], width_m = 1.0, modules = ['left hires'], value = 12.0 }")
    (one,) = rows(1, "off", functions={"band": band})
    assert one["road_lx_ratio_max"] < 1, "a pixel that lies across the band's border lights all that its light reaches"


def test_what_two_lamps_share_on_a_pedestrian_adds_up_on_the_road_behind():
    aside = toml("{ kind = 'pedestrian', name = 'aside', seed = 5, track = [{ position_m = [10.0, 3.0, 0.0], yaw_deg = 90.0 }] }")
    light = toml("{ kind = 'object_based', method = 'constant', setpoint_lx = 6.0, share = 0.05 }")
    *_, last = rows(5, "low", objects=[aside], functions={"light": light})
    assert last["tracks"] == 1 and last["primitives"] > 0, "where only one of the lamps reaches the body, it gives the whole"
    assert 1.1 < last["road_lx_ratio_max"] < 2, "rays of both lamps through different places of the body meet on the road behind"


def test_oncoming_heads_count_from_three_tenths_of_a_second_on():
    lit = rows(6, "full", objects=[COMING, AHEAD])
    told = [each["oncoming_lx_max"] for each in lit]
    assert told[:3] == [None] * 3 and all(lx > 1 for lx in told[3:]), "near enough at once, and in full light"
    assert all(each["oncoming_lx_max"] is None for each in rows(5, "full", objects=[AHEAD]))


def counts(each: dict[str, Any]) -> dict[str, int]:
    return {why: count for why in WHY if (count := each[f"causes.{why}"])}


@pytest.mark.parametrize("found", [True, False])
def test_a_dazzled_head_is_new_then_tracked_or_not(found):
    simulation = simulated(
        LIT, "steps=6", "lighting.base.beam=full", "judge_causes=true", f"detector.least_height_px={12 if found else 150}", objects=[COMING]
    )
    lit = [row(result) for result in simulation.evaluations()]
    assert all(counts(each)["dazzled_new"] == 1 for each in lit[:3]), "for three tenths of a second"
    later = {"dazzled_tracked": 1} if found else {"dazzled_untracked": 1, "untracked_overlooked": 1}
    assert all(counts(each) == later for each in lit[3:])
    causes = summarise(table_of(lit, schema(simulation)), "lit", {}, {})["causes"]
    assert causes["dazzled_new"] == {"steps": 3, "count": 3} and causes["false_nothing"] == {"steps": 0, "count": 0}


def test_who_would_be_found_in_full_light_is_in_the_dark():
    walker = toml("{ kind = 'pedestrian', name = 'walker', seed = 5, track = [{ position_m = [9.0, 0.0, 0.0], yaw_deg = 90.0 }] }")
    camera = LIT.replace("width_px = 320, height_px = 180", "width_px = 640, height_px = 360").replace('"truth"', '"network"')
    simulation = simulated(camera, "steps=5", "lighting.base.beam=off", "judge_causes=true", "light.ambient_lx=0.001", objects=[walker])
    *_, last = (row(result) for result in simulation.evaluations())
    assert counts(last) == {"untracked_dark": 1}


def test_a_false_track_is_a_double_a_part_or_nothing():
    view = simulated(LIT, objects=[COMING | {"path": AHEAD["path"]}]).world.lit(0.0)
    left, top, right, bottom = view.boxes[0].tolist()
    inner = [left, top, left + 0.4 * (right - left), top + 0.4 * (bottom - top)]
    boxes = torch.tensor([[left, top, right, bottom], [left + 1, top, right, bottom], inner, [0, 0, right - left, bottom - top]]).double()
    none, classes = Detections(torch.zeros(0, 4), torch.zeros(0, 1)), ("car",)
    tracks = TrackedBoxes.of(torch.arange(1, 5), Detections(boxes, torch.ones(4, 1)), torch.zeros(4))
    causes = attribute(view, recognise(view, tracks, none, classes), tracks, {}, {}, lambda: none)
    assert {why: count for why, count in causes.items() if count} == {"false_double": 1, "false_part": 1, "false_nothing": 1}
