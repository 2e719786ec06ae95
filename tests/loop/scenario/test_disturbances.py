"""What a disturbance does to frames and to the light on the road, where the controller knows nothing of it."""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from luxloop import Simulation, Utilisation, validate
from luxloop.loop.scenario.disturbances import DisturbanceParams, WearParams
from luxloop.loop.scenario.overrides import overridden
from luxloop.loop.simulation.result import StepResult
from luxloop.loop.simulation.simulated import SimulatedPlant
from luxloop.loop.simulation.truth import true_camera, true_modules, wear_out
from luxloop.loop.simulation.world import World
from luxloop.perception.camera import luminance_of, saturation_luminance
from luxloop.world.light.soiling import SoilingParams
from luxloop.world.roads.shapes import Flat
from luxloop.world.scene.vehicle import VehicleParams, drive
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import SMALL, frames_of, simulation_of, toml
from tests.refusal import refusal

AT_TARGET = overridden(
    SMALL,
    [
        toml("""
steps = 1
headlight = { model = "idealised-332x1024", lamps = ["left"] }
camera.noise = false
functions.symbol = { controller = "open", start = {} }
""")
    ],
)


def prepared(*overrides: str | dict[str, Any]) -> Simulation:
    return simulation_of(validate(overridden(AT_TARGET, overrides), "disturbed"))


def first(simulation: Simulation) -> StepResult:
    return next(simulation.evaluations())


@pytest.fixture(scope="module")
def plain() -> Simulation:
    return prepared()


def disturbed(world: World, **disturbances: Any) -> SimulatedPlant:
    return SimulatedPlant(world, 30.0, 0, disturbances=DisturbanceParams.model_validate(disturbances))


def frames(simulation: Simulation, step: int = 0, **disturbances: Any) -> tuple[Tensor, Tensor] | None:
    """Luminance in cd/m^2 of a step's on and off frame with the symbol at its target, on the same road in the same light."""
    world = simulation.world
    seen = frames_of(disturbed(world, **disturbances), simulation.symbol.projector.light(simulation.symbol.projector.target), step)
    return None if seen is None else (luminance_of(seen[0], world.camera), luminance_of(seen[1], world.camera))


def test_ambient_light_changes_in_the_frames_and_steps_that_are_named(plain):
    on, off = frames(plain)
    spell = toml("{ factor = 4.0, frames = 'off', from_step = 3, until_step = 5 }")
    for step in range(6):
        on_now, off_now = frames(plain, step, ambient=[spell])
        assert torch.equal(on_now, on)
        # four times the base, each coded to half a level of 4095
        assert torch.allclose(off_now, (4 if step in (3, 4) else 1) * off, atol=3 * saturation_luminance(plain.world.camera) / 4095)
    both, _ = frames(plain, 4, ambient=[spell | {"frames": "both"}, {"factor": 0.5}])
    assert torch.allclose(both - on, off, atol=2 * saturation_luminance(plain.world.camera) / 4095)  # factors multiply: 2 in all


def test_a_headlamp_in_one_frame_only_saturates_and_veils_that_frame(plain):
    lamp = toml("""
position_m = [40.0, 2.0, 0.65]
velocity_m_s = [-15.0, 0.0, 0.0]
intensity_cd = 3000.0
frames = "on"
from_step = 1
""")
    on, off = frames(plain)
    assert torch.equal(frames(plain, 0, oncoming=[lamp])[0], on)
    for step in (1, 6):
        on_now, off_now = frames(plain, step, oncoming=[lamp])
        assert torch.equal(off_now, off)
        position = torch.tensor([40.0 - 15 * step / 30, 2.0, 0.65], dtype=torch.float64)
        uv, _ = plain.world.view.project(position[:, None])
        u, v = (int(x) for x in uv[:, 0])
        assert float(on_now[v, u]) == pytest.approx(saturation_luminance(plain.world.camera))
        theta = math.degrees(math.hypot(u + 60 - float(uv[0]) + 0.5, v + 0.5 - float(uv[1])) / plain.world.view.fx)
        veil = (on_now - on)[v, u + 60]
        # one level of code; the plane's tangent in place of the angle is 0.5 % at 6 deg
        expected = 0.1 * 10 * 3000 / float((position - plain.world.view.origin).square().sum()) / theta**2
        assert float(veil) == pytest.approx(expected, rel=0.03, abs=saturation_luminance(plain.world.camera) / 4095)


