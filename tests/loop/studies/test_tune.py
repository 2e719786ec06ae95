"""Tuning: what is asked for is checked first, a seeded study is the same however it is run, and what is best can be run."""

import re
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import ModuleType

import pytest
import torch
from torch import Tensor

import luxloop
from luxloop import Scenario, Simulation, load
from luxloop.loop.simulation.result import Rollout
from luxloop.loop.studies import gradient, objective, ranges
from luxloop.loop.studies import tune as module
from luxloop.loop.studies.batch.rollouts import rollouts
from luxloop.loop.studies.gradient import Surrogate, near
from luxloop.loop.studies.jobs import local
from luxloop.loop.studies.tune import FINISHED, STUDY, Task, Trace, Tuning, study_in, tune
from luxloop.loop.studies.tune_report import BEST, PICTURE, REPORT, write
from tests.lamps import SMALL_LAMP
from tests.loop.conftest import assert_refused
from tests.refusal import refusal

SMALL = [
    *("steps=3", "renderer=raycast", f"headlight.model={SMALL_LAMP}", "camera={ width_px=160, height_px=90, oversampling=1 }"),
    "functions.symbol={ width_m=3.0, length_m=8.0 }",
]
KEYS = ["functions.symbol.controller.position.kp=0.1:2:log", "functions.symbol.controller.losses_to_reset=1:4"]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load("flat", [*SMALL, "functions.symbol.controller.name=thesis_pid"])


def task(scenario: Scenario, seeds: int = 2, *keys: str) -> Task:
    """Of the sum of energy and overlap, or of overlap alone for other keys."""
    found = tuple(ranges.parse(key, [scenario]) for key in keys or KEYS)
    return Task((scenario,), found, objective.parse("iou" if keys else "iou+0.1*energy"), seeds)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("functions.symbol.controller.position.kq=0.1:2", "functions.symbol.controller.position.kq: unknown key; did you mean 'kp'"),
        ("headlight.lamps[1]=0.1:2", r"lamps\[1\]: there are 1 lamps, numbered from 0"),
        ("functions.symbol.controller.position=0.1:2", "is not a number.*such as functions.symbol.controller.position.kp"),
        ("camera.noise=0:1", "is not a number"),
        ("functions.symbol.controller.position.kp=2:0.1", "wrong way round.*write functions.symbol.controller.position.kp=0.1:2"),
        ("functions.symbol.controller.position.kp=2:2", "two different ends"),
        ("functions.symbol.controller.position.kp=2", "not of the form"),
        ("functions.symbol.controller.position.kp=0:2:log", "no logarithm"),
        ("functions.symbol.controller.position.kp=1:2:ln", "'ln' is not a scale"),
        ("functions.symbol.controller.losses_to_reset=1:2.5", "only whole numbers"),
        ("functions.symbol.controller.x_rate_m=-1:2", "greater than 0"),
    ],
)
def test_wrong_ranges_are_one_sentence(text, said, scenario):
    with refusal(f"{re.escape(text.partition('=')[0]) if '--key' in said else ''}.*{said}"):
        ranges.parse(text, [scenario])


def test_every_number_that_set_takes_is_tuned(tmp_path):
    """Items of lists, of tables in them, and keys of tables that are left out; what is best can be run with --set."""
    box = 'objects=[{kind="box", name="a", size_m=[0.4, 0.4, 0.3], track=[{position_m=[17, 1, 0]}]}]'
    scenario = load("flat", [*SMALL, "functions.symbol.controller.name=thesis_pid", box])
    keys = {
        "objects[0].track[0].position_m[1]": (-1.0, 1.0, False, 1.0),
        "objects[0].albedo": (0.1, 0.9, False, 0.2),
        "functions.symbol.controller.supervisor.grace_steps": (1, 9, True, None),
        "headlight.intensity_cd": (1000, 9000, False, None),
        "functions.symbol.controller.losses_to_reset": (1, 4, True, 2),
    }
    for key, (low, high, whole, given) in keys.items():
        assert ranges.parse(f"{key}={low}:{high}", [scenario]) == ranges.Range(key, low, high, whole=whole)
        assert ranges.value_of(scenario, key) == given
    values = {key: high for key, (_, high, _, _) in keys.items()}
    (tmp_path / BEST).write_text(ranges.overlay(values))
    run = load("flat", [*SMALL, "functions.symbol.controller.name=thesis_pid", box, str(tmp_path / BEST)])
    assert run == ranges.with_values(scenario, values)
    assert {key: ranges.value_of(run, key) for key in keys} == values


