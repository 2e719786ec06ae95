"""Environments: Gymnasium's own check, seeds, what actions do, and many copies that are the single one."""

import copy
import pickle
import subprocess
import sys
import warnings
from math import nan
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import luxloop
from luxloop import ExtractionStatus, Randomised, RandomisedVector
from luxloop.loop.studies.environment.acting import HEIGHT_RATE_M
from luxloop.loop.studies.environment.make import register
from luxloop.loop.studies.environment.single import SymbolEnv, reward_terms
from tests.lamps import SMALL_LAMP
from tests.refusal import refusal

SMALL = (
    *(f"headlight.model={SMALL_LAMP}", "functions.symbol={ width_m=3.0, length_m=8.0 }", "renderer=raycast", "road={kind='flat'}"),
    *("camera={ width_px=240, height_px=135, oversampling=1 }", "steps=5"),
)
LATE = ("camera.latency_steps=2", "camera.drop_probability=0.4")
POSE, ERRORS, CODES = slice(0, 4), slice(4, 8), slice(8, 14)


@pytest.fixture(scope="module")
def env() -> SymbolEnv:
    return luxloop.make("snowflake", *SMALL, render_mode="rgb_array")


def played(env: gymnasium.Env, actions: np.ndarray, seed: int | None) -> list:
    """Observations and rewards of an episode."""
    told = [env.reset(seed=seed)[0]]
    for action in actions:
        told += env.step(action)[:2]
    return told


@pytest.mark.parametrize("name", ["Snowflake", "SnowflakeHeights", pytest.param("SnowflakeGains", marks=pytest.mark.slow)])
def test_gymnasium_has_no_complaint(name):
    assert f"luxloop/{name}-v0" in register()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "Sparse CSR tensor support is in beta", UserWarning)
        made = gymnasium.make(f"luxloop/{name}-v0", overrides=SMALL, render_mode="rgb_array", image=(12, 20))
        check_env(made.unwrapped)


def test_a_seed_draws_the_noise_and_nothing_else(env):
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (4, 4)).astype(np.float32)
    first, again, other = (played(env, actions, seed) for seed in (7, 7, 8))
    assert all(map(np.array_equal, first, again))
    assert not np.array_equal(first[1][ERRORS], other[1][ERRORS]) and np.array_equal(first[1][POSE], other[1][POSE])
    assert env.reset(seed=7)[1] == {"seed": 7} and env.reset(seed=None)[1]["seed"] != 7
    drawn = [played(env, actions[:1], seed) for seed in (7, None, None, 7, None)]
    assert np.array_equal(drawn[1][1], drawn[4][1]), "what follows a seed is drawn from it"
    assert not np.array_equal(drawn[1][1], drawn[2][1])
    run = luxloop.Simulation.prepare(luxloop.load("snowflake", [*SMALL, "seed=7", "functions.symbol.controller.name=open"]))
    start = {"start": run.symbol.projector.target.tolist()}
    env.reset(seed=7, options=start)
    seen = env.step(np.zeros(4, np.float32))[0]
    assert seen[ERRORS].tolist() == pytest.approx(next(run.run()).measurement.pose_error.tolist(), abs=1e-6), "as `luxloop run`"


def test_moves_move_the_symbol_as_far_as_the_controller_may(env):
    before, _ = env.reset(seed=0)
    after, reward, terminated, truncated, info = env.step(np.array([1.0, -0.5, 0.0, 2.0], np.float32))
    rate, (low, high) = env.acting.law.gains.rate_limit.numpy(), (each.numpy() for each in env.acting.limits)
    assert after[POSE] == pytest.approx(np.clip(before[POSE] + rate * [1, -0.5, 0, 1], low, high), abs=1e-6), "actions end at 1"
    assert reward == pytest.approx(sum(info["terms"].values()), abs=1e-6) and not (terminated or truncated)
    assert info["terms"]["action"] == pytest.approx(-0.01 * (1 + 0.25 + 0 + 1) / 4)
    assert info["terms"]["iou"] == pytest.approx(float(info["verdict"]["iou"]))
    assert info["is_success"] == (np.linalg.norm(info["verdict"]["centroid_percent"]) <= 5)
    assert before[CODES].argmax() == ExtractionStatus.NO_FRAME and after[CODES].argmax() == ExtractionStatus.SEEN


