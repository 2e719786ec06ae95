"""Joint pixel optimisation behind the protocol of pixel controllers: from primitives to pixels."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from luxloop.controllers.pixels.jpo import Jpo, JpoParams
from luxloop.controllers.pixels.primitives import Primitives, concatenate, rectangle
from luxloop.controllers.pixels.secondary import PotentialLight, SecondaryRays
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.perception.metrics import mae, rmse
from luxloop.world.frames import pose_from_degrees
from luxloop.world.headlight import Headlight
from luxloop.world.lamps.presets import lamp
from luxloop.world.spmv import multiply

T_LAMP = pose_from_degrees((0.0, 0.6, 0.75))
VECTORS = ("origin", "d1", "d2", "normal", "value", "weight")


def on_a_wall(y_m: float = 0.5, value: float = 8000.0, quantity: str = "I_v", **given: float) -> Primitives:
    """A rectangle of 3 m x 1 m on a wall 25 m ahead, at the lamp's height."""
    return rectangle((25.0, y_m + 1.5, 0.25), (0.0, -3.0, 0.0), (0.0, 0.0, 1.0), value, quantity, normal=(-1.0, 0.0, 0.0), **given)


@pytest.fixture(scope="module")
def hd84() -> Headlight:
    return lamp("hd84").modules[0].headlight


@pytest.mark.parametrize("objective", ["mae", "least_squares"])
@pytest.mark.parametrize(("quantity", "value"), [("I_v", 8000.0), ("E_v", 12.0), ("u_abs", 0.4), ("u_rel", 1.8)])
def test_the_controller_is_nearer_to_its_primitives_than_ssc(hd84, objective, quantity, value):
    default = torch.full((84,), 0.2)
    jpo = Jpo.prepare(hd84, JpoParams(objective=objective), default)
    primitives = on_a_wall(value=value, quantity=quantity)
    goal = jpo.goal(primitives, T_LAMP)
    error = mae if objective == "mae" else rmse
    texture = goal.target.unflatten(-1, (hd84.rows, hd84.cols))
    ssc, joint = Ssc.prepare(hd84, default=default).utilisation(primitives, T_LAMP).u, jpo.utilisation(primitives, T_LAMP).u
    assert error(hd84.light_texture(joint), texture) < 0.99 * error(hd84.light_texture(ssc), texture)
    assert torch.equal(joint[~goal.free], default[~goal.free]) and goal.free.any() and not goal.free.all()


def test_shares_mean_the_light_that_they_give(hd84):
    jpo = Jpo.prepare(hd84, default=torch.rand(84, generator=torch.Generator().manual_seed(1)))
    goal = jpo.goal(concatenate(on_a_wall(2.5, 0.4, "u_abs"), on_a_wall(-2.5, 1.5, "u_rel")), T_LAMP)
    full, default = hd84.light_texture(torch.ones(84)).flatten(), hd84.light_texture(jpo.default).flatten()
    changed = (goal.target - default).abs() > 1
    close = torch.isclose(goal.target, 0.4 * full) | torch.isclose(goal.target, 1.5 * default)
    assert changed.sum() > 500 and close[changed].all()


def test_a_mask_is_dark_and_its_surroundings_are_not(hd84):
    jpo = Jpo.prepare(hd84, default=torch.ones(84))
    mask = on_a_wall(value=0.0, weight=float("inf"))
    goal, u = jpo.goal(mask, T_LAMP), jpo.utilisation(mask, T_LAMP).u
    dark = goal.target == 0
    reached = multiply(hd84.matrix.transpose, dark.float()) > 0
    assert dark.sum() > 500 and (u[reached] == 0).all() and (u[~reached] > 0.9).all()
    assert (hd84.light_texture(u).flatten()[dark] == 0).all()


@pytest.mark.parametrize("objective", ["mae", "least_squares"])
def test_heavy_light_beside_a_mask_counts_a_thousandfold(hd84, objective):
    jpo, mask = Jpo.prepare(hd84, JpoParams(objective=objective)), on_a_wall(y_m=-2.5, value=0.0, weight=float("inf"))
    scenes = [concatenate(on_a_wall(weight=weight), mask) for weight in (1e3, 1e30, float("inf"))]
    goals = [jpo.goal(scene, T_LAMP) for scene in scenes]
    assert all(torch.equal(goal.weight, goals[0].weight) and torch.equal(goal.free, goals[0].free) for goal in goals)
    for scene in scenes:
        u = jpo.utilisation(scene, T_LAMP).u
        assert u.isfinite().all() and u.max() > 0.1


@pytest.mark.parametrize("there_is", [True, False], ids=["aside", "nothing"])
def test_nothing_in_sight_leaves_the_default(hd84, there_is):
    default = torch.rand(84, generator=torch.Generator().manual_seed(2))
    scene = on_a_wall(y_m=60.0).select(torch.tensor([there_is]))
    batch = replace(scene, **{name: torch.stack(2 * [getattr(scene, name)]) for name in VECTORS})
    controllers = [Jpo.prepare(hd84, JpoParams(objective=objective), default) for objective in ("mae", "least_squares")]
    for controller in (Ssc.prepare(hd84, default=default), *controllers):
        assert torch.equal(controller.utilisation(scene, T_LAMP).u, default)
        # A batch takes the mean of the default over thousands of rays of a pixel, in float32.
        torch.testing.assert_close(controller.utilisation(batch, T_LAMP).u, default.expand(2, -1), rtol=0, atol=1e-5)


def test_a_batch_of_scenes_gives_what_each_gives(hd84, device):
    jpo = Jpo.prepare(hd84.to(device), JpoParams(iterations=400))
    places = [2.0, -1.0]
    alone = [jpo.utilisation(on_a_wall(y).to(device), T_LAMP).u for y in places]
    scenes = [on_a_wall(y) for y in places]
    batch = replace(scenes[0], **{name: torch.stack([getattr(each, name) for each in scenes]) for name in VECTORS}).to(device)
    both = jpo.utilisation(batch, T_LAMP).u
    assert both.shape == (2, 84)
    for k, u in enumerate(alone):
        goal = jpo.goal(on_a_wall(places[k]).to(device), T_LAMP)
        errors = [(multiply(jpo.headlight.matrix, each) - goal.target).abs().sum() for each in (u, both[k])]
        # An optimum is not unique, its error is.
        torch.testing.assert_close(errors[1], errors[0], rtol=2e-3, atol=0)


def test_over_another_beam_it_is_as_if_prepared_for_it(hd84):
    beam = torch.rand(84, generator=torch.Generator().manual_seed(2))
    moved, anew = Jpo.prepare(hd84).over(beam), Jpo.prepare(hd84, default=beam)
    assert torch.equal(moved.full, anew.full)
    primitives = concatenate(on_a_wall(2.5, 0.4, "u_abs"), on_a_wall(-2.5, 1.5, "u_rel"))
    assert torch.equal(moved.utilisation(primitives, T_LAMP).u, anew.utilisation(primitives, T_LAMP).u)


def test_rays_are_cast_once(hd84):
    """And ask what they hit once: SSC starts from the same setpoints as the optimisation."""
    asked = []

    def occluded(points: Tensor, target: Tensor) -> Tensor:
        asked.append(points.shape[-1])
        return torch.zeros(points.shape[-1], dtype=torch.bool)

    secondary = SecondaryRays((("left", PotentialLight.of(hd84, T_LAMP)),), 0, occluded=occluded)
    for controller in (Ssc.prepare(hd84), Jpo.prepare(hd84, JpoParams(iterations=1))):
        controller.utilisation(on_a_wall(), T_LAMP, secondary)
    assert len(asked) == 2