def test_a_whole_share_of_ones_own_part_says_how_it_can_be_a_fraction():
    own = load("flat", ["road={ kind='own:Road', options={ share=1, width_m=1.0 } }"])
    assert not ranges.parse("road.options.width_m=0.5:2", [own]).whole
    with refusal(r"give whole ends, or road.options.share a value with a point, such as 1.0$"):
        ranges.parse("road.options.share=0.1:1.5", [own])


@pytest.mark.parametrize(
    ("text", "said"),
    [("setling", "did you mean 'settling'"), ("2 iou", "is not a term"), ("0*iou", "weighs nothing"), ("", "is not a term")],
)
def test_wrong_objectives_are_one_sentence(text, said):
    with refusal(said):
        objective.parse(text)


def test_objectives_weigh_terms_and_failures_are_dear():
    row = {"steps": 40, "settle_step": 10, "overshoot_percent": 20.0, "residual_percent": 5.0, "iou_mean": 0.75, "utilisation_mean": 0.1}
    assert objective.parse("settling+0.5*overshoot + 2*residual+iou+energy").cost(row) == pytest.approx(0.25 + 0.1 + 1.0 + 0.25 + 0.1)
    assert str(objective.parse("settling+0.5*overshoot")) == "settling+0.5*overshoot"
    assert objective.parse("effort").cost({**row, "effort": 1.25}) == pytest.approx(0.25)
    never = {**row, "settle_step": None}
    for name in objective.TERMS:
        assert objective.parse(name).cost({}) == objective.FAILED
    assert objective.parse("settling").cost(never) > objective.parse("settling").cost({**row, "settle_step": 40})
    assert objective.parse("overshoot").cost({**row, "overshoot_percent": None}) == 0.0


def test_a_lost_symbol_is_never_cheaper_than_one_far_off():
    never = {"steps": 40, "settle_step": None, "iou_mean": 0.0, "utilisation_mean": 1.0}
    ends = ({"residual_percent": None, "overshoot_percent": None}, {"residual_percent": 40.0, "overshoot_percent": 900.0})
    for text in (*objective.TERMS, "settling+residual"):
        lost, far = (objective.parse(text).cost(never | end) for end in ends)
        assert lost >= far


def trials(tuned: Tuning) -> list[tuple[dict[str, float], float | None, str]]:
    return [(trial.params, trial.value, trial.state.name) for trial in tuned.study.trials if trial.state in FINISHED]


