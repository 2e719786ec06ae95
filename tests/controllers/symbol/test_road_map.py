"""The road map: each look rates the heights that were drawn for it, and the best are kept."""

import math
from dataclasses import replace

import torch

from luxloop.controllers.symbol.heights.registration import Heights
from luxloop.controllers.symbol.heights.road_map import CHANGED, PATIENCE, RoadMap
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.perception.birdseye import Region
from luxloop.world.caches import keeping
from luxloop.world.frames import pose


class Drawing:
    """Something new for each road."""

    def of(self, road_map: RoadMap) -> object:
        return object()


IN_FLIGHT = 4  # projections of which observations may still come


def projection(x_m: float) -> ProjectionCommand:
    return ProjectionCommand(torch.tensor([x_m, 0.0, 0.0, 0.0]))


def of_heights(before: RoadMap, height_m: float) -> RoadMap:
    """With other heights, and with the drawing for them shown."""
    heights = Heights(torch.full((4,), height_m), torch.ones(4), *torch.zeros(2, 4))
    changed = RoadMap(heights, torch.ones(4), before.region, before.grid, before.eye, drawn=before.drawn, kept=before.kept)
    return changed.showing(projection(17 + height_m), IN_FLIGHT)


def looked(road_map: RoadMap, height_m: float, residual: float) -> RoadMap:
    """After a look at what was drawn for a road of this height."""
    drawn = road_map.candidate_of(projection(17 + height_m))
    assert drawn.heights.mean[0] == height_m
    return road_map.rate(drawn, residual)


NOTHING = RoadMap(Heights(*torch.zeros(4, 4)), torch.ones(4), Region(15, 19, 1, -1), (2, 2), torch.tensor([2, 0, 1.2]))


def test_road_that_comes_into_the_region_is_as_bright_as_the_assumed_one():
    at_border = replace(NOTHING, brightness=torch.tensor([40.0, 1.0, 40.0, 1.0]))  # bright on the left
    turned = at_border.move(pose(torch.tensor([0.0, 1.0, 0.0]).double(), torch.eye(3).double()), at_border.eye)
    torch.testing.assert_close(turned.brightness, torch.tensor([1.0, 40.0, 1.0, 40.0]), rtol=0, atol=1.0)


def test_a_late_look_rates_the_heights_that_it_shows():
    road_map = of_heights(of_heights(of_heights(NOTHING, 0.25), 0.5), 0.75)
    road_map = looked(road_map, 0.25, 0.02)
    road_map = looked(road_map, 0.5, 0.01)
    road_map = looked(road_map, 0.75, 0.03)
    assert road_map.kept.best.heights.mean[0] == 0.5
    assert road_map.candidate_of(projection(1.0)) is None


def test_after_looks_that_are_no_better_the_best_heights_are_kept_until_their_own_light_says_that_the_road_changed():
    road_map = looked(of_heights(of_heights(NOTHING, 0.25), 0.5), 0.25, 0.01)
    for _ in range(PATIENCE):
        assert road_map.kept is not None and not road_map.kept.done
        road_map = looked(road_map, 0.5, 0.02)
    assert road_map.kept is not None and road_map.kept.done
    late = looked(road_map, 0.5, 2 * CHANGED * 0.01)  # light for heights that were not kept
    assert late.kept is not None and late.kept.done
    for residual in (2 * CHANGED * 0.01, math.inf):  # it explains less, or less than a flat road would
        changed = looked(road_map, 0.25, residual)
        assert changed.kept is not None and not changed.kept.done


def test_a_road_lies_as_before_until_its_heights_its_brightness_or_the_eye_are_others():
    before = of_heights(NOTHING, 0.25)
    drawing = Drawing()
    drawn = keeping(1, drawing.of)
    assert drawn(looked(before, 0.25, 0.01).bare()) is drawn(before.bare())
    others = (
        replace(before, brightness=torch.ones(4)),
        replace(before, eye=before.eye.clone()),
        replace(before, T_ground_plane=torch.eye(4)),
    )
    for other in (of_heights(before, 0.25), *others):
        assert drawn(other.bare()) is not drawn(before.bare())


def test_looks_that_heights_explain_less_than_a_flat_road_do_not_count():
    road_map = of_heights(NOTHING, 0.25)
    assert looked(road_map, 0.25, math.inf).kept is None
    road_map = looked(road_map, 0.25, 0.01)
    for _ in range(2 * PATIENCE):
        road_map = looked(road_map, 0.25, math.inf)
    assert road_map.kept is not None and road_map.kept.observations == 0


def test_the_same_drawing_is_remembered_once_and_old_ones_are_forgotten():
    road_map = of_heights(of_heights(NOTHING, 0.25), 0.25)
    assert len(road_map.drawn) == 1
    for k in range(2, 2 * IN_FLIGHT):
        road_map = of_heights(road_map, k / 4)
    assert len(road_map.drawn) == IN_FLIGHT
    assert road_map.candidate_of(projection(17.25)) is None
