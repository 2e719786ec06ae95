"""Heights from one observation, and drawings for them: against closed forms, then in a small closed loop."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from PIL import Image
from torch import Tensor

from luxloop import Observation, ProjectionCommand, Simulation, load
from luxloop.controllers.symbol.heights.height_map import CELLS, FOLLOWED, HeightMap, draw_on
from luxloop.controllers.symbol.heights.registration import plane_sweep, semi_global
from luxloop.controllers.symbol.sensing.projection import Warp
from luxloop.controllers.symbol.sensing.projector import SymbolParams
from luxloop.controllers.symbol.sensing.road_shape import HERE, ray_lengths
from luxloop.controllers.symbol.sensing.symbol_sensor import Projection
from luxloop.loop.scenario.model import DisturbanceParams
from luxloop.loop.simulation.result import SimulationState
from luxloop.perception.birdseye import Region
from luxloop.world.headlight.lamp import Lamp, Module
from luxloop.world.lamps import archive
from luxloop.world.lamps.presets import idealised
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import frames_of, simulation_of

REGION = Region(13.0, 21.0, 2.0, -2.0)
EYE, LAMP = torch.tensor([-1.6, 0.0, 1.35]), torch.tensor([0.0, 0.6, 0.75])
SMALL = [f"headlight.model={SMALL_LAMP}", "camera.width_px=640", "camera.height_px=360", "camera.oversampling=2"]


def relief(height: float, brightness: float = 1.0) -> HeightMap:
    return HeightMap(REGION, EYE, torch.full((20, 10), height), torch.full((20, 10), brightness))


def drawn(road: HeightMap, lamps: Tensor = LAMP[None]) -> tuple[ProjectionCommand, Warp]:
    projection = draw_on(road, lamps, SymbolParams(image="snowflake"), HERE)
    assert projection.warp is not None
    return projection, projection.warp


def on_plane(x: Tensor, y: Tensor) -> Tensor:
    return torch.stack([x, y, torch.zeros_like(x)])


UP = torch.tensor([0.0, 0.0, 1.0])


def seen_by_hand(lamp: Tensor, x: Tensor, y: Tensor, height: float) -> Tensor:
    """Where the eye sees light meant for (x, y) on a plane at that height, by similar triangles."""
    ground = torch.stack([x, y])
    point = ground + (lamp[:2, None, None] - ground) * (height / lamp[2])
    return point + (point - EYE[:2, None, None]) * (height / (EYE[2] - height))


@pytest.mark.parametrize("height", [-0.1, 0.0, 0.07])
def test_light_on_a_raised_plane_is_seen_where_similar_triangles_say(height):
    x, y = torch.meshgrid(torch.linspace(15, 19, 9), torch.linspace(-1, 1, 5), indexing="ij")
    seen = torch.stack(relief(height).seen_from(LAMP, on_plane(x, y), UP, 0.2))
    # the way of light is straight, but where its layers are seen is not quite linear in height between two of them
    torch.testing.assert_close(seen, seen_by_hand(LAMP, x, y, height), rtol=0, atol=5e-3)


def test_light_falls_on_the_first_thing_in_its_way():
    heights = torch.zeros(80, 10)
    heights[40:45] = 0.2  # a wall, seen between 16.5 m and 17 m
    wall = HeightMap(REGION, EYE, heights, torch.ones(80, 10))
    x = torch.tensor([[16.0, 17.5, 18.5, 20.5]])
    seen, _ = wall.seen_from(LAMP, on_plane(x, torch.zeros_like(x)), UP, 0.25)
    assert abs(seen[0, 0] - 16.0) < 0.01, "before the wall"
    assert ((seen[0, 1:3] > 16.4) & (seen[0, 1:3] < 17.1)).all(), "on its face"


def test_a_drawing_for_the_plane_is_the_symbol_itself():
    projection, warp = drawn(relief(0.0, 0.5))
    v, u = ((2 * (torch.arange(n) + 0.5) / n - 1) * size / share for n, size, share in zip(CELLS, warp.size_m, (4, 2), strict=True))
    # rounding of float32 coordinates of some 20 m, over half of the symbol's width of 1 m
    inner = (slice(FOLLOWED, -FOLLOWED), slice(FOLLOWED, -FOLLOWED))  # at the outermost, dark cells nothing is there to interpolate
    torch.testing.assert_close(projection.pose, torch.tensor([17.0, 0.0, 0.0, 0.0]), rtol=0, atol=1e-4)
    torch.testing.assert_close(warp.source[0, 1][inner], v[:, None].expand(CELLS)[inner], rtol=0, atol=1e-4)
    torch.testing.assert_close(warp.source[0, 0][inner], u.expand(CELLS)[inner], rtol=0, atol=1e-4)
    assert (warp.dimming == 1).all(), "what is darker than expected is not dimmed"
    assert torch.allclose(drawn(relief(0.0, 4.0))[1].dimming, torch.tensor(0.25))


@pytest.mark.parametrize("slope", [-0.02, 0.03])
def test_a_symbol_for_a_slope_is_drawn_on_the_slope(slope):
    shape = torch.tensor([[slope * 14.0, slope, 0.01, 0.0]])
    x, y = torch.meshgrid(torch.linspace(20.95, 13.05, 80), torch.linspace(1.95, -1.95, 40), indexing="ij")
    heights = EYE[2] * (1 - ray_lengths(shape, 17.0, EYE, on_plane(x, y) - EYE[:, None, None])[0])
    projection, warp = drawn(HeightMap(REGION, EYE, heights, torch.ones(80, 40)))
    x, y, roll, pitch = projection.pose
    assert projection.z is not None
    assert float(projection.z) == pytest.approx(float(shape[0, 0] + slope * (x - 17) + 0.01 * y), abs=1e-3)  # rounding over 20 m
    # heights behind lines of sight between cells of 10 cm are interpolated, on a slope they are not quite linear
    assert float(pitch) == pytest.approx(-math.atan(slope), abs=3e-4)
    assert float(roll) == pytest.approx(math.atan(0.01), abs=3e-4)
    u, v = warp.source[0]
    assert (u.min() < -1) & (u.max() > 1) & (v.min() < -1) & (v.max() > 1), "the patch holds the whole symbol"


def test_each_lamp_has_a_drawing_of_its_own():
    eye, lamps = torch.tensor([-1.6, 0.0, 1.35]), torch.stack([LAMP, LAMP * torch.tensor([1.0, -1.0, 1.0])])
    wave = 0.03 * (1 + torch.linspace(-6, 6, 20).cos())[:, None].expand(20, 10)
    _, warp = drawn(HeightMap(REGION, eye, wave, torch.linspace(1, 2, 20)[:, None].expand(20, 10)), lamps)
    left, right = warp.source
    # rounding of float32 coordinates, as above; what is left for one lamp is right for the other
    torch.testing.assert_close(right, torch.stack([-left[0], left[1]]).flip(-1), rtol=0, atol=2e-4)
    torch.testing.assert_close(warp.dimming[1], warp.dimming[0].flip(-1), rtol=0, atol=1e-4)
    assert (left[0] - right[0]).abs().max() > 0.04, "3 cm of road over and under the patch move a lamp's light by 2 cm sideways"
    by_both = ['headlight.lamps=["left", "right"]', 'functions.symbol.modules=["left", "right"]']
    projector = simulation_of(load("flat", [*SMALL, *by_both])).symbol.projector
    both = projector.draw(ProjectionCommand(projector.target, warp=warp))
    for k, light in enumerate(both):
        for_all = replace(warp, source=warp.source[k, None], dimming=warp.dimming[k, None])
        assert torch.equal(light.u, projector.draw(ProjectionCommand(projector.target, warp=for_all))[k].u)


def test_neighbours_settle_what_is_ambiguous():
    costs = torch.ones(6, 8, 5)
    costs[..., 3] = 0.0
    costs[2:4, 3:5] = 0.0  # says nothing
    costs[5, 7, 0] = -0.5  # an outlier
    assert (semi_global(costs) == 3).all()


def simulation(road: str, *more: str) -> Simulation:
    return simulation_of(load("flat", [*SMALL, f"road={road}", "functions.symbol.controller={name='luxloop'}", *more]))


@pytest.fixture
def lifted() -> Simulation:
    """A plane 3 cm too high, from well before the symbol on."""
    return simulation('{kind="curb", y_m=-8.0, ramp_m=0.03, height_m=0.03}', "headlight.model=idealised-332x1024")


def test_one_look_tells_how_high_the_road_is(lifted):
    controller, projector = lifted.symbol.controller, lifted.symbol.projector
    lights = projector.light(projector.target)
    frames = frames_of(lifted.plant, lights)
    fine = controller.registration.forward_model
    contrast, limit = fine.observe(frames)
    seen = fine.symbol(contrast, limit)
    textures = tuple(m.pixel_controller.headlight.light_texture(light.u) for m, light in zip(projector.modules, lights, strict=True))
    registration = controller.registration
    swept = plane_sweep(fine, seen, textures, limit, controller.tried, registration.unknown().base)
    refined = registration.refine(swept, registration.unknown(), seen, textures, limit)
    found, lit = refined.mean, refined.information > 1 / 0.005**2  # known to half a centimetre by themselves
    assert lit.sum() > 50
    # heights are tried in steps of 5 mm, and smoothness may cost one
    assert (swept[lit] - 0.03).abs().median() < 0.006
    # a fifth of a camera row, 20 cm here, is 4 cm of road or 2 mm of height
    assert (found[lit] - 0.03).abs().median() < 0.002
    roads = torch.stack([torch.zeros_like(found), found])
    flat, right = registration.residual(fine.luminance(textures, fine.on_pixels(roads)), seen, limit)
    assert right < 0.2 * flat


def course(prepared: Simulation, state: SimulationState, steps: int) -> tuple[list[SimulationState], list[float]]:
    """The states before each step and at the end, and the evaluator's IoU a step."""
    states, seen = [state], []
    for _ in range(steps):
        state, result = prepared.step(states[-1])
        result = prepared.evaluate(result)
        states.append(state)
        seen.append(float(result.symbol.metrics.iou))
    return states, seen