@pytest.fixture(scope="module")
def tuned(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Tuning:
    return tune(task(scenario), tmp_path_factory.mktemp("tuned"), 5, local(1))


def test_what_is_best_is_better_and_can_be_run(tuned, scenario, tmp_path):
    values, cost = tuned.best
    assert cost < tuned.given_cost
    assert cost == min(value for _, value, state in trials(tuned) if value is not None and state == "COMPLETE")
    for each, _, _ in trials(tuned):
        kp, losses = (each[key.partition("=")[0]] for key in KEYS)
        assert 0.1 <= kp <= 2 and losses in (1, 2, 3, 4)
    write(tuned, tmp_path)
    run = load("flat", [*SMALL, "functions.symbol.controller.name=thesis_pid", str(tmp_path / BEST)])
    assert run == ranges.with_values(scenario, values)
    text = (tmp_path / REPORT).read_text()
    assert f"| cost |  | {tuned.given_cost:.4g} | {cost:.4g} |" in text and "5 trials" in text
    assert (tmp_path / PICTURE).stat().st_size > 5_000


@pytest.mark.slow
def test_two_symbols_beside_a_lane_are_tuned_but_not_by_gradient(tmp_path):
    other = "functions.other={ kind='symbol', image='snowflake', y_m=2.0, width_m=4.0, length_m=8.0, controller='thesis_pid' }"
    two = load("flat", [*SMALL, other, "functions.carpet={ kind='lane', value=0.3 }"])
    found = ("functions.symbol.controller.position.kp=0.1:2", "functions.carpet.value=0.1:0.5")
    both = Task((two,), tuple(ranges.parse(key, [two]) for key in found), objective.parse("iou+energy"))
    tuned = tune(both, tmp_path / "two", 3, local(1))
    (first, cost, _), *others = trials(tuned)
    assert first == both.start_values and cost == tuned.given_cost < objective.FAILED and not tuned.failures
    assert len(others) == 2 and all(each is not None and each != cost for _, each, _ in others)
    with refusal(r"flat: --gradient: .*not one"):
        gradient.tune_by_gradient(both, tmp_path / "gradient", 1, local(1))


def interrupted(monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str, at: int) -> None:
    """Ctrl-C in place of a function's call of that number."""
    original, calls = getattr(module, name), count(1)

    def stopping(*arguments: object) -> object:
        if next(calls) == at:
            raise KeyboardInterrupt
        return original(*arguments)

    monkeypatch.setattr(module, name, stopping)


@pytest.mark.slow
def test_a_seeded_study_is_the_same_with_more_processes_and_after_a_stop(tuned, scenario, tmp_path, monkeypatch):
    interrupted(monkeypatch, module, "_run_jobs", 3)  # in the second half of the random trials, of which none is told yet
    with pytest.raises(KeyboardInterrupt, match="1 of 5 trials are kept"):
        tune(task(scenario), tmp_path, 5, local(1))
    monkeypatch.undo()
    for found, expected in zip(trials(tune(task(scenario), tmp_path, 5, local(2))), trials(tuned), strict=True):
        assert (found[0], found[2]) == (expected[0], expected[2])
        assert found[1] == pytest.approx(expected[1], abs=1e-3), "batches of other sizes round otherwise"


def test_random_trials_are_run_together_and_cost_what_they_cost_alone(tuned, scenario):
    given, execute = task(scenario), local(1)
    assert module.note_batches(given, 1, False) == "runs in batches of up to 8 in the first 8 trials"
    assert module.note_batches(given, 2, True) is None
    more = module.note_batches(replace(given, seeds=6), 1, False)
    assert more == "runs in batches of up to 16 in the first 8 trials, of up to 3 in the others"
    for values, cost, state in trials(tuned)[1:]:
        if state == "COMPLETE":
            alone = [module.run_all(given, [run], execute)[0][0] for run in given.runs(values)]
            assert cost == pytest.approx(sum(alone) / len(alone), abs=1e-3)


def test_what_scenarios_do_not_share_has_no_start_value():
    """No trial says that one's gain costs what each costs with its own; the search by gradient starts in the middle of the range."""
    low, high = (load("snowflake", [*SEEN, f"functions.symbol.controller.position.kp={kp}"]) for kp in (0.3, 0.6))
    both = Task((low, high), small(low).ranges, objective.parse("iou"))
    position, rotation = both.start_values.values()
    assert position is None and rotation == small(low).start_values["functions.symbol.controller.rotation.kp"]
    assert gradient._logits(both, both.start_values)[0] == 0


def test_another_search_has_other_trials(tuned, scenario, tmp_path):
    other = tune(replace(task(scenario), seed=1), tmp_path, 2, local(1))
    (first, *others), (given, *own) = trials(other), trials(tuned)
    assert first == given and first[0] == task(scenario).start_values  # what both know from the start
    assert not {str(values) for values, _, _ in others} & {str(values) for values, _, _ in own}


def test_robust_trials_also_run_on_perturbed_plants(scenario, tmp_path):
    key = "functions.symbol.controller.position.kp"
    robust = replace(task(scenario, 1, f"{key}=0.1:2"), robust=True)
    runs = [each["scenario"] for each in robust.runs({key: 0.5})]
    gains = [each["functions"]["symbol"]["controller"]["position"]["kp"] for each in runs]
    latencies = [each["camera"]["latency_steps"] for each in runs]
    assert list(zip(gains, latencies, strict=True)) == [(0.5, 0), (0.4, 0), (0.625, 0), (0.5, 1)]
    assert [len(half) for half in replace(robust, seeds=3).halves(replace(robust, seeds=3).runs({}))] == [8, 4]
    assert robust.cost([1.0, 1.0, 1.0, 2.0]) == pytest.approx((1.25 + 2) / 2)
    tuned = tune(robust, tmp_path / "robust", 1, local(1))
    assert tuned.given_cost == pytest.approx(trials(tuned)[0][1])
    with refusal(r"--gradient: .*leave out either"):
        gradient.tune_by_gradient(robust, tmp_path / "gradient", 1, local(1))
    other = load("flat", [*SMALL, "functions.symbol.controller.name=gauss_newton"])
    with refusal(r"functions\.symbol\.controller: --robust scales fixed gains of thesis_pid"):
        replace(task(other, 1, "functions.symbol.controller.gain=0.1:0.9"), robust=True).runs({})


FRAIL = """
from luxloop.controllers.symbol.heights.feedforward import OpenLoop
from luxloop.world.errors import LuxloopError


class Frail(OpenLoop):
    def __init__(self, sensor, weight):
        if weight > 0.5:
            raise IndexError("too heavy")
        super().__init__(sensor.projector.target)
"""


@pytest.fixture
def frail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "frail_controllers.py").write_text(FRAIL)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_failures_of_trials_are_told_and_those_of_all_given_runs_stop(frail):
    def weighing(weight: float) -> Task:
        own = f"functions.symbol.controller={{ name='frail_controllers:Frail', options={{ weight={weight} }} }}"
        return task(load("flat", [*SMALL, own]), 1, "functions.symbol.controller.options.weight=0.0:1.0")

    folder = frail / "study"
    with refusal(r"every run with the given values fails.*IndexError: too heavy"):
        tune(weighing(0.9), folder, 1, local(1))
    tuned = tune(weighing(0.1), folder, 4, local(1))  # in the same folder, of which nothing was made
    heavy = [values for values, cost, _ in trials(tuned) if cost == objective.FAILED]
    assert 0 < len(heavy) < 4 and all(values["functions.symbol.controller.options.weight"] > 0.5 for values in heavy)
    assert len(tuned.failures) == len(heavy)
    write(tuned, folder)
    assert re.search(rf"{len(heavy)} runs? failed, the first: .*IndexError: too heavy", (folder / REPORT).read_text())


