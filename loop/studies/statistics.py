"""Statistics over seeds: bootstrap intervals of means, and paired tests with correction for their number."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
RESAMPLES = 5000


@dataclass(frozen=True)
class Mean:
    """A mean, and its 95 % interval by the bootstrap's percentiles (Efron 1979); both ends are the mean for a single value."""

    value: float
    low: float
    high: float


def mean(values: Sequence[float]) -> Mean:
    """Mean of at least one value."""
    value = float(np.mean(values))
    if len(values) < 2:
        return Mean(value, value, value)
    found = stats.bootstrap(
        (np.asarray(values, float),), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, method="percentile", rng=0
    )
    return Mean(value, float(found.confidence_interval.low), float(found.confidence_interval.high))


def compare_pairs(first: Sequence[float], second: Sequence[float]) -> tuple[Mean, float]:
    """Mean of the differences second - first of runs in pairs, and p of the two-sided signed-rank test (Wilcoxon 1945)."""
    differences = np.subtract(second, first)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all differences are zero
        p = float(stats.wilcoxon(differences).pvalue) if differences.any() else 1.0
    return mean(differences.tolist()), p


def holm(p: Sequence[float]) -> list[float]:
    """Values of p of several tests, corrected for their number (Holm 1979)."""
    order = np.argsort(p)
    stepped = np.maximum.accumulate(np.asarray(p)[order] * np.arange(len(p), 0, -1))
    corrected = np.empty(len(p))
    corrected[order] = stepped.clip(max=1.0)
    return corrected.tolist()
