"""Draws that are kept are those that numpy would give."""

import numpy as np
import pytest

from twin_core.forecasting.draws import standard_normals


@pytest.mark.parametrize("seed", [0, 1])
def test_kept_draws_are_those_of_numpy_and_leave_the_same_state(seed: int) -> None:
    for _ in range(2):  # the second time from memory
        ours, theirs = np.random.default_rng(seed), np.random.default_rng(seed)
        for shape in ((3, 5), (100, 400, 2), (3, 5), (200, 3000, 2), (2, 2)):
            for rng in (ours, theirs):
                rng.permutation(7)
                rng.integers(5, dtype=np.int32)
            drawn = standard_normals(ours, shape)
            np.testing.assert_array_equal(drawn, theirs.standard_normal(shape))
            assert ours.bit_generator.state == theirs.bit_generator.state