def test_a_car_drives_towards_a_headlamp_that_stands(plain):
    lamp = toml("{ position_m = [60.0, 2.0, 0.65], diameter_m = 0.5, veil = 0.0, intensity_cd = 5.0 }")
    scene, modules, camera, source = plain.world.scene, plain.world.modules, plain.world.camera, plain.world.source
    motion = drive(VehicleParams.model_validate({"course": [{"speed_m_s": 20.0}]}), Flat(), 1.0)
    world = World(scene, modules, camera, source, motion)
    plant = disturbed(world, oncoming=[lamp])
    dark = torch.zeros(camera.height_px, camera.width_px, device=plain.device)
    for step, frame, distance in ((0, 0, 60.0), (15, 0, 50.0), (15, 1, 50.0 - 20 / 60)):
        image = plant.exposed(dark, dark, step, frame)
        u, v = torch.arange(camera.width_px) + 0.5, torch.arange(camera.height_px) + 0.5
        middle = [float((image.sum(dim).cpu() * at).sum() / image.sum()) for dim, at in ((0, u), (1, v))]
        uv, _ = world.view.project(torch.tensor([[distance], [2.0], [0.65]], dtype=torch.float64))
        # digital numbers below half a level are none, which cuts the Gaussian off evenly
        assert middle == pytest.approx(uv[:, 0].tolist(), abs=0.05)


def test_noise_is_as_many_times_as_wide(plain):
    _, quiet = frames(plain)
    bright = {"ambient": [{"factor": 20.0}]}  # far from black and white, which clamp
    _, level = frames(plain, **bright)
    inside = (level > 0.25 * saturation_luminance(plain.world.camera)) & (level < 0.75 * saturation_luminance(plain.world.camera))
    assert int(inside.sum()) > 10_000 and quiet[inside].max() < 0.1
    noisy = prepared("camera.noise=true")
    once, ten = (float((frames(noisy, 2, **bright, noise=[{"factor": f}])[1] - level)[inside].std()) for f in (0.5, 4.0))
    assert ten / once == pytest.approx(8, rel=0.02)  # the same numbers eight times as large; beyond 3.5 sigma a few are clamped


def test_frames_are_lost_when_listed_and_as_often_as_they_shall(plain):
    spells = [{"from_step": 2, "until_step": 4}, {"from_step": 7, "until_step": 8}]
    assert [step for step in range(10) if frames(plain, step, drops=spells) is None] == [2, 3, 7]
    plant = disturbed(plain.world, drops=[{"probability": 0.5}, {"probability": 0.2, "from_step": 1000}])
    lost = [plant.loses(step) for step in range(2000)]
    assert lost == [plant.loses(step) for step in range(2000)]
    # 0.5, and 1 - 0.5 * 0.8 where both hold; three standard errors of a share of a thousand are 0.048
    assert sum(lost[:1000]) / 1000 == pytest.approx(0.5, abs=0.048) and sum(lost[1000:]) / 1000 == pytest.approx(0.6, abs=0.048)


def test_a_batch_is_disturbed_as_each_of_it_alone(plain):
    plant = disturbed(plain.world, oncoming=[{"position_m": (40.0, 2.0, 0.65)}], ambient=[{"factor": 3.0, "frames": "off"}])
    (light,) = plain.symbol.projector.light(plain.symbol.projector.target)
    batch, off = frames_of(plant, [Utilisation(torch.stack([light.u, 0.5 * light.u]))])
    for k, share in enumerate((1.0, 0.5)):
        alone, off_alone = frames_of(plant, [Utilisation(share * light.u)])
        assert (batch[k] - alone).abs().max() <= 1  # sums in another order may round to the next level
        assert torch.equal(off, off_alone)


