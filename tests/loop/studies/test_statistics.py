"""Statistics over seeds: intervals that hold the true mean as often as they say, paired tests, and their correction."""

import numpy as np
import pytest

from luxloop.loop.studies.campaign_report import compare_pairs, holm, mean


def test_an_interval_holds_the_true_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    found = [mean(rng.exponential(2.0, 40)) for _ in range(200)]
    held = np.mean([each.low <= 2.0 <= each.high for each in found])
    assert 0.87 <= held <= 0.98, "95 %; percentiles of skewed values hold a little less (Efron 1987)"
    assert mean([3.0]).low == mean([3.0]).high == 3.0


def test_runs_in_pairs_tell_a_difference_that_means_hide():
    world = np.random.default_rng(1).normal(0.8, 0.2, 20)
    difference, p = compare_pairs(world.tolist(), (world + np.linspace(0.005, 0.015, 20)).tolist())
    assert difference.value == pytest.approx(0.01) and 0.005 <= difference.low <= difference.high <= 0.015
    assert p == pytest.approx(2 / 2**20), "all of 20 signs are the same"
    assert compare_pairs([0.5, 0.6], [0.5, 0.6])[1] == 1.0


def test_holm_corrects_for_the_number_of_tests():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])  # 3 x 0.01; 2 x 0.03, which 0.04 does not undercut
    assert holm([0.6, 0.7]) == [1.0, 1.0] and holm([]) == []
