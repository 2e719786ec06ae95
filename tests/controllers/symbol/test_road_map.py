"""The road map: each look rates the heights that were drawn for it, and the best are kept."""

import math
from dataclasses import replace

import torch

from luxloop.controllers.symbol.heights.registration import Heights
from luxloop.controllers.symbol.heights.road_map import CHANGED, LEAST_DROP, PATIENCE, RoadMap
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.perception.birdseye import Region
from luxloop.world.caches import keeping
from luxloop.world.frames import pose


class Drawing:
    """Something new for each road."""

    def of(self, road_map: RoadMap) -> object:
        return object()


def projection(x_m: float) -> ProjectionCommand:
    return ProjectionCommand(torch.tensor([x_m, 0.0, 0.0, 0.0]))


def of_heights(before: RoadMap, height_m: float) -> RoadMap:
    """With other heights, and with the drawing for them shown."""
    heights = Heights(torch.full((4,), height_m), torch.ones(4), *torch.zeros(2, 4))
    changed = RoadMap(heights, torch.ones(4), before.region, before.grid, before.eye, drawn=before.drawn, kept=before.kept)
    return changed.showing(projection(17 + height_m))


def looked(road_map: RoadMap, height_m: float, residual: float, steps: int = 1) -> RoadMap:
    """After a look at what is drawn for a road of this height."""
    return of_heights(road_map, height_m).rate(residual, steps)


NOTHING = RoadMap(Heights(*torch.zeros(4, 4)), torch.ones(4), Region(15, 19, 1, -1), (2, 2), torch.tensor([2, 0, 1.2]))


def test_road_that_comes_into_the_region_is_as_bright_as_the_assumed_one():
    at_border = replace(NOTHING, brightness=torch.tensor([40.0, 1.0, 40.0, 1.0]))  # bright on the left
    turned = at_border.move(pose(torch.tensor([0.0, 1.0, 0.0]).double(), torch.eye(3).double()), at_border.eye)
    torch.testing.assert_close(turned.brightness, torch.tensor([1.0, 40.0, 1.0, 40.0]), rtol=0, atol=1.0)


def test_after_looks_that_are_no_better_the_best_heights_are_kept_until_their_own_light_says_that_the_road_changed():
    road_map = looked(NOTHING, 0.25, 0.01)
    for k in range(PATIENCE):
        assert road_map.kept is not None and not road_map.kept.done
        road_map = looked(road_map, 0.5 + k, 0.02)
    assert road_map.kept is not None and road_map.kept.done
    assert road_map.kept.best.road_map.heights.mean[0] == 0.25
    other = looked(road_map, 0.5, 2 * CHANGED)  # light for heights that were not kept
    assert other.kept is not None and other.kept.done
    for residual in (2 * CHANGED, math.inf):  # it explains less, or less than a flat road would
        changed = looked(road_map, 0.25, residual)
        assert changed.kept is not None and not changed.kept.done


def test_late_looks_end_the_search_after_as_many_steps():
    road_map = looked(looked(NOTHING, 0.25, 0.01), 0.5, 0.02, steps=PATIENCE)
    assert road_map.kept is not None and road_map.kept.done


def test_a_gain_within_the_noise_is_kept_but_does_not_prolong_the_search():
    road_map = looked(NOTHING, 0.25, 0.1)
    gained = looked(road_map, 0.5, 0.1 - LEAST_DROP / 2)
    assert gained.kept is not None and gained.kept.steps == 1
    assert gained.kept.best.road_map.heights.mean[0] == 0.5
    assert looked(gained, 0.5, 0.2).kept is gained.kept, "a further look at the best, before the search ends, tells its noise"
    assert looked(road_map, 0.5, 0.1 - 2 * LEAST_DROP).kept.steps == 0


def test_a_road_lies_as_before_until_its_heights_its_brightness_or_the_eye_are_others():
    before = of_heights(NOTHING, 0.25)
    drawing = Drawing()
    drawn = keeping(1, drawing.of)
    assert drawn(before.rate(0.01, 1).bare()) is drawn(before.bare())
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
        road_map = looked(road_map, 0.5, math.inf)
    assert road_map.kept is not None and road_map.kept.steps == 0


def test_the_same_drawing_stays_one_candidate():
    road_map = of_heights(NOTHING, 0.25)
    assert of_heights(road_map, 0.25).drawn is road_map.drawn