def test_an_option_that_a_class_of_ones_own_lacks_is_refused_before_anything_is_made(frail, lux):
    given = ["--controller", "frail_controllers:Frail", "--trials", "1", "--jobs", "1", "--objective", "iou", "--set", *SMALL]
    done = lux("tune", "flat", "--key", "functions.symbol.controller.options.wieght=0.1:0.4", *given)
    assert_refused(done, "controller.options.wieght: ", "did you mean 'weight'?")
    assert not (frail / "runs").exists()


@pytest.mark.parametrize("line", [b"{}", b"[]", b'{"op_code": 4}', b"[" * 100_000, b'{"op_code": 99, "worker_id": ""}'])
def test_a_damaged_journal_is_one_sentence(line, tmp_path):
    with study_in(tmp_path, "digest") as study:
        study.tell(study.ask(), 1.0)
    file = tmp_path / STUDY
    kept = file.read_bytes().splitlines()
    file.write_bytes(b"\n".join([*kept[:1], line, *kept[1:], b""]))
    with refusal(r"study\.log: is not a study's journal"), study_in(tmp_path, "digest"):
        pass


def test_other_settings_need_another_folder(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / STUDY).write_text("notes of mine\n")
    (tmp_path / "file").write_text("")
    with study_in(tmp_path / "study", "digest"):
        pass
    for folder, said in (("study", "study of other settings"), ("a", "is not a study's journal"), ("file", "cannot be written")):
        with refusal(said), study_in(tmp_path / folder, "other"):
            pass


