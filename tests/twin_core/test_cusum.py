"""The threshold of the sequential test against what it promises, computed in two other ways."""

import numpy as np
import pytest
from scipy.stats import norm

from twin_core.cusum import Cusum, average_run_length, threshold_for


def markov_run_length(threshold: float, allowance: float, shift: float = 0.0) -> float:
    """Average run length of a one-sided sum as a Markov chain (Brook and Evans 1972)."""
    states = 400
    width = threshold / (states - 0.5)
    centres = width * np.arange(states)
    steps = centres[None, :] - centres[:, None] + allowance - shift
    stay = norm.cdf(steps + width / 2) - norm.cdf(steps - width / 2)
    stay[:, 0] = norm.cdf(steps[:, 0] + width / 2)
    run_lengths = np.linalg.solve(np.eye(states) - stay, np.ones(states))
    return float(run_lengths[0])


@pytest.mark.parametrize("run_length", [100.0, 1e4, 48_000.0, 1e7])
@pytest.mark.parametrize("allowance", [0.25, 0.5, 1.0])
def test_the_threshold_gives_the_promised_run_length(run_length: float, allowance: float) -> None:
    threshold = threshold_for(run_length, allowance)
    assert average_run_length(threshold, allowance) == pytest.approx(run_length, rel=1e-6)
    assert markov_run_length(threshold, allowance) == pytest.approx(run_length, rel=0.15)


@pytest.mark.parametrize(("allowance", "shift"), [(0.5, 1.0), (0.5, 2.0), (0.5, 0.5), (0.25, 0.6)])
def test_a_shift_is_found_as_soon_as_promised(allowance: float, shift: float) -> None:
    threshold = threshold_for(48_000.0, allowance)
    promised = average_run_length(threshold, allowance, shift)
    assert promised == pytest.approx(markov_run_length(threshold, allowance, shift), rel=0.05)


def test_simulated_false_alarms_come_as_seldom_as_promised() -> None:
    rng = np.random.default_rng(0)
    threshold = threshold_for(500.0, 0.5)
    runs = []
    for _ in range(300):
        cusum = Cusum(0.5, 2.0 * threshold)
        values = iter(rng.standard_normal(20_000).tolist())
        count = 0
        while cusum.high <= threshold:
            cusum.add(next(values))
            count += 1
        runs.append(count)
    # A run length is nearly exponential: the mean of 300 has a spread of 6 %.
    assert np.mean(runs) == pytest.approx(500.0, rel=0.25)


def test_both_sides_count_and_the_sums_come_down_again() -> None:
    cusum = Cusum(0.5, 10.0)
    for _ in range(100):
        cusum.add(-3.0)
    assert (cusum.high, cusum.low, cusum.value) == (0.0, 10.0, 10.0)
    for _ in range(20):
        cusum.add(0.0)
    assert cusum.value == 0.0
    cusum.add(2.0)
    cusum.reset()
    assert cusum.value == 0.0


@pytest.mark.parametrize(("run_length", "allowance"), [(1.0, 0.5), (1e13, 0.5), (100.0, 0.0)])
def test_what_cannot_be_promised_is_refused(run_length: float, allowance: float) -> None:
    with pytest.raises(ValueError, match="expected 2 to"):
        threshold_for(run_length, allowance)
