"""People's views: the camera's luminances in colour, glare of others, the own car, and a film at its own rate."""

import math
from dataclasses import replace

import av
import numpy as np
import pytest
import torch

from luxloop import LuxloopError, Simulation, load, run
from luxloop.loop.report.onlooker import Film, Onlooker, first_oncoming
from luxloop.loop.report.views import chase, driver, oncoming
from luxloop.loop.simulation.result import mean_lights
from luxloop.perception.eye import veil_per_lux
from luxloop.world.headlight.matrix import LUMINANCE
from luxloop.world.lamps.archive import save
from luxloop.world.lamps.presets import lamp

WEIGHT = torch.tensor(LUMINANCE)[:, None, None]
CAMERA = {"width_px": 240, "height_px": 135, "oversampling": 1}
CAR = {"kind": "car", "name": "oncoming", "style": "saloon", "path": {"points_m": [[70, 3.5, 0], [0, 3.5, 0]], "speed_m_s": 15.0}}
WALKER = {"kind": "pedestrian", "name": "walker", "clothing": "vest", "track": [{"position_m": [18.0, -3.0, 0.0]}]}


def simulation_of(*overrides, **values) -> Simulation:
    given = {"camera": CAMERA, "steps": 4, "functions": {}, "objects": [CAR, WALKER], "lighting": {"base": {"beam": "low"}}} | values
    return Simulation.prepare(load("gfhb", overrides, **given))


def looker(simulation: Simulation, view, **more) -> Onlooker:
    return Onlooker(simulation.world, view, 1.0, 3.5, **more)


@pytest.fixture(scope="module")
def night():
    simulation = simulation_of()
    return simulation, simulation.step(simulation.start())[1]


@pytest.mark.parametrize("overrides", [(), ('headlight={model="ssl-hd-lores"}',)])
def test_luminances_are_those_of_the_camera(overrides):
    simulation = simulation_of(*overrides)
    state, _ = simulation.step(simulation.start())
    _, result = simulation.step(state)
    t, lights = result.sense.now.time_s, result.reception.exposures[0].lights
    world = simulation.world
    seen = looker(simulation, world.view_from_ground(t)).light(t, result.lights, result.sense.now.commands)
    there = world.lit(t).surfaces.object_id >= 0
    expected = world.luminance(t, lights, result.sense.now.commands)[0]
    assert int(there.sum()) > 10_000
    # the colour's weights are float32
    assert torch.allclose((WEIGHT * seen).sum(0)[there], expected[there], rtol=1e-5, atol=1e-9)
    chroma = seen / (WEIGHT * seen).sum(0).clamp(min=1e-12)
    assert float((chroma.amax(0) - chroma.amin(0))[there].max()) > 0.5, "it has colours"


def test_air_before_surfaces_has_no_colour_of_theirs():
    simulation = simulation_of("air=[{ visibility_m = 20.0 }]", objects=[], light={"ambient_lx": 10.0})
    dark = [torch.zeros(module.headlight.n_pixels) for module in simulation.world.modules]
    seen = looker(simulation, driver(240)).light(0.0, dark)
    chroma = (seen / (WEIGHT * seen).sum(0)).amax(0) - 1
    surfaces = simulation.world.through(driver(240), 0.0).surfaces
    far = surfaces.haze.transmittance < 1e-3
    near = surfaces.haze.transmittance > 0.2
    assert float(chroma[far & (surfaces.object_id >= 0)].abs().max()) < 0.01 < float(chroma[near].max())


def test_lamps_that_shine_into_the_eye_veil_the_picture(night):
    simulation, result = night
    dark = simulation_of(objects=[CAR | {"lit": False}, WALKER])
    pictures = [looker(each, driver(240)).picture(0.5, result.lights, (), -2.0).astype(float) for each in (simulation, dark)]
    glare = pictures[0].mean(-1) - pictures[1].mean(-1)
    row, column = np.unravel_index(glare.argmax(), glare.shape)
    assert np.median(glare) > 3 and glare[row, column] > 100, "all of the picture, and most beside the lamps"
    (lamps, _) = driver(240).project(torch.tensor([[62.0], [3.5], [0.65]], dtype=torch.float64))
    assert abs(column - float(lamps[0, 0])) < 12, "the glare lies about the lamps"
    older = looker(simulation, driver(240), age_years=80.0).picture(0.5, result.lights, (), -2.0)
    assert older.mean() > pictures[0].mean()