def test_programs_tune_as_the_command_does(scenario, tuned, tmp_path):
    keys = [f"{each.key}={each.low}:{each.high}{':log' if each.log else ''}" for each in tuned.task.ranges]
    study = {"terms": str(tuned.task.objective), "seeds": tuned.task.seeds, "seed": tuned.task.seed, "device": "cpu"}
    found = luxloop.tune(scenario, keys, tmp_path, trials=2, jobs=1, **study)
    costs = [each.value for each in tuned.trials[:2]]
    # Batches of other sizes round sums in another order; a digital number that this turns by one moves poses by some 1e-4 m.
    assert [each.value for each in found.trials] == pytest.approx(costs, rel=1e-4) and (tmp_path / REPORT).is_file()


def test_command(lux):
    given = ["--objective", "settling", "--trials", "2", "--jobs", "1", "--set", *SMALL, "functions.symbol.controller.name=thesis_pid"]
    code, out, error = lux("tune", "flat", "--key", *KEYS, *given)
    assert code == 0 and "runs/tune-flat" in out and "No trial settled; raise steps. All runs are on one road" in out
    assert "coupled, given" in out
    assert error == "runs in batches of up to 8 in the first 8 trials\n"  # not that of an empty folder something was done before
    assert_refused(lux("tune", "flat"), "--key: is missing")
    nothing_held = lux("tune", "gfhb", "--key", "functions.guard_traffic.margin_m=0.1:1")
    assert_refused(nothing_held, "gfhb: no controller holds a symbol", "--objective energy")
    for option in ("--trials", "--jobs"):
        assert_refused(lux("tune", "flat", "--key", KEYS[0], option, "0"), f"for {option}; must be >= 1")


SEEN = [
    *("steps=4", "functions.symbol.controller.name=thesis_pid", f"headlight.model={SMALL_LAMP}", "renderer=raycast", "road.kind=flat"),
    *("functions.symbol={ width_m=3.0, length_m=8.0, start.x_m=15.0 }", "camera={ width_px=240, height_px=135, oversampling=1 }"),
]


def small(scenario: Scenario) -> Task:
    gains = ("functions.symbol.controller.position.kp=0.05:1.5:log", "functions.symbol.controller.rotation.kp=0.05:1")
    return task(scenario, 1, *gains)


def test_descent_learns_from_its_runs_and_goes_on_after_a_stop(tmp_path, monkeypatch):
    monkeypatch.setattr(gradient, "STEPS", 20)
    slow = small(load("snowflake", [*SEEN, "functions.symbol.controller.position.kp=0.1"]))
    tuned = gradient.tune_by_gradient(slow, tmp_path / "whole", 3, local(1))
    start, *others = trials(tuned)
    assert start == (slow.start_values, tuned.given_cost, "COMPLETE")
    simulation = Simulation.prepare(slow.scenarios[0])
    before, *after = (
        float(gradient.loss(rollouts(simulation, {key: torch.tensor([value]) for key, value in values.items()}), simulation))
        for values, _, _ in (start, *others)
    )
    assert len(after) == 2 and min(after) < before
    interrupted(monkeypatch, gradient, "run_all", 2)
    with pytest.raises(KeyboardInterrupt, match="2 of 3 iterations are kept"):
        gradient.tune_by_gradient(slow, tmp_path / "stopped", 3, local(1))
    assert trials(gradient.tune_by_gradient(slow, tmp_path / "stopped", 3, local(1))) == trials(tuned)


