"""The loop in a car that drives: what lamps, camera and evaluator see of it."""

import math

import pytest
import torch
from torch import Tensor

from luxloop import Ego, Observation, ProjectionCommand, Scenario, Simulation, validate
from luxloop.loop.simulation.result import StepResult
from luxloop.world.frames import inverse, transform
from tests.loop.conftest import SMALL, simulation_of, toml

SYMBOL = SMALL["functions"]["symbol"] | toml("{ controller.name = 'open', start = {} }")
OPEN = {"functions": {"symbol": SYMBOL}, "steps": 3, "renderer": "auto"}
LATE = toml("{ wheels = { delay_s = 0.03, scale = 1.1 }, gyro.delay_s = 0.03, suspension.delay_s = 0.03 }")  # a step of 33 ms
PITCH_DEG, RATE_HZ = 0.3, 7.5  # down at the second step, up at the fourth


def driving(**changes: object) -> Scenario:
    return validate(SMALL | OPEN | changes, "driving")


def run(**changes: object) -> list[StepResult]:
    return list(simulation_of(driving(**changes)).evaluations())


@pytest.fixture(scope="module")
def nodding() -> Simulation:
    """A car that drives on a flat road and nods."""
    vehicle = {"course": [{"speed_m_s": 20.0}], "oscillation": {"pitch_deg": PITCH_DEG, "rate_hz": RATE_HZ}}
    return simulation_of(driving(vehicle=vehicle, sensors=LATE, steps=4))


def test_a_flat_road_looks_the_same_from_a_car_that_drives_smoothly():
    (standing,) = run(steps=1)
    for now in run(vehicle={"course": [{"speed_m_s": 20.0}]}):
        # the road's triangles lie in one plane, but float32 in another order and snapped corners remain
        assert (standing.symbol.metrics.centroid_percent - now.symbol.metrics.centroid_percent).abs().max() < 0.1
        assert abs(float(standing.symbol.metrics.iou - now.symbol.metrics.iou)) < 0.01 and float(now.symbol.metrics.iou) > 0.97


def test_a_nose_that_goes_down_brings_the_symbol_nearer(nodding):
    at = [float(result.symbol.metrics.centroid_percent[0]) for result in nodding.evaluations()]
    pitch, to_lamp = math.radians(PITCH_DEG), 2.2
    for sign, seen in ((1, at[1]), (-1, at[3])):
        height = 0.75 - sign * to_lamp * pitch
        centre = height / math.tan(math.atan(0.75 / 17) + sign * pitch)
        # the symbol also shrinks or grows about its middle ray, which moves its centroid by a tenth of the shift at most
        assert seen == pytest.approx(100 * (centre - 17) / 4, rel=0.1)
    assert abs(at[0]) < 1 and abs(at[2]) < 1


def test_the_evaluator_looks_at_the_ground_under_the_car(nodding):
    point, evaluator = torch.tensor([[17.0], [0.5], [0.0]], dtype=torch.float64), nodding.symbol.evaluator
    for step in range(4):
        time_s = step / 30
        uv, _ = nodding.world.view_from_ground(time_s).project(point)
        in_body = transform(inverse(nodding.world.motion.at(time_s).T_ground_body), point)
        assert torch.allclose(uv, nodding.world.view.project(in_body)[0])
        moved_px = (evaluator.plane_at(time_s).map_v - evaluator.plane.map_v).abs().median()
        # 0.3 deg are 3.1 px of focal length 597 px; half the oscillation's period later there are none
        assert moved_px > 2 if step % 2 else moved_px < 0.01


def test_sensors_tell_what_the_vehicle_does(nodding, small_simulation):
    state = nodding.start()
    for _ in range(3):
        state, _ = nodding.step(state)
    ego = nodding.ego(state.samples, state.arrivals.time_s)
    assert (float(ego.speed_m_s), ego.attitude_s, ego.time_s) == pytest.approx((22.0, 2 / 30, 3 / 30))
    standing = small_simulation.start()
    assert small_simulation.ego(standing.samples, standing.arrivals.time_s) is None, "it stands"


class Listening:
    """Shows the target, and keeps the motion that it is given when it draws and when frames come."""

    def __init__(self, target: Tensor) -> None:
        self.target, self.drawn, self.looked = target, list[Ego](), list[tuple[Ego, Ego]]()

    def start(self, pose: Tensor) -> None:
        return None

    def projection(self, state: None, ego: Ego | None) -> ProjectionCommand:
        assert ego is not None
        self.drawn.append(ego)
        return ProjectionCommand(self.target)

    def step(self, state: None, observation: Observation) -> None:
        assert observation.ego is not None and observation.shown.ego is not None
        self.looked.append((observation.shown.ego, observation.ego))


def test_light_is_drawn_with_what_is_known_when_it_is_exposed(nodding):
    controller = Listening(nodding.symbol.projector.target)
    results = list(nodding.with_controller(controller).evaluations())
    assert [ego.time_s for ego in controller.drawn] == pytest.approx([result.time_s for result in results])
    assert [ego.attitude_s for ego in controller.drawn] == pytest.approx([0, 0, 1 / 30, 2 / 30]), "a step late"
    assert [then for then, _ in controller.looked] == controller.drawn
    assert [now.time_s for _, now in controller.looked] == pytest.approx([(step + 1) / 30 for step in range(4)]), "when frames come"
