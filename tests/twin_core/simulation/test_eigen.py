"""The eigenvalues and -vectors that all simulations stand on."""

import numpy as np
import pytest

from twin_core.simulation.eigen import eigen_decompose


def _decompose(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = len(matrix)
    width = -(-count // 8) * 8
    padded = np.zeros((count, width))
    padded[:, :count] = matrix
    values, vectors = np.empty(count), np.empty((count, width))
    assert eigen_decompose(padded, vectors, values)
    assert not vectors[:, count:].any()
    return values, vectors[:, :count]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 13, 24])
def test_graded_matrices_are_decomposed_to_rounding(count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(20):
        factor = rng.normal(size=(count, count)) * 10.0 ** rng.uniform(-4.0, 4.0, count)
        matrix = factor @ factor.T
        values, vectors = _decompose(matrix)
        size = np.abs(matrix).max()
        assert np.abs(vectors @ vectors.T - np.eye(count)).max() < 1e-13
        assert np.abs((vectors.T * values) @ vectors - matrix).max() < 1e-13 * size
        assert np.sort(values) == pytest.approx(np.linalg.eigvalsh(matrix), abs=1e-13 * size)


@pytest.mark.parametrize(
    "matrix", [np.zeros((5, 5)), np.eye(6), np.ones((4, 4)), np.diag([3.0, 1.0, 3.0, 0.0])]
)
def test_repeated_and_vanishing_eigenvalues(matrix: np.ndarray) -> None:
    values, vectors = _decompose(matrix)
    assert np.sort(values) == pytest.approx(np.linalg.eigvalsh(matrix), abs=1e-14)
    assert (vectors.T * values) @ vectors == pytest.approx(matrix, abs=1e-14)