def disturbed(prepared: Simulation, **disturbances: Any) -> Simulation:
    """The same in the same world, of which nothing is rendered again."""
    return replace(prepared, plant=replace(prepared.plant, disturbances=DisturbanceParams(**disturbances)))


def opened(prepared: Simulation) -> float:
    """IoU of the open loop."""
    symbol = prepared.symbol
    return float(symbol.evaluator.metrics(prepared.of_all(symbol, symbol.projector.light(symbol.projector.target)), 0.0).iou)


@pytest.mark.parametrize(("more", "step"), [((), 4), (("camera.latency_steps=2",), 10)])
def test_the_symbol_lies_right_on_an_uneven_road_at_any_latency(more, step):
    prepared = simulation('{kind="bumps"}', *more)
    _, seen = course(prepared, prepared.start(), 11)
    # 0.96 is reached at full resolution; half of it leaves edges of half a camera row
    assert seen[step] > 0.9
    assert seen[step] > opened(simulation('{kind="bumps"}')) + 0.05


def test_a_pattern_shows_the_whole_road_at_the_first_look():
    opening = "functions.symbol.controller={name='luxloop', opening='pattern'}"
    prepared = simulation('{kind="bumps"}', "camera.latency_steps=2", opening)
    states, seen = course(prepared, prepared.start(), 5)
    shown = [state.symbols["symbol"].controller.projection for state in states]
    assert all(each.shows(prepared.symbol.controller.pattern) for each in shown[:3])
    assert max(seen[:3]) < 0.3
    assert min(seen[3:]) > 0.9, "as without a pattern after several looks"


