import numpy as np
import pytest
from scipy.linalg import expm

from twin_core.kalman import DISTURBANCE_TIME_S, transition_and_noise

CAPACITY = np.array([100.0, 400.0])
CONDUCTANCE = np.array([[3.0, -2.0], [-2.0, 2.5]])
DISTURBANCE_W = np.array([[10.0, 0.0], [-4.0, 2.0]])
DENSITY = np.array([16.0, 4.0])


def _ours(dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    root = np.sqrt(CAPACITY)
    rate, vector = np.linalg.eigh(CONDUCTANCE / np.outer(root, root))
    modes, inverse = (vector / root[:, None]).T, (vector * root[:, None]).T
    return _whole(dt_s, rate, modes, inverse, DISTURBANCE_W, DENSITY)


def _whole(dt_s: float, *arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise of the whole state from the kernel's blocks."""
    a, b, fade, tt, td, own = transition_and_noise(
        dt_s, *(np.ascontiguousarray(argument) for argument in arguments)
    )
    eye = np.eye(len(a))
    transition = np.block([[a, b], [np.zeros_like(a), fade * eye]])
    return transition, np.block([[tt, td], [td.T, own * eye]])


def _van_loan(dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise from one matrix exponential (Van Loan 1978)."""
    a = np.zeros((4, 4))
    a[:2, :2] = -CONDUCTANCE / CAPACITY[:, None]
    a[:2, 2:] = DISTURBANCE_W / CAPACITY[:, None]
    a[2:, 2:] = -np.eye(2) / DISTURBANCE_TIME_S
    q = np.diag([*(DENSITY / CAPACITY**2), 2.0 / DISTURBANCE_TIME_S, 2.0 / DISTURBANCE_TIME_S])
    block = expm(np.block([[-a, q], [np.zeros((4, 4)), a.T]]) * dt_s)
    transition = block[4:, 4:].T
    return transition, transition @ block[:4, 4:]


@pytest.mark.parametrize("dt_s", [0.1, 10.0, 60.0, 200.0])
def test_against_van_loan(dt_s: float) -> None:
    transition, noise = _ours(dt_s)
    expected_transition, expected_noise = _van_loan(dt_s)
    assert transition == pytest.approx(expected_transition, rel=1e-9, abs=1e-12)
    assert noise == pytest.approx(expected_noise, rel=1e-6, abs=1e-12)


def test_disturbances_settle_at_variance_one() -> None:
    _, noise = _ours(20.0 * DISTURBANCE_TIME_S)
    assert np.diag(noise)[2:] == pytest.approx([1.0, 1.0])


def test_a_mode_as_fast_as_the_disturbance_is_no_singularity() -> None:
    rate = np.array([1.0 / DISTURBANCE_TIME_S])
    transition, noise = _whole(600.0, rate, np.eye(1), np.eye(1), np.eye(1), np.zeros(1))
    # the integral of exp(-a s) exp(-a (t - s)) is t exp(-a t)
    assert transition[0, 1] == pytest.approx(600.0 * np.exp(-600.0 / DISTURBANCE_TIME_S), rel=1e-3)
    assert noise[0, 0] > 0.0
