"""From a scenario's [headlight] to the modules that shine, and to those of them that draw a symbol; and to the road of a drive."""

from pathlib import Path

import numpy as np
import pytest
import torch

from luxloop import Lamp, Module, Scenario, Simulation, idealised, load, load_lamp, pose_from_degrees
from luxloop.loop.simulation.lamps import mount
from luxloop.loop.simulation.part_cache import PartCache
from luxloop.loop.simulation.simulated import build_motion, build_scene
from luxloop.world.lamps import archive
from luxloop.world.lamps.presets import NAMES
from luxloop.world.photometry import lm63
from luxloop.world.photometry.distribution import Distribution
from luxloop.world.regulation.checking import inflection
from tests.loop.conftest import scenario_of, simulation_of, toml
from tests.refusal import refusal


@pytest.fixture(scope="module")
def lamp_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wide fixed module and a narrow one, mounted aside, that can be turned."""
    wide, narrow = idealised(4, 8, half_width_deg=20.0, intensity_cd=1000.0), idealised(4, 8, half_width_deg=5.0, intensity_cd=2000.0)
    aside = pose_from_degrees((0.0, 0.1, 0.05), pitch_deg=0.5)
    modules = (Module("wide", wide), Module("narrow", narrow, aside, swivel_deg=(-5.0, 12.0), level_deg=(-1.0, 2.0)))
    path = tmp_path_factory.mktemp("lamp") / "two.npz"
    archive.save(path, Lamp("two", modules))
    return path


@pytest.fixture
def scenario(lamp_file: Path) -> Scenario:
    return load("flat", [f"headlight.model={lamp_file}"])


def with_headlight(scenario: Scenario, **values: object) -> Scenario:
    return scenario.model_copy(update={"headlight": scenario.headlight.model_copy(update=values)})


def test_modules_are_where_they_are_mounted_and_the_finest_one_draws(tmp_path):
    """That of the first lamp, unless the symbol names its modules; the others show their base beams, here none."""
    wide, fine = idealised(10, 40, half_width_deg=20.0, intensity_cd=9000.0), idealised(100, 200, intensity_cd=50_000.0)
    aside = pose_from_degrees((0.0, 0.1, 0.05), pitch_deg=0.5)
    archive.save(tmp_path / "lamp.npz", Lamp("lamp", (Module("wide", wide), Module("fine", fine, aside))))
    small = ["camera={ width_px=320, height_px=180 }", "renderer=raycast", "headlight.lamps=['left', 'right']"]

    def drawing(*more: str) -> Simulation:
        return simulation_of(load("flat", [f"headlight.model={tmp_path / 'lamp.npz'}", *small, *more]))

    simulation = drawing()
    (module,) = simulation.symbol.projector.modules
    assert module.name == "left fine" and simulation.symbol.drawn_by == (1,)
    torch.testing.assert_close(module.T_body_headlight, pose_from_degrees((0.0, 0.7, 0.8), pitch_deg=0.5), rtol=0, atol=1e-12)
    assert module.pixel_controller.headlight.peak_cd == pytest.approx(50_000)
    assert [bool(u.any()) for u in simulation.at(0).lights] == [False, True, False, False]
    for named, by in (("fine", (1, 3)), ("right", (2, 3)), ("right fine", (3,))):
        assert drawing(f"functions.symbol.modules=['{named}']").symbol.drawn_by == by


def test_modules_shine_mirrored_turned_and_as_bright_as_asked(scenario):
    modules = mount(with_headlight(scenario, lamps=("left", "right"), modules=("wide", "narrow"), intensity_cd=8000.0).headlight)
    assert [(module.name, module.headlight.peak_cd) for module in modules] == [
        *(("left wide", 4000), ("left narrow", pytest.approx(8000)), ("right wide", 4000), ("right narrow", pytest.approx(8000)))
    ]
    assert [float(module.T_world_module[1, 3]) for module in modules] == pytest.approx([0.6, 0.7, -0.6, -0.7])
    (alone,) = mount(with_headlight(scenario, modules=("narrow",)).headlight)
    assert alone.name == "left narrow" and [each.name for each in mount(scenario.headlight)] == ["left wide", "left narrow"]
    wide, narrow = mount(with_headlight(scenario, swivel_deg=10.0, level_deg=1.5).headlight)
    assert wide.T_world_module[:3, :3].equal(pose_from_degrees((0, 0, 0), pitch_deg=1.5)[:3, :3]), "it cannot turn, and tilts with the lamp"
    expected = pose_from_degrees((0, 0, 0), pitch_deg=0.5)[:3, :3] @ pose_from_degrees((0, 0, 0), 0, 1.5, 10)[:3, :3]
    torch.testing.assert_close(narrow.T_world_module[:3, :3], expected, rtol=0, atol=1e-12)


LEVEL_DEG = 1.0


@pytest.mark.parametrize("name", [*NAMES, "measured.ies"])
def test_levelling_moves_the_cut_off_of_every_lamp_down_by_its_angle(name, tmp_path):
    if name == "measured.ies":
        v = np.linspace(-5, 3, 161)
        candela = np.hanning(21)[:, None] * np.hanning(161) * 10 ** (4 - 2 / (1 + np.exp(-(v + 0.57) / 0.2)))
        name = str(tmp_path / name)
        lm63.write(Path(name), Distribution("A", v, np.linspace(-10, 10, 21), candela))
    lamp = load_lamp(name)
    beam = lamp.beam(lamp.default_beam)

    def cut_off_deg(level_deg: float) -> float:
        scenario = load("flat", [f"headlight.model={name}", "headlight.lamps=['left']", f"headlight.level_deg={level_deg}"])
        modules = tuple(Module(each.name, each.headlight, each.T_world_module) for each in mount(scenario.headlight))
        return inflection(Lamp("levelled", modules).lit(beam), -2.5, -0.57 - level_deg)[0]

    # Scanned in steps of 0.05 deg.
    assert cut_off_deg(LEVEL_DEG) == pytest.approx(cut_off_deg(0.0) - LEVEL_DEG, abs=0.051)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"modules": ("narow",)}, "no module 'narow'; it has wide, narrow"),
        ({"swivel_deg": 15.0}, "left lamp, module 'narrow': swivel of 15 deg.*-5 to 12 deg$"),
        ({"swivel_deg": 10.0, "lamps": ("left", "right")}, "right lamp, module 'narrow': swivel of 10 deg.*-12 to 5 deg; .*mirror image"),
        (toml("{ modules = ['wide'], swivel_deg = 1.0 }"), "headlight.swivel_deg.*wide.*swivel"),
        ({"level_deg": 2.5}, "left lamp, module 'narrow': level of 2.5 deg.*-1 to 2 deg"),
        ({"model": "ssl-hdd"}, "'ssl-hdd'.*'ssl-hd'"),
        ({"thermal_k_w": 100.0, "efficacy_loss_percent_k": 5.0}, "headlight.thermal_k_w.*too hot.*lower thermal_k_w"),
    ],
)
def test_what_the_lamp_has_not_is_named(scenario, values, words):
    with refusal(words):
        mount(with_headlight(scenario, **values).headlight)


def test_the_road_is_there_under_all_that_is_met_on_a_drive():
    traffic = toml("{ seed = 3, cars = 3, parked = 2, clutter = 4 }")
    given = scenario_of('name = "met"\nsteps = 90\nroad.kind = "iso8608"\nvehicle.course = [{ speed_m_s = 15.0 }]', traffic=traffic)
    motion = build_motion(given, PartCache())
    scene = build_scene(given, motion)
    farthest_m = 0.0
    for time_s in (0.0, 1.0, 2.0):
        T_world_ground = motion.at(time_s).T_world_ground
        road, others = [], []
        for placed in scene.at(time_s, T_world_ground).placed:
            x = placed.T_world_body[0, 3] + torch.as_tensor(placed.body.mesh.vertices[:, 0])
            (others if placed.object_id else road).append(x)
        ends = torch.cat(road).max()
        assert all(float(x.mean()) < ends for x in others)
        farthest_m = max(farthest_m, *(float(x.mean() - T_world_ground[0, 3]) for x in others))
    assert farthest_m > 100, "so that a road of 90 m would end before them"