@pytest.fixture(scope="session")
def coarse_lamp(tmp_path_factory) -> str:
    """The thesis' lamp with square pixels of 0.1 degrees."""
    path = tmp_path_factory.mktemp("lamp") / "coarse.npz"
    archive.save(path, Lamp("coarse", (Module("matrix", idealised(50, 200)),)))
    return str(path)


@pytest.mark.parametrize("latency", [0, 1])
@pytest.mark.parametrize(
    ("road", "image"),
    [('{kind="iso8608", roughness_class="B", seed=344}', "warning_triangle"), ('{kind="speed_bump", height_m=0.042}', "distance_warning")],
)
def test_where_pixels_are_too_coarse_for_the_road_the_open_loop_is_shown(coarse_lamp, road, image, latency):
    symbol = (f"functions.symbol.image={image}", "functions.symbol.x_m=19.0", "functions.symbol.y_m=-1.0")
    prepared = simulation(road, f"headlight.model={coarse_lamp}", f"camera.latency_steps={latency}", *symbol)
    _, seen = course(prepared, prepared.start(), 14)
    # a drawing for the road is 0.02 to 0.03 worse
    assert min(seen[10:]) > opened(prepared) - 0.005


def test_a_flat_road_keeps_next_to_all_of_the_open_loop():
    prepared = simulation('{kind="flat"}')
    states, seen = course(prepared, prepared.start(), 5)
    ego = prepared.ego(states[-1].samples, states[-1].arrivals.time_s)
    projection = prepared.symbol.controller.projection(states[-1].symbols["symbol"].controller, ego)
    assert torch.equal(projection.pose, prepared.symbol.projector.target)
    assert min(seen[1:]) > opened(prepared) - 0.04  # heights that noise brings cost up to 0.03, over eight seeds


