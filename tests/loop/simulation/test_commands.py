"""Functions turn and dim modules: the light follows, other functions aim by the turned modules, and plants get the commands."""

import math
from typing import Any

import pytest
import torch

from luxloop import ModuleCommand, Scenario, run
from luxloop.loop.recording.record import schema
from luxloop.loop.simulation.result import StepResult
from luxloop.world.headlight.lamp import REST
from tests.loop.conftest import scenario_of, simulation_of, toml
from tests.refusal import sentence

LAMP = """
name = "moving"
[[module]]
name = "fine"
source = { kind = "preset", name = "ssl-hd-lores" }
swivel_deg = [-7, 15]
level_deg = [-2, 2.5]
"""
OWN = """
from luxloop import ModuleCommand

class Waving:
    def __init__(self, module="left", swivel_deg=3.0, intensity=0.5):
        self.module, self.command = module, ModuleCommand(swivel_deg, intensity=intensity)
    def primitives(self, now):
        return []
    def commands(self, now):
        return {self.module: self.command}
"""
COMMANDED = """
name = "commanded"
steps = 3
rate_hz = 10
camera = { width_px = 320, height_px = 180, oversampling = 1 }
surface.grain = 0.0
headlight.lamps = ["left"]
lighting.base.beam = "full"
renderer = "raycast"
"""
OFF = "lighting.base.beam=off"
PATCH = toml("{ kind = 'path', control_m = [[20, -0.5], [26, -0.5]], width_m = 2.0, quantity = 'E_v', value = 0.5 }")


