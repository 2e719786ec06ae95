"""The benchmark of tuning: rollouts are counted as they were made, and figures go where they belong on the page."""

from types import SimpleNamespace

import optuna
import tuning
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.trial import TrialState, create_trial


def test_rollouts_are_those_of_all_runs_until_a_trial_was_as_good() -> None:
    study = optuna.create_study()
    for value, state in ((0.6, "COMPLETE"), (0.9, "PRUNED"), (0.3, "COMPLETE"), (0.2, "COMPLETE")):
        space: dict[str, BaseDistribution] = {"kp": FloatDistribution(0, 1)}
        study.add_trial(create_trial(params={"kp": 0.5}, distributions=space, value=value, state=TrialState[state]))
    tuned = SimpleNamespace(study=study, task=SimpleNamespace(runs=lambda values: [None] * 3))
    assert tuning.rolled_out(tuned) == 3 + 2 + 3 + 3  # half of three runs are two
    assert tuning.rolled_out(tuned, 0.3) == 3 + 2 + 3
    assert tuning.rolled_out(tuned, 0.1) == tuning.rolled_out(tuned)


def test_figures_take_the_place_of_their_section_alone() -> None:
    page = f"# Tuning\n\nWhy.\n\n{tuning.HEADING}\n\nOld.\n\n## After it\n\nNext.\n"
    made = f"{tuning.HEADING}\n\nNew.\n"
    assert tuning.written(page, made) == page.replace("Old.", "New.")
    assert tuning.HEADING + "\n" in tuning.DOCS.read_text("utf-8")


def test_the_section_says_what_was_missed() -> None:
    way = {"way": "gradient", "held out": {"given": 0.6, "best": 0.36, "ratio": 0.6}, "rollouts": 9, "rollouts to the best": 5}
    content = {
        "machine": {"date": "2026-01-02", "processor": "a processor", "torch": "2"},
        "scenarios": ["snowflake"],
        "steps": 30,
        "size": vars(tuning.QUICK),
        "ways": [way],
        "goals": tuning.bench.judged([("cost", 0.6, 0.5, False), ("speed", 4.0, 3.0, True)]),
    }
    made = tuning.section(content)
    assert made.startswith(tuning.HEADING + "\n") and "Measured on 2026-01-02" in made
    assert "| gradient | 0.600 | 0.360 | 0.60 | 9 | 5 |" in made
    assert "| cost | 0.60 | ≤ 0.5 | **missed** |" in made and "| speed | 4.00 | ≥ 3 | reached |" in made