def test_what_has_been_run_is_predicted_and_differentiable_in_gains():
    simulation = Simulation.prepare(load("snowflake", SEEN))
    gains = {"functions.symbol.controller.position.kp": torch.tensor([0.5]), "functions.symbol.controller.rotation.kp": torch.tensor([0.4])}
    run = rollouts(simulation, gains)
    scene = Surrogate.of([run], 0)
    assert len(scene.poses) == 4
    predicted = scene.predict(simulation, gains, torch.zeros(4, 1, 4))
    # Other places lie tens of what is near apart, and have a ten-thousandth of the weight.
    assert ((predicted.poses - run.poses) / near(simulation)).abs().max() < 0.1

    precise = Surrogate(*(part.double() for part in vars(scene).values()))
    noise = torch.randn(4, 1, 4, dtype=torch.float64)

    def errors(*values: Tensor) -> Tensor:
        return precise.predict(simulation, dict(zip(gains, values, strict=True)), noise).errors

    at = [torch.tensor([value], dtype=torch.float64, requires_grad=True) for value in (0.4, 0.3)]
    assert torch.autograd.gradcheck(errors, at)


def test_a_run_that_saw_little_knows_nothing_of_noise():
    poses, seen = torch.zeros(1, 30, 4), torch.arange(30)[None] < 30
    long = Rollout(poses, 0.1 * torch.randn(1, 30, 4, generator=torch.Generator().manual_seed(0)), seen)
    short = replace(long, seen=torch.arange(30)[None] < 1)
    assert Surrogate.of([long], 0).noise.min() > 0
    assert torch.equal(Surrogate.of([long, short], 0).noise, Surrogate.of([long], 0).noise)


def test_scenarios_of_which_all_runs_fail_are_named_with_the_reason(tmp_path):
    fine = load("snowflake", SEEN)
    broken = fine.model_copy(update={"name": "broken"})
    both = Task((fine, broken), small(fine).ranges, objective.parse("iou"))
    simulations = [Simulation.prepare(each) for each in both.scenarios]
    run = rollouts(simulations[0], {key: torch.tensor([0.3]) for key in both.start_values})
    seen: Trace = [part[0].tolist() for part in vars(run).values()]
    with refusal(r"^broken: IndexError: too far, .*tune without --gradient$"):
        gradient.descend(both, simulations, [gradient.Iteration(both.start_values, 1.0, [seen, "IndexError: too far"])])


@pytest.mark.parametrize("given", [5.4321e-8, 0.12345678])
def test_what_descent_finds_keeps_its_digits_and_its_range(given):
    key = "functions.symbol.controller.position.ki"
    tuned = task(load("snowflake", [*SEEN, "steps=3", f"{key}={given}"]), 1, f"{key}={0.9999999 * given}:{1.0000001 * given}:log")
    (found,) = gradient._values(tuned, gradient._logits(tuned, tuned.start_values)).values()
    assert tuned.ranges[0].low <= found <= tuned.ranges[0].high


@pytest.mark.parametrize(
    ("change", "key", "said"),
    [
        ("steps=4", KEYS[1], "losses_to_reset: takes whole numbers"),
        ("functions.symbol.extraction.kind=own:Extraction", KEYS[0], r"extraction.kind: no error model for .* leave it out"),
        (
            "functions.symbol.start_s=0.03",
            KEYS[0],
            r"functions\.symbol\.start_s: batches show the symbol in all steps; .*without --gradient",
        ),
        ("functions.symbol.extraction={ area_low=0.9999999, area_high=1.0000001 }", KEYS[0], "its symbol is never seen"),
    ],
)
def test_what_cannot_be_descended_on_is_refused(change, key, said, tmp_path):
    with refusal(said):
        gradient.tune_by_gradient(task(load("snowflake", [*SEEN, change]), 1, key), tmp_path, 2, local(1))
