"""Road memory: heights are judged by looks at what was drawn for them, and the best are kept."""

import math

import torch

from controllers.symbol.heights.memory import CHANGED, PATIENCE, Memory
from controllers.symbol.heights.registration import Heights
from controllers.symbol.sensing.drawing import Drawing
from perception.birdseye import Region

IN_FLIGHT = 4  # drawings of which looks may still come


def drawing(x_m: float) -> Drawing:
    return Drawing(torch.tensor([x_m, 0.0, 0.0, 0.0]))


def of_heights(before: Memory, height_m: float) -> Memory:
    """With other heights, and with the drawing for them shown."""
    heights = Heights(torch.full((4,), height_m), torch.eye(4), torch.zeros(4))
    changed = Memory(heights, torch.ones(4), before.region, before.grid, before.eye, drawn=before.drawn, kept=before.kept)
    return changed.showing(drawing(17 + height_m), IN_FLIGHT)


def looked(memory: Memory, height_m: float, residual: float) -> Memory:
    """After a look at what was drawn for a road of this height."""
    drawn = memory.shown(drawing(17 + height_m))
    assert drawn is not None
    assert drawn.heights.mean[0] == height_m
    return memory.judged(drawn, residual)


NOTHING = Memory(
    Heights(torch.zeros(4), torch.zeros(4, 4), torch.zeros(4)), torch.ones(4), Region(15, 19, 1, -1), (2, 2), torch.tensor([2, 0, 1.2])
)


def test_a_late_look_judges_the_heights_that_it_shows() -> None:
    memory = of_heights(of_heights(of_heights(NOTHING, 0.25), 0.5), 0.75)
    memory = looked(memory, 0.25, 0.02)
    memory = looked(memory, 0.5, 0.01)
    memory = looked(memory, 0.75, 0.03)
    assert memory.kept is not None
    assert memory.kept.best.heights.mean[0] == 0.5
    assert memory.shown(drawing(1.0)) is None


def test_after_looks_that_are_no_better_the_best_heights_are_kept_until_their_own_light_says_that_the_road_changed() -> None:
    memory = looked(of_heights(of_heights(NOTHING, 0.25), 0.5), 0.25, 0.01)
    for _ in range(PATIENCE):
        assert memory.kept is not None and not memory.kept.done
        memory = looked(memory, 0.5, 0.02)
    assert memory.kept is not None and memory.kept.done
    late = looked(memory, 0.5, 2 * CHANGED * 0.01)  # light for heights that were not kept
    assert late.kept is not None and late.kept.done
    for residual in (2 * CHANGED * 0.01, math.inf):  # it explains less, or less than a flat road would
        changed = looked(memory, 0.25, residual)
        assert changed.kept is not None and not changed.kept.done


def test_looks_that_heights_explain_less_than_a_flat_road_do_not_count() -> None:
    memory = of_heights(NOTHING, 0.25)
    assert looked(memory, 0.25, math.inf).kept is None
    memory = looked(memory, 0.25, 0.01)
    for _ in range(2 * PATIENCE):
        memory = looked(memory, 0.25, math.inf)
    assert memory.kept is not None and memory.kept.looks == 0


def test_the_same_drawing_is_remembered_once_and_old_ones_are_forgotten() -> None:
    memory = of_heights(of_heights(NOTHING, 0.25), 0.25)
    assert len(memory.drawn) == 1
    for k in range(2, 2 * IN_FLIGHT):
        memory = of_heights(memory, k / 4)
    assert len(memory.drawn) == IN_FLIGHT
    assert memory.shown(drawing(17.25)) is None
