"""An identification cut short goes on from its checkpoint as if nothing had happened."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from twin_core.identification.checkpoint import CheckpointMismatchError
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identify import FitSettings, IdentificationResult, identify
from twin_core.identification.refinement import IdentificationCancelled
from twin_core.identification.stopping import StoppingCriteria
from twin_core.models import ThermalModel
from twin_core.windows import MinuteData

BUDGET = 150


class Interrupted(Exception):  # noqa: N818 - not an error: a power cut
    """The process ends here."""


def cut_after(checkpoints: int) -> tuple[list[str], Callable[[Callable[[], Any]], None]]:
    """Keep every checkpoint as text; end after so many."""
    kept: list[str] = []

    def save(state: Callable[[], dict[str, Any]]) -> None:
        kept.append(json.dumps(state(), allow_nan=False))
        if len(kept) == checkpoints:
            raise Interrupted

    return kept, save


def assert_same(one: IdentificationResult, other: IdentificationResult) -> None:
    assert_array_equal(one.unknowns, other.unknowns)
    assert one.posterior.to_dict() == other.posterior.to_dict()
    assert one.history == other.history
    assert one.evaluations == other.evaluations
    assert one.best_fitness == other.best_fitness
    assert one.starts == other.starts


@pytest.fixture(scope="module")
def whole(model: ThermalModel, cold_start: IdentificationData) -> tuple[IdentificationResult, int]:
    """The uninterrupted identification, and how many checkpoints it offers."""
    kept, save = cut_after(0)
    found = identify(model, cold_start, FitSettings(budget=BUDGET, seed=4, samples=20), save=save)
    return found, len(kept)


def test_saving_changes_nothing(
    model: ThermalModel, cold_start: IdentificationData, whole: tuple[IdentificationResult, int]
) -> None:
    assert_same(
        identify(model, cold_start, FitSettings(budget=BUDGET, seed=4, samples=20)), whole[0]
    )


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.8, 1.0])
def test_resumed_it_is_bit_for_bit_the_uninterrupted_one(
    model: ThermalModel,
    cold_start: IdentificationData,
    whole: tuple[IdentificationResult, int],
    share: float,
) -> None:
    """Cut after the first sweep, in the search, between refined starts, and after the last."""
    found, checkpoints = whole
    kept, save = cut_after(1 + round(share * (checkpoints - 1)))
    with pytest.raises(Interrupted):
        identify(model, cold_start, FitSettings(budget=BUDGET, seed=4, samples=20), save=save)
    resumed = identify(
        model,
        cold_start,
        FitSettings(budget=BUDGET, seed=4, samples=20),
        resume=json.loads(kept[-1]),
    )
    assert_same(resumed, found)


def test_cut_short_again_and_again_it_arrives_all_the_same(
    model: ThermalModel, cold_start: IdentificationData, whole: tuple[IdentificationResult, int]
) -> None:
    resume = None
    for _ in range(4):
        kept, save = cut_after(2)
        with pytest.raises(Interrupted):
            identify(
                model,
                cold_start,
                FitSettings(budget=BUDGET, seed=4, samples=20),
                save=save,
                resume=resume,
            )
        resume = json.loads(kept[-1])
    assert_same(
        identify(model, cold_start, FitSettings(budget=BUDGET, seed=4, samples=20), resume=resume),
        whole[0],
    )


def test_cancelled_it_can_be_resumed(
    model: ThermalModel, cold_start: IdentificationData, whole: tuple[IdentificationResult, int]
) -> None:
    kept, save = cut_after(0)
    with pytest.raises(IdentificationCancelled):
        identify(
            model,
            cold_start,
            FitSettings(budget=BUDGET, seed=4, samples=20),
            save=save,
            cancelled=lambda: len(kept) >= 3,
        )
    assert len(kept) == 3
    resumed = identify(
        model,
        cold_start,
        FitSettings(budget=BUDGET, seed=4, samples=20),
        resume=json.loads(kept[-1]),
    )
    assert_same(resumed, whole[0])


def test_progress_goes_on_where_it_was(model: ThermalModel, cold_start: IdentificationData) -> None:
    kept, save = cut_after(4)
    with pytest.raises(Interrupted):
        identify(model, cold_start, FitSettings(method="noa", budget=BUDGET), save=save)
    fractions: list[float] = []
    identify(
        model,
        cold_start,
        FitSettings(method="noa", budget=BUDGET, samples=0),
        progress=lambda told: fractions.append(told.fraction),
        resume=json.loads(kept[-1]),
    )
    assert fractions[0] > json.loads(kept[-1])["fraction"] > 0.2
    assert fractions == sorted(fractions)


@pytest.mark.parametrize(
    ("other", "named"),
    [
        ({"seed": 5}, "another seed: 4, expected 5"),
        ({"budget": BUDGET + 1}, "another budget"),
        ({"method": "noa"}, "another method"),
        ({"guess_z": np.zeros(24)}, "another guess"),
        ({"stopping": StoppingCriteria(target=1.0)}, "another stopping"),
    ],
)
def test_another_order_is_refused(
    model: ThermalModel, cold_start: IdentificationData, other: dict[str, Any], named: str
) -> None:
    kept, save = cut_after(1)
    with pytest.raises(Interrupted):
        identify(model, cold_start, FitSettings(budget=BUDGET, seed=4), save=save)
    order: dict[str, Any] = {"budget": BUDGET, "seed": 4} | other
    guess_z = order.pop("guess_z", None)
    fit, saved = FitSettings(**order), json.loads(kept[0])
    with pytest.raises(CheckpointMismatchError, match=named):
        identify(model, cold_start, fit, guess_z=guess_z, resume=saved)


def test_other_data_are_refused(
    model: ThermalModel,
    cold_start: IdentificationData,
    true_z: np.ndarray,
    synthesise: Callable[..., MinuteData],
) -> None:
    kept, save = cut_after(1)
    with pytest.raises(Interrupted):
        identify(model, cold_start, FitSettings(budget=BUDGET), save=save)
    minutes = synthesise(true_z, noise_k=0.1, seed=1)
    other = IdentificationData((IdentificationWindow(minutes, at_rest=True),))
    with pytest.raises(CheckpointMismatchError, match="another data or model"):
        identify(model, other, FitSettings(budget=BUDGET), resume=json.loads(kept[0]))
    with pytest.raises(CheckpointMismatchError, match="not the checkpoint"):
        identify(model, other, FitSettings(budget=BUDGET), resume={"fraction": 0.5})
