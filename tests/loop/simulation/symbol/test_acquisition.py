"""The road's shape from where in the whole image the symbol is: against closed forms, and in worlds where it is far from its place."""

import pytest
import torch
from torch import Tensor

from luxloop import ExtractionStatus, ProjectionCommand, Simulation, load
from luxloop.controllers.symbol.sensing.relocalisation import Relocalisation
from luxloop.controllers.symbol.sensing.road_shape import ray_lengths
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import frames_of, simulation_of

SMALL = [
    f"headlight.model={SMALL_LAMP}",
    "camera={width_px=640, height_px=480}",
    "functions.symbol.start={x_m=17.0, y_m=0.0, roll_deg=0.0, pitch_deg=0.0}",
    "functions.symbol.controller={name='open'}",
]
FLAT = "{kind='flat'}"


def grade(percent: float, crossfall: float = 0.0) -> str:
    return f"{{kind='grade', grade_percent={percent}, crossfall_percent={crossfall}, start_x_m=3.0}}"


def simulation(road: str, *more: str) -> Simulation:
    return simulation_of(load("snowflake", [*SMALL, f"road={road}", *more]))


def shown_at_target(prepared: Simulation) -> tuple[Tensor, Tensor]:
    lights = prepared.symbol.projector.light(prepared.symbol.projector.target)
    frames = frames_of(prepared.plant, lights)
    assert frames is not None
    return frames


def acquired(road: str, *more: str) -> Relocalisation:
    prepared = simulation(road, *more)
    projector = prepared.symbol.projector
    return prepared.symbol.sensor.relocalise(shown_at_target(prepared), projector.light(projector.target))


def test_a_ray_meets_the_road_where_the_quadratic_is_solved():
    shapes = torch.tensor([[0.2, 0.01, -0.02, 0.002], [-0.3, -0.03, 0.0, 0.0], [0.0, 0.0, 0.0, -0.004]], dtype=torch.float64)
    origin, rays = torch.tensor([0.0, 0.6, 0.75]).double(), torch.tensor([[1.0, 1.0], [0.01, -0.03], [-0.05, -0.06]]).double()
    points = origin[:, None, None] + rays[:, None] * ray_lengths(shapes, 17.0, origin, rays)
    x, y, z = points
    a, b, c, d = shapes.T[..., None]
    torch.testing.assert_close(z, a + b * (x - 17) + c * y + d * (x - 17) ** 2 / 2, rtol=0, atol=1e-9)  # rounding
    assert ray_lengths(shapes, 17.0, origin, torch.tensor([[1.0], [0.0], [0.05]]).double())[2].isinf().all(), "no way down"


@pytest.mark.parametrize(("percent", "crossfall"), [(-2.0, 0.0), (-1.0, 2.0), (1.0, -2.0), (3.0, 0.0), (4.0, 2.0)])
def test_the_shape_of_a_grade_is_found_where_its_light_is(percent, crossfall):
    prepared, found = simulation(grade(percent, crossfall)), acquired(grade(percent, crossfall))
    assert found.found
    lamp = prepared.symbol.projector.modules[0].T_body_headlight[:3, 3]
    way = torch.tensor([[17.0], [0.0], [0.0]]) - lamp[:, None]
    x, y, z = (lamp[:, None] + way * ray_lengths(found.shape[None], 17.0, lamp, way)[0])[:, 0].tolist()
    # the height at which the middle ray is met: half a camera row is 1 cm of height there
    assert z == pytest.approx(float(prepared.scenario.road.z(x, y)), abs=0.015)


def test_a_flat_road_is_found_to_be_flat():
    found = acquired(FLAT)
    assert not found.found and found.match > 0.9
    assert found.match - found.flat < 0.02  # what is tried last are steps of 1 mm and 0.2 per mille


def test_one_bright_place_hides_no_area_of_the_light_around_it():
    prepared = simulation(FLAT)
    projector, acquisition = prepared.symbol.projector, prepared.symbol.sensor.relocaliser
    (texture,) = projector.textures(projector.light(projector.target))
    spotted, (row, col) = texture.clone(), divmod(int(texture.argmax()), texture.shape[-1])
    spotted[row : row + 4, col : col + 4] *= 5  # as where a patch is dimmed all but at its border
    even, uneven = (acquisition.area(torch.zeros(4), [light]) for light in (texture, spotted))
    assert even > 900
    torch.testing.assert_close(uneven, even, rtol=0.05, atol=0)  # edges of strokes that are dim


@pytest.mark.parametrize(
    "disturbance",
    ["oncoming=[{position_m=[40, 2, 0.65], intensity_cd=500, frames='on'}]", "ambient=[{factor=4, frames='on'}]", "noise=[{factor=10}]"],
)
def test_what_is_no_symbol_is_not_taken_for_it(disturbance):
    prepared = simulation(FLAT, f"disturbances.{disturbance}")
    lights = prepared.symbol.projector.light(prepared.symbol.projector.target)
    frames = frames_of(prepared.plant, [type(light)(torch.zeros_like(light.u)) for light in lights])
    assert frames is not None and not prepared.symbol.sensor.relocalise(frames, lights).found


def test_a_symbol_that_is_plainly_in_the_image_is_never_lost():
    for percent in (-2.0, 3.0, 4.0):
        prepared = simulation(grade(percent))
        sensor, projection, frames = prepared.symbol.sensor, ProjectionCommand(prepared.symbol.projector.target), shown_at_target(prepared)
        lights = sensor.projector.light(projection.pose)
        seen = sensor.measure(frames, projection, lights)
        again = sensor.measure(frames, projection, lights, seen.shape)
        assert seen.code == again.code == ExtractionStatus.SEEN, percent
        assert again.acquired is None, "once found it is looked for where it was"


@pytest.mark.parametrize(("percent", "least"), [(-2.0, 0.72), (2.0, 0.90), (4.0, 0.85)])
def test_two_looks_lay_the_symbol_straight_on_a_grade(percent, least):
    """As well as exact inverse ray tracing onto the true road does, which leaves the light of near parts as bright as it is."""
    changes = [*SMALL[:2], f"road={grade(percent)}", "functions.symbol.controller={name='luxloop'}"]
    *_, last = simulation_of(load("snowflake", changes, steps=4)).evaluations()
    assert float(last.symbol.metrics.iou) > least - 0.01


def test_a_road_guessed_from_a_start_aside_is_sought_again():
    """From there, chevrons lie as on a road that leans by 5 %; the second search finds a low road, on which registration begins flat."""
    start = "functions.symbol.start={x_m=18.35, y_m=-0.71, roll_deg=3.25, pitch_deg=1.97}"
    own = ["functions.symbol.controller={name='luxloop'}", "functions.symbol.image=chevrons", "camera.height_px=360", "steps=7", "seed=102"]
    ious = [float(each.symbol.metrics.iou) for each in simulation("{kind='mixed', seed=84770}", start, *own).evaluations()]
    assert ious[-1] > 0.9  # 0.63 on the leaning road
