"""What a refused fit says of an inner ring that loses its clearance."""

import numpy as np
import pytest

from twin_core.identification import IdentificationData, IdentificationWindow
from twin_core.identification.preload import preload_warning
from twin_core.windows import MinuteData


@pytest.mark.parametrize(
    ("above_k", "climb_k_per_min", "warns"),
    [(25.0, 0.05, True), (25.0, 0.0, False), (15.0, 0.05, False), (25.0, -0.05, False)],
)
def test_only_a_ring_that_is_hot_and_climbs(
    above_k: float, climb_k_per_min: float, warns: bool
) -> None:
    time_s = 60.0 * np.arange(90)
    inner = 60.0 + above_k + climb_k_per_min * (np.arange(90) - 89)
    minutes = MinuteData(
        time_s,
        np.full(90, 5800.0),
        np.full(90, 2650.0),
        np.full(90, 22.0),
        {"t_inner_ring_c": inner, "t_outer_ring_c": np.full(90, 60.0)},
        np.ones(90, np.bool_),
    )
    said = preload_warning(IdentificationData((IdentificationWindow(minutes, at_rest=True),)))
    assert ("a runaway is possible" in said) == warns