def test_without_frames_and_without_light_the_open_loop_is_shown():
    prepared = simulation('{kind="flat"}')
    state, result = prepared.step(prepared.start())
    controller, target = prepared.symbol.controller, prepared.symbol.projector.target
    dark = tuple(torch.zeros_like(frame) for frame in result.frames)
    start = controller.start(result.planning.projections["symbol"].pose)
    for before, frames in ((start, None), (state.symbols["symbol"].controller, dark)):
        assert torch.equal(controller.step(before, look(prepared, frames)).projection.pose, target)


def look(prepared: Simulation, frames: tuple[Tensor, Tensor] | None) -> Observation:
    sensor, projection = prepared.symbol.sensor, ProjectionCommand(prepared.symbol.projector.target)
    lights = sensor.projector.light(projection.pose)
    return Observation(sensor.measure(frames, projection, lights), frames, Projection(projection, lights))


def test_a_wrong_belief_at_the_start_is_drawn_and_given_up():
    prepared = simulation('{kind="flat"}', "functions.symbol.controller={name='luxloop', start_height_m=0.03}")
    _, first = prepared.step(prepared.start())
    # the camera at 1.35 m takes the target for 17 m (1 - 0.03 / 1.35), where the lamp at 0.75 m casts light 0.75 / 0.72 times as far
    assert float(first.measurement.pose_error[0]) == pytest.approx(0.3, abs=0.1)  # of a symbol that is some cm longer, too
    _, seen = course(prepared, prepared.start(), 5)
    assert seen[0] < opened(prepared) - 0.1
    assert min(seen[1:]) > 0.9  # one observation is enough; at this resolution noise alone costs up to 0.03 in some steps


def shown_at_target(prepared: Simulation) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, ...]]:
    """Frames of the symbol at its target, and its light textures."""
    projector = prepared.symbol.projector
    modules, lights = projector.modules, projector.light(projector.target)
    frames = frames_of(prepared.plant, lights)
    assert frames is not None
    controllers = [module.pixel_controller for module in modules]
    return frames, tuple(c.headlight.light_texture(light.u - c.default) for c, light in zip(controllers, lights, strict=True))


def test_noise_is_measured_where_the_camera_does_not_tell():
    usual = simulation('{kind="flat"}')
    noisy = disturbed(usual, noise=[{"factor": 10.0}])
    limits = []
    for prepared in (usual, noisy):
        frames, textures = shown_at_target(prepared)
        forward_model = prepared.symbol.controller.registration.forward_model
        contrast, limit = forward_model.observe_symbol(frames, forward_model.luminance(textures, 0 * forward_model.inside[None])[0])
        assert (limit >= forward_model.observe(frames)[1]).all()
        unlit = (forward_model.inside > 0) & (contrast < contrast.max() / 2)
        limits.append(float(limit.mean()))
        # faintly lit pixels are beyond, a tenth; with the camera's own noise as threshold it would be 0.31 of the noisy ones
        assert float((contrast[unlit].abs() > limit[unlit]).float().mean()) < 0.15
    # two columns are taken together, which the camera's limit leaves out: 10 / sqrt(2); clamping at black takes some off
    assert 2 < limits[1] / limits[0] < 10


def test_a_symbol_that_fills_most_of_what_is_seen_is_not_taken_for_noise(tmp_path):
    Image.new("L", (8, 8), 255).save(tmp_path / "white.png")
    large = simulation('{kind="bumps"}', f'functions.symbol={{image="{tmp_path / "white.png"}", width_m=4.0, length_m=8.0}}')
    forward_model = large.symbol.controller.registration.forward_model
    frames, textures = shown_at_target(large)
    contrast, limit = forward_model.observe(frames)
    assert float((contrast > limit)[forward_model.inside > 0].float().mean()) > 0.5
    # The road's few cm move some light into what is dark on a plane, which raises the median, but noise of two columns is below the limit.
    flat = forward_model.luminance(textures, 0 * forward_model.inside[None])[0]
    torch.testing.assert_close(forward_model.observe_symbol(frames, flat), (contrast, limit))