def test_a_street_lamp_veils_as_its_illuminance_at_the_eye_does():
    lamp, cd = torch.tensor([[30.0], [2.0], [7.0]], dtype=torch.float64), 500.0
    dark, light = (
        looker(simulation_of(objects=[], light={"street_lamps": lamps}), driver(240))
        for lamps in ([], [{"position_m": lamp[:, 0].tolist(), "intensity_cd": cd}])
    )
    lit = light._lit(0.0)
    (axis, row, column) = lit.eye.T_world_view[:3, 2], light.view.height // 2, light.view.width // 2
    away = lamp[:, 0] - lit.eye.origin
    cos = float(axis @ away / away.norm())
    expected = cd * cos / float(away.norm()) ** 2 * float(veil_per_lux(torch.tensor(math.degrees(math.acos(cos))), 40.0))
    # 5 %: the pixel's middle lies beside the axis
    assert float(light.glare(lit, [], ())[0, row, column]) == pytest.approx(expected, rel=0.05)
    assert not dark.glare(dark._lit(0.0), [], ()).any()


def test_tail_lamps_veil_in_red():
    ahead = {"kind": "car", "name": "ahead", "track": [{"position_m": [20.0, 0.0, 0.0]}]}
    look = looker(simulation_of(objects=[ahead]), driver(240))
    red, _, blue = look.glare(look._lit(0.0), [], ()).amax((1, 2)).tolist()
    assert red > 10 * blue > 0


def test_only_who_is_beside_the_car_sees_it_and_it_throws_no_shadow(night):
    simulation, result = night
    without, seen = (
        (WEIGHT * looker(simulation, chase(240), with_car=beside).light(0.0, result.lights, ())).sum(0).numpy() for beside in (False, True)
    )
    changed = ~np.isclose(seen, without, rtol=1e-4, atol=1e-7)
    v, u = np.nonzero(changed)
    assert 0.02 < changed.mean() < 0.25 and abs(u.mean() - 120) < 6, "it stands in the middle"
    tail = seen[v, u].max()
    assert tail > 100, "its tail lamps shine"


def test_ground_beside_the_lanes_is_green(night):
    simulation, result = night
    light = looker(simulation, driver(240)).light(0.0, result.lights, ())
    x, y, _ = simulation.world.through(driver(240), 0.0).surfaces.position
    road = simulation.world.through(driver(240), 0.0).surfaces.object_id == 0
    grass, lane = road & (y < -2.5), road & (y.abs() < 1.5) & (x > 0)
    assert bool((light[1] > 1.1 * light[0])[grass & (light[1] > 0)].all()) and int(grass.sum()) > 500
    assert torch.allclose(light[0][lane], light[1][lane])


def test_coloured_edges_of_a_lamp_are_seen_at_the_same_luminance(tmp_path):
    file = tmp_path / "coloured.npz"
    save(file, lamp("ssl-hd-lores", chromatic_shift=0.02))
    simulation = simulation_of(f"headlight.model={file}")
    result = simulation.step(simulation.start())[1]
    view = simulation.world.view_from_ground(0.0)
    light = looker(simulation, view).light(0.0, result.lights, ())
    expected = simulation.world.lit(0.0).light(result.lights)[1] + simulation.world.lit(0.0).base
    there = simulation.world.lit(0.0).surfaces.object_id >= 0
    # three products of float32 in place of one
    assert torch.allclose((WEIGHT * light).sum(0)[there], expected[there], rtol=1e-3, atol=1e-6)
    road = (simulation.world.lit(0.0).surfaces.object_id == 0) & (expected > 0.01)
    assert float((light[0] / light[2])[road].std()) > 0.01, "edges have colours"