def test_a_camera_that_looks_elsewhere_moves_the_image_and_not_the_light(plain):
    simulation = prepared("disturbances.calibration={ yaw_deg=0.4, focal_percent=2.0 }")
    right, wrong = first(plain), first(simulation)
    # the controller expects what it did; the light lies as well as before, and the evaluator, who knows the true camera, sees that
    assert torch.equal(simulation.symbol.sensor.model.target, plain.symbol.sensor.model.target)
    assert wrong.symbol.metrics.centroid_percent.abs().max() < 0.2 and float(wrong.symbol.metrics.iou) > 0.97
    u, v = right.symbol.measurement.appearance.centroids[0].tolist()
    u_wrong, v_wrong = wrong.symbol.measurement.appearance.centroids[0].tolist()
    fx = plain.world.view.fx
    expected_u = 160 + 1.02 * fx * math.tan(math.atan((u - 160) / fx) + math.radians(0.4))
    # the symbol's edges fall on other parts of pixels; a yaw about an inclined axis lifts nothing this near to the middle
    assert (u_wrong, v_wrong) == pytest.approx((expected_u, 90 + 1.02 * (v - 90)), abs=0.15)


def test_a_camera_on_another_place_sees_from_there(small_scenario):
    camera = small_scenario.camera
    error = DisturbanceParams.model_validate(toml("{ calibration = { x_m = -0.2, z_m = 0.1, pitch_deg = -0.2 } }"))
    there = true_camera(small_scenario.model_copy(update={"disturbances": error}))
    assert (there.x_m, there.y_m, there.z_m, there.pitch_deg) == pytest.approx((-1.8, 0.0, 1.45, 2.8))
    assert there == camera.model_copy(update={"x_m": there.x_m, "z_m": there.z_m, "pitch_deg": there.pitch_deg})
    assert true_camera(small_scenario) == camera


def test_a_lamp_aimed_too_high_throws_the_symbol_further():
    up = math.radians(0.1)
    x, y = first(prepared("disturbances.aim=[{ pitch_deg=-0.1 }]")).symbol.metrics.centroid_percent.tolist()
    moved = 0.75 / math.tan(math.atan(0.75 / 17) - up) - 17
    # the symbol grows about its middle ray, which moves its centroid by a tenth of the shift at most; the left lamp's rays go to the right
    assert x == pytest.approx(100 * moved / 4, rel=0.1) and y == pytest.approx(-100 * 0.6 * moved / 17 / 2, rel=0.2)


def test_two_lamps_draw_one_symbol_until_one_is_aimed_aside(plain):
    both = ("headlight.lamps=['left', 'right']", "functions.symbol.modules=['left', 'right']")
    together = prepared(*both, f"headlight.model={SMALL_LAMP}")
    shared, alone = first(together), first(plain)
    assert float(shared.symbol.metrics.iou) > 0.97
    runs = ((together, shared), (plain, alone))
    lit = [float(sim.world.lit(0.0).luminance(result.exposures[0].lights).sum()) for sim, result in runs]
    assert lit[0] == pytest.approx(lit[1], rel=0.01)  # each gives half of the setpoint
    apart = first(prepared(*both, f"headlight.model={SMALL_LAMP}", "disturbances.aim=[{ lamp='right', yaw_deg=-1.0 }]"))
    y_percent = float(apart.symbol.metrics.centroid_percent[1])
    # half of the light has moved by a degree at 17 m, 30 cm of 2 m to the right
    assert y_percent == pytest.approx(-100 * math.tan(math.radians(1)) * 17 / 2 / 2, rel=0.2) and float(apart.symbol.metrics.iou) < 0.8


def worn_world(plain: Simulation, **wear: Any) -> World:
    """The plain simulation's world in the light of worn lamps."""
    world = plain.world
    modules = true_modules(world.modules, (), WearParams.model_validate(wear), SoilingParams())
    return World(world.scene, modules, world.camera, world.source)