def test_the_reward_is_for_overlap_and_against_distance_and_action():
    said = {"iou": [1.0, 0.3, nan], "centroid_percent": [[0.0, 0.0], [60.0, -80.0], [nan, nan]]}
    metrics = SimpleNamespace(**{key: torch.tensor(each) for key, each in said.items()})
    action = torch.tensor([[0.0, 0.0], [1.0, -1.0], [0.0, 1.0]])
    assert sum(reward_terms(metrics, action).values()).tolist() == pytest.approx([1.0, 0.3 - 0.5 - 0.01, -0.5 - 0.005])


def test_a_copy_is_as_made_anew(env):
    actions = np.full((2, 4), 0.2, np.float32)
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert all(map(np.array_equal, played(copied, actions, 5), played(env, actions, 5)))


def test_a_fork_says_so_and_does_not_hang(env):
    env.reset(seed=0)
    env.step(np.zeros(4, np.float32))
    with get_context("fork").Pool(1) as pool, refusal(r"forked .* 'spawn'"):
        pool.apply_async(luxloop.make, ("snowflake", *SMALL)).get(timeout=120)


def test_an_episode_ends_with_the_scenarios_steps_and_other_actions_are_refused(env):
    env.reset(seed=0)
    for action in (np.zeros(3), np.zeros((1, 4)), np.array([0, np.nan, 0, 0])):
        with refusal(r"step: an action has the shape \(4,\) and finite numbers"):
            env.step(action.astype(np.float32))
    assert [env.step(np.zeros(4, np.float32))[3] for _ in range(5)] == [False] * 4 + [True]
    closed = luxloop.make("snowflake", *SMALL)
    closed.reset()
    closed.close()
    with refusal("call reset"):
        closed.step(np.zeros(4, np.float32))


def test_gains_that_stay_are_the_thesis_pid_and_others_are_not():
    held = luxloop.make("snowflake", *SMALL, action="gains")
    run = luxloop.Simulation.prepare(luxloop.load("snowflake", [*SMALL, "seed=3"]))
    expected = [result.symbol.pose.tolist() for result in run.evaluations()]
    told = [held.reset(seed=3)[0], *(held.step(np.zeros(6, np.float32))[0] for _ in range(4))]
    for seen, pose in zip(told, expected, strict=True):
        assert seen[POSE].tolist() == pytest.approx(pose, abs=1e-6)
    held.reset(seed=3)
    weak = [held.step(np.array([-1, -1, -1, 0, 0, 0], np.float32))[0] for _ in range(3)]
    assert abs(weak[2][0] - expected[3][0]) > 0.1, "a quarter of the gains of position leads elsewhere"


def test_heights_move_what_the_symbol_is_drawn_for():
    drawn = luxloop.make("snowflake", *SMALL, action="heights")
    drawn.reset(seed=0)
    flat, *_, plain = drawn.step(np.zeros(32, np.float32))
    risen, *_, info = drawn.step(np.ones(32, np.float32))
    assert not flat[:32].any() and risen[:32] == pytest.approx(HEIGHT_RATE_M)
    x, x_flat = (float(each["verdict"]["centroid_percent"][0]) for each in (info, plain))
    assert x > x_flat + 1, "drawn for a higher road it falls farther away on this one"


@pytest.mark.parametrize(
    ("action", "more"),
    [
        ("moves", ()),
        ("gains", LATE),
        pytest.param("moves", LATE, marks=pytest.mark.slow),
        ("moves", ("headlight.model=ssl-hd-lores", "lighting.base.beam=low")),
        pytest.param("gains", (), marks=pytest.mark.slow),
        pytest.param("gains", ("headlight.model=ssl-hd-lores", "lighting.base.beam=low"), marks=pytest.mark.slow),
    ],
)
def test_each_copy_is_the_single_environment(action, more):
    many, one = luxloop.make_vec("snowflake", 3, *SMALL, *more, action=action), luxloop.make("snowflake", *SMALL, *more, action=action)
    together, alone = many.reset(seed=10)[0], one.reset(seed=11)[0]
    actions = np.random.default_rng(1).uniform(-0.2, 0.2, (5, 3, many.single_action_space.shape[0])).astype(np.float32)
    for action_now in actions:
        assert together[1][POSE] == pytest.approx(alone[POSE], abs=2e-3)
        assert np.array_equal(together[1][CODES], alone[CODES])
        together, rewards, _, ends, infos = many.step(action_now)
        alone, reward, _, end, info = one.step(action_now[1])
        assert together[1][ERRORS] == pytest.approx(alone[ERRORS], abs=2e-3)
        assert rewards[1] == pytest.approx(reward, abs=1e-3) and ends[1] == end
        assert infos["is_success"][1] == info["is_success"]
        assert infos["verdict"]["iou"][1] == pytest.approx(float(info["verdict"]["iou"]), abs=1e-3)