def test_an_oncoming_driver_is_veiled_by_the_own_lamps():
    axis = [math.cos(math.radians(4)), 0.0, -math.sin(math.radians(4))]  # of the view
    eye = {"frame": "oncoming_car", "position_m": [0.3, 0.36, 1.2], "facing": axis, "adaptation_cd_m2": 1.0}
    one = [
        "headlight.model=idealised-332x1024",
        'headlight.lamps=["left"]',
        "lighting.base.beam=full",
        "functions={}",
        "checks={}",
        "steps=1",
    ]
    simulation = Simulation.prepare(load("gfhb", one, camera=CAMERA, probes={"eye": eye}, video={"age_years": 40.0}))
    result = simulation.evaluate(simulation.step(simulation.start())[1])
    view, lights = oncoming(241), [each.u for each in result.exposures[0].lights]
    onlooker = Onlooker.of(simulation, view, with_car=True, rides=first_oncoming(simulation))
    veiled = onlooker.glare(onlooker._lit(0.0), lights, ())
    middle = float(veiled[0, view.height // 2, view.width // 2])
    assert result.glare["eye"].veil_cd_m2 > 1
    # 5 %: the pixel's middle is 0.08 deg from the axis, the lamp 4 deg, and the veil falls with the square
    assert middle == pytest.approx(result.glare["eye"].veil_cd_m2, rel=0.05)
    masked = onlooker.glare(onlooker._lit(0.0), [0 * u for u in lights], ())
    assert float(masked[0, view.height // 2, view.width // 2]) < 0.01 * middle, "but for the lamps of others"
    lit = onlooker._lit(0.0)
    away = (lit.surfaces.position - lit.eye.origin[:, None, None].float()).norm(dim=0)
    assert float(away[lit.surfaces.object_id >= 0].min()) > 1.5, "the eye's own car hides nothing"


def test_nobody_comes_towards_a_lonely_car(tmp_path):
    for objects in ([], [CAR | {"vanishes_s": 0.2}]):  # before the last of four steps
        with pytest.raises(LuxloopError, match=r"video.view = 'oncoming'.*no car comes towards the own one from 0 to 0.3 s"):
            Film(tmp_path / "video.mp4", simulation_of("video.view=oncoming", objects=objects))


def test_film_has_the_frames_of_its_rate_between_the_steps(tmp_path):
    values = {"camera": CAMERA, "steps": 4, "rate_hz": 10.0, "video": {"view": "chase", "width_px": 128, "rate_hz": 25.0}}
    run(load("gfhb", **values), tmp_path / "run", report=False)
    with av.open(str(tmp_path / "run" / "video.mp4")) as container:
        stream = container.streams.video[0]
        frames = [each.to_ndarray(format="rgb24") for each in container.decode(stream)]
        assert (stream.average_rate, stream.width, stream.height, stream.codec_context.name) == (25, 128, 72, "h264")
    assert len(frames) == 8, "from 0 to 0.3 s"
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 20, "traffic moves"


def test_film_of_people_needs_the_true_world(tmp_path, night):
    simulation = simulation_of("video.view=driver")
    blind = replace(simulation, plant=object())
    with pytest.raises(LuxloopError, match="does not know the truth"):
        Film(tmp_path / "video.mp4", blind)
    assert not [*tmp_path.iterdir()]


def test_an_eye_sees_the_mean_of_a_steps_exposures():
    simulation = Simulation.prepare(load("chevrons", camera=CAMERA, steps=1))
    result = simulation.evaluate(simulation.step(simulation.start())[1])
    on, off = (each.lights[0].u for each in result.exposures)
    (mean, *_) = mean_lights(result, simulation.scenario.shares)
    assert float(on.sum()) > 0 and torch.allclose(mean, (on + off) / 2), "its symbol is off for half of the time"


def test_the_lane_goes_on_straight_where_the_drive_ends():
    simulation = Simulation.prepare(load("bend_light", camera=CAMERA))
    onlooker = Onlooker.of(simulation, driver(240))
    x, y, heading = onlooker._course
    T = simulation.world.motion.at(simulation.scenario.steps / simulation.scenario.rate_hz).T_world_ground
    assert abs(float(heading[-1])) > 0.1, "it ends in the bend"
    ahead = (T @ torch.tensor([60.0, 0.0, 0.0, 1.0], dtype=torch.float64))[:2]
    assert np.interp(float(ahead[0]), x, y) == pytest.approx(float(ahead[1]), abs=0.2)  # places 0.1 s apart, in a bend
    assert len(Onlooker(simulation.world, driver(240), 0.0, 3.5)._course[0]) == 2, "a step without duration has a course as well"


@pytest.mark.parametrize("name", ["observer_symbol", "gfhb"])
def test_a_run_of_one_step_has_a_report(name, tmp_path):
    run(load(name, camera=CAMERA, steps=1), tmp_path / "run", video=False)
    assert (tmp_path / "run" / "report.png").is_file()