@pytest.fixture(scope="module")
def lamp(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("lamp") / "moving.toml"
    file.write_text(LAMP)
    return str(file)


def scenario(lamp: str, functions: dict[str, Any], *overrides: str, **changes: Any) -> Scenario:
    return scenario_of(COMMANDED, f"headlight.model={lamp}", *overrides, functions=functions, **changes)


def results(*given: Any, **changes: Any) -> list[StepResult]:
    return list(simulation_of(scenario(*given, **changes)).evaluations())


def test_commanded_modules_shine_as_those_that_are_mounted_so(lamp):
    level = toml("{ kind = 'levelling', dynamic = false, entries = [{ level_deg = 1.5 }] }")
    (commanded,) = results(lamp, {"level": level}, "steps=1")
    (mounted,) = results(lamp, {"carpet": PATCH | {"stop_s": 0.0, "start_s": -1.0}}, "steps=1", "headlight.level_deg=1.5")
    assert commanded.now.commands == (ModuleCommand(0.0, 1.5),) and mounted.now.commands == ()
    assert float(commanded.illuminance.max()) > 1
    # poses are rounded at other places, which moves borders of texels by as little
    torch.testing.assert_close(commanded.illuminance, mounted.illuminance, rtol=1e-4, atol=1e-4)


def test_bending_turns_light_and_what_functions_know_into_a_curve(lamp):
    (result, *_) = results(lamp, {"bend": {"kind": "bending"}}, "vehicle.course=[{ speed_m_s=10.0, curvature_1_m=0.01 }]")
    expected = math.asin(0.01 * 2.0 * 10.0 / 2)
    (_, light), *_ = result.now.lights
    # the rear axle's speed is measured as the mean of a period, and the curvature with it
    assert math.radians(result.now.commands[0].swivel_deg) == pytest.approx(expected, rel=1e-3)
    assert math.atan2(*light.T_world_headlight[[1, 0], 0].tolist()) == pytest.approx(expected, rel=2e-3)


def test_levelling_holds_the_beam_over_the_ground_while_the_body_pitches(lamp):
    sways = "vehicle={ course=[{ speed_m_s=15.0 }], oscillation={ pitch_deg=1.0, rate_hz=1.1 } }"

    def heights_m(functions: dict[str, Any]) -> list[float]:
        """Of the beam's axis over the ground, 25 m ahead."""
        simulation = simulation_of(scenario(lamp, functions, "steps=10", sways))
        heights = []
        for result in simulation.evaluations():
            (command, *_) = result.now.commands or (REST,)
            T = simulation.world.motion.at(result.time_s).T_ground_body @ command.turn(simulation.modules[0].T_world_module)
            heights.append(float(T[2, 3] + 25 / T[0, 0] * T[2, 0]))
        return heights

    still, swaying = heights_m({"level": {"kind": "levelling"}}), heights_m({})
    assert max(swaying) - min(swaying) > 0.7, "1 deg at 25 m is 0.44 m up and down"
    # what is left is the period of 0.1 s by which the sensors are late, and the rotation about a pivot behind the lamps
    assert max(still) - min(still) < 0.15 * (max(swaying) - min(swaying))


def test_dimming_halves_flux_and_light(lamp):
    dim = toml("{ kind = 'dimming', entries = [{ time_s = 0.1, share = 1.0 }, { time_s = 0.2, share = 0.5 }] }")
    bright, _, dimmed = results(lamp, {"dim": dim})
    assert dimmed.powers["left"].flux_lm == pytest.approx(0.5 * bright.powers["left"].flux_lm)
    assert dimmed.powers["left"].share == pytest.approx(0.5) and dimmed.lights[0].equal(bright.lights[0])
    torch.testing.assert_close(dimmed.illuminance, 0.5 * bright.illuminance)
    (limited, *_) = results(lamp, {"dim": dim | {"entries": [{"share": 0.5}]}}, "lighting.power_limit=0.4")
    assert limited.powers["left"].share == pytest.approx(0.4) and limited.powers["left"].factor == pytest.approx(0.8)


def test_a_dimmed_module_gives_the_lux_that_are_asked_for_as_far_as_it_can(lamp):
    def lit(share: float | None = None, **patch: Any) -> StepResult:
        dim = {} if share is None else {"dim": {"kind": "dimming", "entries": [{"share": share}]}}
        return results(lamp, {"patch": PATCH | patch} | dim, OFF)[0]

    plain, dark = lit(), lit(0.0)
    assert float(plain.illuminance.max()) == pytest.approx(0.5, rel=0.3), "what is asked for, but for pixels that are coarse there"
    torch.testing.assert_close(lit(0.6).illuminance, plain.illuminance, rtol=1e-3, atol=1e-3)  # of single precision over many rays
    share = {"quantity": "u_abs", "value": 0.5}
    torch.testing.assert_close(lit(0.6, **share).illuminance, 0.6 * lit(**share).illuminance)
    assert not dark.illuminance.any() and all(bool(u.isfinite().all()) for u in dark.lights)


def test_what_was_commanded_is_recorded_and_played_again(lamp, tmp_path):
    functions = toml("""
bend = { kind = "bending", rate_deg_s = 5.0 }
dim = { kind = "dimming", entries = [{ share = 1.0 }, { time_s = 0.2, share = 0.5 }] }
""")
    bends = "vehicle.course=[{ speed_m_s=10.0 }, { time_s=0.2, speed_m_s=10.0, curvature_1_m=0.02 }]"
    shown: list[StepResult] = []
    table = run(scenario(lamp, functions, bends), tmp_path, frames=True, video=False, report=False, on_step=shown.append).trajectory
    assert table["modules.left fine.intensity"].to_pylist() == pytest.approx([1.0, 0.75, 0.5])
    assert table["modules.left fine.swivel_deg"].to_pylist() == [each.now.commands[0].swivel_deg for each in shown]
    assert [each.exposures[0].commands for each in shown] == [each.now.commands for each in shown]
    played = results(lamp, functions, bends, plant={"kind": "recording", "folder": str(tmp_path)})
    frames = [frame for each in played for frame in each.reception.frames]
    assert [frame.shown.commands for frame in frames if frame.shown] == [each.now.commands for each in shown]


SYMBOL = toml("{ kind = 'symbol', image = 'snowflake', controller = 'open' }")
COMMAND = toml("{ kind = 'command', swivel_deg = 3.0, level_deg = 0.5, intensity = 0.5 }")
WRONG: dict[str, tuple[dict[str, Any], str | None, str]] = {
    "no swivel": ({"a": {"kind": "bending"}}, "hd84", "functions.a.modules: none of these modules can be swivelled"),
    "no level": ({"a": {"kind": "levelling"}}, "hd84", "functions.a.modules: none of these modules can be levelled"),
    "no module": (toml("{ a = { kind = 'bending', modules = ['coarse'] } }"), None, "functions.a.modules"),
    "held and commanded": (
        {"flake": SYMBOL, "a": COMMAND},
        None,
        "functions.flake.modules: 'left fine' is turned or dimmed by functions.a",
    ),
    "own, no module": (
        toml("{ own = { kind = 'own:Waving', options.module = 'right' } }"),
        None,
        "own:Waving: commands the module 'right'",
    ),
    "own, no share": (toml("{ own = { kind = 'own:Waving', options.intensity = 2.0 } }"), None, "own:Waving: commands gives"),
}


def test_a_module_goes_where_it_is_commanded_within_its_range_and_back(lamp):
    simulation = simulation_of(scenario(lamp, {"a": COMMAND | {"swivel_deg": 90.0, "stop_s": 0.15}, "patch": PATCH}))
    first, _, last = (each.now.commands for each in simulation.evaluations())
    (module,) = simulation.modules
    assert first == (ModuleCommand(module.swivel_deg[1], 0.5, 0.5),) and last == (REST,)
    columns = {"modules.left fine.swivel_deg", "modules.left fine.level_deg", "modules.left fine.intensity"}
    assert columns <= set(schema(simulation).names)


@pytest.mark.usefixtures("own")
@pytest.mark.parametrize(("functions", "model", "words"), WRONG.values(), ids=WRONG.keys())
def test_what_cannot_be_commanded_is_refused_in_a_sentence(functions, model, words, lamp):
    with sentence(words):
        results(model or lamp, functions, OFF)


def test_a_symbol_is_held_beside_another_lamp_that_moves(lamp):
    functions = {
        "flake": SYMBOL | {"modules": ["left"]},
        "level": toml("{ kind = 'levelling', modules = ['right'], entries = [{ level_deg = 1.0 }] }"),
    }
    (result,) = results(lamp, functions, "steps=1", "headlight.lamps=['left', 'right']", OFF)
    assert result.now.commands == (REST, ModuleCommand(0.0, 1.0)) and float(result.held["flake"].metrics.iou) > 0.5