def test_copies_begin_anew_as_the_mode_says():
    zero = np.zeros((2, 4), np.float32)
    following = luxloop.make_vec("snowflake", 2, *SMALL, "steps=2")
    first, _ = following.reset(seed=0)
    ends = [following.step(zero) for _ in range(4)]
    assert [each[3].tolist() for each in ends] == [[False] * 2, [True] * 2, [False] * 2, [False] * 2]
    assert np.array_equal(ends[2][0], first) and not ends[2][1].any(), "a step of its own that begins anew"

    same = luxloop.make_vec("snowflake", 2, *SMALL, "steps=2", autoreset_mode=AutoresetMode.SAME_STEP)
    same.reset(seed=0)
    same.step(zero)
    told, _, _, over, infos = same.step(zero)
    assert over.all() and np.array_equal(told, first) and np.array_equal(infos["final_obs"][0], ends[1][0][0])
    assert infos["final_info"]["terms"]["iou"].shape == (2,)

    by_hand = luxloop.make_vec("snowflake", 2, *SMALL, "steps=2", autoreset_mode="Disabled")
    by_hand.reset(seed=0)
    by_hand.step(zero)
    told, _ = by_hand.reset(options={"reset_mask": np.array([True, False])})
    assert np.array_equal(told[0], first[0]) and not np.array_equal(told[1], first[1])
    assert by_hand.step(zero)[3].tolist() == [False, True]
    with refusal("episodes are over"):
        by_hand.step(zero)


def test_stable_baselines_gets_the_copies_and_their_last_observations():
    zero = np.zeros((2, 4), np.float32)
    plain = luxloop.make_vec("snowflake", 2, *SMALL, "steps=2", autoreset_mode="Disabled")
    first, _ = plain.reset(seed=3)
    expected = [plain.step(zero) for _ in range(2)]
    learnt = luxloop.make_sb3(luxloop.make_vec("snowflake", 2, *SMALL, "steps=2", autoreset_mode="Disabled"))
    learnt.seed(3)
    assert np.array_equal(learnt.reset(), first) and [each["seed"] for each in learnt.reset_infos] == [3, 4]
    for ends, (seen, rewards, *_, infos) in zip((False, True), expected, strict=True):
        now, reward, done, told = learnt.step(zero)
        assert np.array_equal(told[1]["terminal_observation"] if ends else now[1], seen[1]) and done.tolist() == [ends] * 2
        assert reward == pytest.approx(rewards) and told[1]["verdict"]["iou"] == infos["verdict"]["iou"][1]
    assert np.array_equal(now, first), "begun anew"
    with refusal("autoreset_mode"):
        luxloop.make_sb3(luxloop.make_vec("snowflake", 2, *SMALL))


def test_stable_baselines_gets_groups_of_copies_in_worlds_of_their_own():
    def group(copies, *more):
        return luxloop.make_vec("snowflake", copies, *SMALL, "steps=2", *more, autoreset_mode="Disabled")

    rough = "road.kind=mixed"
    both, alone = luxloop.make_sb3(group(1), group(2, rough)), group(2, rough)
    both.seed(5)
    assert both.num_envs == 3 and [each["seed"] for each in (both.reset(), both.reset_infos)[1]] == [5, 6, 7]
    alone.reset(seed=6)
    actions = np.linspace(-1, 1, 12, dtype=np.float32).reshape(3, 4)
    for _ in range(2):
        now, rewards, done, told = both.step(actions)
        seen, expected, *_ = alone.step(actions[1:])
        last = now if not done.any() else np.stack([each["terminal_observation"] for each in told])
        assert np.array_equal(last[1:], seen) and rewards[1:] == pytest.approx(expected) and rewards[0] != rewards[1]
    assert done.all() and both.get_attr("steps") == [2, 2, 2] and both.get_attr("num_envs", [0, 2]) == [1, 2]


def test_starts_are_drawn_for_each_copy():
    starts = ((14.0, -1.0, -0.05, -0.02), (20.0, 1.0, 0.05, 0.02))
    drawn = luxloop.make_sb3(luxloop.make_vec("snowflake", 2, *SMALL, autoreset_mode="Disabled"), starts=starts)
    drawn.seed(1)
    poses = [drawn.reset()[:, POSE] for _ in range(2)]
    drawn.seed(1)
    assert np.array_equal(drawn.reset()[:, POSE], poses[0]) and len(np.unique(np.concatenate(poses), axis=0)) == 4
    assert all((np.float32(starts[0]) <= each).all() and (each <= np.float32(starts[1])).all() for each in poses)