def test_worn_pixels_give_as_much_less_light(plain):
    aged = worn_world(plain, dead=0.2, aged=0.5, aged_factor=0.4, seed=5)
    matrix, whole = aged.modules[0].headlight.matrix, plain.world.modules[0].headlight.matrix
    left = matrix.values / whole.values
    shares = [float(left.isclose(torch.tensor(share)).double().mean()) for share in (0.0, 0.4, 1.0)]
    assert shares == pytest.approx([0.2, 0.5, 0.3], abs=1e-5)  # one entry a pixel, 339,968 of them
    light = plain.symbol.projector.light(plain.symbol.projector.target)
    added = [world.lit(0.0).luminance(light).sum() for world in (aged, plain.world)]
    # 0.3 + 0.5 * 0.4; the symbol has some thousand pixels, each with a standard deviation of 0.37
    assert float(added[0] / added[1]) == pytest.approx(0.5, abs=0.03)


def test_modules_wear_each_in_its_own_way_and_as_their_seed_says(plain):
    module = plain.symbol.projector.modules[0]

    def values(seed: int, number: int) -> Tensor:
        return wear_out(module.pixel_controller.headlight, module.name, WearParams(dead=0.1, seed=seed), number).matrix.values

    assert torch.equal(values(1, 0), values(1, 0))
    assert not torch.equal(values(1, 0), values(1, 1)) and not torch.equal(values(1, 0), values(2, 0))


def test_dead_pixels_that_are_named_are_dead(plain):
    (light,) = plain.symbol.projector.light(plain.symbol.projector.target)
    lit = torch.nonzero(light.u)[:, 0].tolist()
    assert not worn_world(plain, dead_pixels=lit).lit(0.0).luminance([light]).any()
    with refusal(r"wear\.dead_pixels: left matrix has no pixel 339968; give numbers from 0 to 339967"):
        worn_world(plain, dead_pixels=[339_968])


BLIND = {
    "reduce disturbances.calibration": ["disturbances.calibration={ z_m=-0.5, pitch_deg=-10 }"],
    "disturbances.calibration.z_m: the camera is at -0.1 m": ["camera.z_m=0.4", "disturbances.calibration.z_m=-0.5"],
    "disturbances.aim.z_m: the lamp is at -0.05 m": ["disturbances.aim=[{ z_m=-0.4 }, { z_m=-0.4 }]"],
}


@pytest.mark.parametrize("words", BLIND)
def test_errors_that_leave_nothing_to_see_are_told(words):
    with refusal(words):
        prepared(*BLIND[words])


WRONG = {
    "ambient=[{ factor=2.0, from_step=5, until_step=5 }]": r"until_step: 5 is not above from_step = 5",
    "wear={ dead=0.7, aged=0.4 }": "disturbances.wear: dead .0.7. and aged .0.4. are shares of all pixels",
    "aim=[{ lamp='right' }]": r"disturbances.aim\[0\].lamp: the right lamp is dark here; name it in headlight.lamps",
}


@pytest.mark.parametrize(("disturbance", "words"), WRONG.items())
def test_what_cannot_be_is_told(disturbance, words):
    with refusal(words):
        validate(overridden(AT_TARGET, [f"disturbances.{disturbance}"]), "disturbed")


def test_a_box_hides_the_road_and_shades_what_lies_behind(plain):
    track = "[{ time_s=0.1, position_m=[13.0, 0.0, 0.0] }, { time_s=0.2, position_m=[13.0, 10.0, 0.0] }]"
    there = f"appears_s=0.1, vanishes_s=0.2, track={track}"
    simulation = prepared(f"objects=[{{ kind='box', name='box', size_m=[0.3, 3.0, 0.4], {there} }}]")
    symbol = simulation.symbol
    lights = simulation.of_all(symbol, symbol.projector.light(symbol.projector.target))
    free, hidden, gone = (symbol.evaluator.metrics(lights, t) for t in (0.0, 0.1, 0.19))
    assert float(free.iou) > 0.97 and float(gone.iou) == pytest.approx(float(free.iou), abs=0.01)
    # from 0.75 m a box of 0.4 m at 13 m shades to 28 m: all of the symbol, and its own face is no part of it
    assert float(hidden.iou) < 0.1
