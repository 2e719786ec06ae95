"""The closed loop of many copies at once; copies differ in numbers, and masks select what only some of them do."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from luxloop.controllers.symbol.sensing.field import cut
from luxloop.controllers.symbol.sensing.projection import ProjectionCommand
from luxloop.controllers.symbol.sensing.protocol import Observation, Projection
from luxloop.controllers.symbol.sensing.symbol_sensor import Measurement
from luxloop.controllers.symbol.stages import Lifting
from luxloop.loop.scenario.model import Scenario
from luxloop.loop.simulation.controlled import ControlledSymbol
from luxloop.loop.studies.batch.arrivals import Arrival, arrivals
from luxloop.loop.studies.batch.copies import Copies
from luxloop.loop.studies.batch.laws import asking, asks, law_of, rows
from luxloop.loop.studies.batch.looking import Taken, at_ends
from luxloop.loop.studies.batch.searching import finds_another_road
from luxloop.perception.extraction import ExtractionStatus
from luxloop.perception.metrics import Metrics

Copy = tuple[Scenario, ControlledSymbol]


@dataclass(frozen=True, eq=False)
class Course:
    """One step of B copies. projection: what is shown. measurement: of the newest frames that came. cut: `[B, 4]`, see
    `luxloop.controllers.symbol.sensing.field`. sums: `[B, m, 2]`, see `Light`. verdict: None where nobody judges.
    """

    projection: ProjectionCommand
    measurement: Measurement
    cut: Tensor
    sums: Tensor
    verdict: Metrics | None


@dataclass(frozen=True)
class Courses:
    """All steps of B copies. left: those for which a single run searches the whole image in some step, so that it may go on otherwise."""

    steps: list[Course]
    left: frozenset[int]


@dataclass(frozen=True, eq=False)
class _Look:
    """What the frames of a step show. searched: of which copies a single run would search the image and may find something. features:
    `[B, 4]` that a flat road would show, None where no law asks for them.
    """

    seen: Measurement
    searched: Sequence[bool]
    features: Tensor | None


def course_of(copies: Copies, given: Sequence[Copy]) -> Courses:
    """Run all copies. given: scenario and symbol of each, of the same world and number of steps, with laws of one shape (`shape_of`)."""
    scenarios, symbols = [each for each, _ in given], [each for _, each in given]
    law, target, like = law_of([each.controller for each in symbols]), copies.projector.target, scenarios[0]
    lifted = any(isinstance(each.controller, Lifting) for each in symbols)
    state = law.start(torch.stack([each.function.start_pose.pose for each in symbols]).to(target))
    plans, looks, steps, left = [arrivals(each) for each in scenarios], list[_Look](), list[Course](), set[int]()
    for step in range(like.steps):
        projection = law.projection(state, None)
        light = copies.show(projection)
        frames = [Taken(each.seed, step, each.disturbances) for each in scenarios]
        seen = copies.measured(light, frames)
        searched = (seen.code != ExtractionStatus.SEEN).tolist()
        if lifted and light.scene is not None:
            for k in at_ends(seen, light.scene.windows).nonzero()[:, 0].tolist():
                searched[k] = searched[k] or k in left or finds_another_road(copies, light, k, frames[k])
        looks.append(_Look(replace(seen, symbol=seen.symbol[:, :0, :0]), searched, copies.rendered(light) if asks(law) else None))
        came = [each[step] for each in plans]
        measurement, features = _gathered(copies, looks, [each[0] for each in came], projection.pose)
        stepped = asking(law, features).step(state, Observation(measurement, None, Projection(projection, ())))
        for turn in range(1, max(map(len, came))):  # of cameras whose latency varies, several may come at once
            at = [each[turn] if turn < len(each) else None for each in came]
            later, features = _gathered(copies, looks, at, projection.pose)
            there = torch.tensor([turn < len(each) for each in came], device=target.device)
            measurement = rows(there, later, measurement)
            stepped = rows(there, asking(law, features).step(stepped, Observation(later, None, Projection(projection, ()))), stepped)
        state = stepped
        left |= {k for k, each in enumerate(came) for of in each if of is not None and looks[of].searched[k]}
        verdict = copies.judged(light) if like.judge_every and step % like.judge_every == 0 else None
        steps.append(Course(projection, measurement, cut(copies.projector, projection), light.sums, verdict))
    return Courses(steps, frozenset(left))


def _gathered(copies: Copies, looks: Sequence[_Look], at: Sequence[Arrival], pose: Tensor) -> tuple[Measurement, Tensor | None]:
    """What the frames of some step of each copy show, and `_Look.features`; lost where there are none."""
    lost = copies.sensor.lost(pose, ExtractionStatus.NO_FRAME)
    steps = [each for each in dict.fromkeys(at) if each is not None]
    found = lost, None if looks[-1].features is None else torch.full_like(pose, torch.nan)
    for each in steps:
        chosen = torch.tensor([of == each for of in at], device=pose.device)
        new = looks[each].seen, looks[each].features
        found = rows(chosen, new[0], found[0]), None if new[1] is None else rows(chosen, new[1], found[1])
    return found