def test_gymnasium_makes_the_vector_of_copies():
    made = gymnasium.make_vec("luxloop.environments:luxloop/Snowflake-v0", num_envs=2, overrides=SMALL)
    assert made.unwrapped.copies.windowed
    told, _ = made.reset(seed=[4, 9])
    assert made.observation_space.contains(told) and made.action_space.contains(made.action_space.sample())


def test_worlds_are_drawn_from_the_seed_and_shared_by_episodes():
    keys = ["road.seed=1:50", "camera.latency_steps=0:2", "disturbances.aim[0].yaw_deg=-0.2:0.2"]
    drawn = Randomised(luxloop.make("snowflake", *SMALL, "road.kind=mixed", "disturbances.aim=[{}]"), keys, every=2)
    values = [drawn.reset(seed=seed)[1]["values"] for seed in (1, None, None, 1)]
    assert values[0] == values[1] == values[3] != values[2]
    scenario = drawn.unwrapped.simulation.scenario
    assert scenario.road.seed == values[3]["road.seed"] and scenario.camera.latency_steps == values[3]["camera.latency_steps"]
    many = RandomisedVector(luxloop.make_vec("snowflake", 2, *SMALL, "road.kind=mixed"), keys[:1])
    seed = many.reset(seed=1)[1]["values"]["road.seed"]
    assert many.unwrapped.copies.simulation.scenario.road.seed == seed


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: luxloop.make("snowflak"), "there is no scenario 'snowflak'"),
        (lambda: luxloop.make("gfhb"), "symbol"),
        (lambda: luxloop.make("snowflake", *SMALL, action="move"), "there is no 'move'; did you mean 'moves'"),
        (lambda: luxloop.make_vec("snowflake", 2, *SMALL, action="heights"), "drawn one by one"),
        (lambda: luxloop.make_vec("snowflake", 2, *SMALL, "vehicle.course=[{ speed_m_s=10.0 }]"), "in which nothing moves"),
        (lambda: luxloop.make("snowflake", *SMALL).reset(options={"start": [1.0, 2.0]}), "give x and y in m"),
        (lambda: luxloop.make("snowflake", *SMALL).reset(options={"start": [[9.0, 0.0, 0.0, 0.0]] * 3}), r"in the shape \(4,\)"),
        (lambda: luxloop.make("snowflake", *SMALL).reset(options={"start": [100.0, 0.0, 0.0, 0.0]}), "give x 8 to 40"),
        (lambda: luxloop.make("snowflake", *SMALL, action="heights").reset(options={"start": [9.0, 0.0, 0.0, 0.0]}), "at its target"),
        (lambda: luxloop.make("snowflake", *SMALL, render_mode="rgb"), "render_mode: there is no 'rgb'; did you mean 'rgb_array'"),
        (lambda: luxloop.make("snowflake", *SMALL, image=(0, 5)), "rows and columns"),
        (lambda: luxloop.make("snowflake", *SMALL, device="gpu"), "device gpu"),
        (lambda: luxloop.make_vec("snowflake", 2, *SMALL, autoreset_mode="Never"), "autoreset_mode: there is no 'Never'"),
        (lambda: luxloop.make_vec("snowflake", 2, *SMALL).reset(options={"reset_mask": [True]}), "one bool for each of 2 copies"),
        (lambda: luxloop.make("snowflake", *SMALL, device="cuda:99"), "cuda"),
        (lambda: luxloop.make_vec("snowflake", 0, *SMALL), "num_envs: 0"),
        (lambda: Randomised(luxloop.make("snowflake", *SMALL), ["road.seed=1:2"], every=0), "every: 0"),
        (lambda: Randomised(luxloop.make("snowflake", *SMALL), ["road.sed=1:2"]), r"road\.sed"),
    ],
)
def test_what_cannot_be_made_is_said_so(wrong, said):
    with refusal(said):
        wrong()


def test_the_front_door_says_what_is_missing():
    program = "import sys; sys.modules['gymnasium'] = None\nimport luxloop\nluxloop.make('snowflake')"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parents[4])
    assert "pip install 'luxloop[gym]'" in told.stderr
