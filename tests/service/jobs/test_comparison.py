"""What is stored about drift when a job adds a version."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.documents.models import NOT_COMPARED, DriftDocument
from service.jobs.comparison import (
    EarlierVersion,
    drift_document,
    earlier_versions,
    report_change,
    with_drift,
)
from service.store.records import ModelVersion
from twin_core.bearings import bearing
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.models import ThermalModel, build_model
from twin_core.operating_points import OperatingSpan
from twin_core.quantities import ReferencePoint
from twin_core.windows import Window

HOUR = 3600.0
DAY_S = 86_400.0


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))


def posterior(model: ThermalModel, day: int, moved: float = 0.0, rms_k: float = 0.2) -> Posterior:
    """Posterior of a day of a machine whose outer film has moved."""
    rng = np.random.default_rng(day)
    p = model.parameters.size
    z = 0.01 * rng.normal(size=p)
    z[model.parameters.index("hext")] += moved
    point = OperatingSpan(3600.0, 2650.0, 12 * HOUR, day * DAY_S)
    return replace(
        prior_posterior(model),
        z=z,
        covariance=0.02 * np.eye(p),
        train_rms_k={"t_inner_ring_c": rms_k},
        trained=TrainedRange((point,), 720, False, 1e8),
    )


def window(day: int, hours: float = 12.0) -> Window:
    point = OperatingSpan(3600.0, 2650.0, hours * HOUR, day * DAY_S)
    return Window(day * DAY_S, day * DAY_S + hours * HOUR, (point,), False, 0.5)


def stored(
    number: int, found: Posterior, day: int, drift: DriftDocument | None, active: bool = True
) -> EarlierVersion:
    point = ReferencePoint(**dict(drift.point)) if drift and drift.point else None
    return EarlierVersion(
        number, found, [window(day)], point, bool(drift and drift.changed), active
    )


def test_first_version_has_quantities_but_nothing_to_compare_with(model: ThermalModel) -> None:
    prior = stored(1, prior_posterior(model), 0, None)
    document = drift_document(model, posterior(model, 1), [window(1)], [prior])
    assert document.changed is None
    assert document.comparison is None
    assert document.point.speed_rpm == 3600.0
    friction = document.quantities["friction"]
    assert friction.low < friction.value < friction.high
    assert friction.unit == "W"


def test_change_is_reported_until_a_changed_version_is_active(model: ThermalModel) -> None:
    first = posterior(model, 1)
    calm = drift_document(model, posterior(model, 2), [window(2)], [stored(1, first, 1, None)])
    assert calm.changed is False
    assert calm.comparison.version == 1
    assert calm.comparison.alike == "the same run again"
    moved = posterior(model, 3, -1.5)
    earlier = [stored(1, first, 1, None), stored(2, posterior(model, 2), 2, calm)]
    found = drift_document(model, moved, [window(3)], earlier)
    assert found.changed is True
    assert found.text.startswith("convection outside moved")
    assert found.comparison.version == 2
    assert found.comparison.moves[0].quantity == "convection outside"
    assert found.point == calm.point
    again = posterior(model, 4, -1.5)
    not_accepted = drift_document(
        model, again, [window(4)], [*earlier, stored(3, moved, 3, found, active=False)]
    )
    assert not_accepted.changed is True
    assert not_accepted.comparison.version == 2
    accepted = drift_document(model, again, [window(4)], [*earlier, stored(3, moved, 3, found)])
    assert accepted.changed is False
    assert accepted.comparison.version == 3


def test_creeping_change_is_reported_where_no_pair_of_versions_differs(
    model: ThermalModel,
) -> None:
    earlier: list[EarlierVersion] = []
    for day in range(1, 10):
        found = posterior(model, day, -0.08 * day)
        document = drift_document(model, found, [window(day)], earlier)
        if document.changed:
            break
        earlier.append(stored(day, found, day, document))
    assert document.creeping
    assert document.sums["convection outside"] < -3.0
    assert "creeping change of" in document.text
    assert document.comparison.probability > 0.01


def test_failed_fit_and_other_models_are_not_compared(model: ThermalModel) -> None:
    failed = drift_document(
        model,
        posterior(model, 2, rms_k=0.9),
        [window(2)],
        [stored(1, posterior(model, 1), 1, None)],
    )
    assert failed.changed is None
    assert failed.quantities == {}
    assert "the fit failed" in failed.text
    assert "possibly by a change within the data" in failed.text
    other = build_model(bearing=bearing("6016"))
    strangers = [
        stored(1, posterior(other, 1), 1, None),
        stored(2, posterior(model, 2, rms_k=0.9), 2, None),
    ]
    document = drift_document(model, posterior(model, 3), [window(3)], strangers)
    assert document.changed is None


def test_data_that_both_share_are_counted(model: ThermalModel) -> None:
    """The later version repeats half of the earlier one's window."""
    half = Window(DAY_S + 6 * HOUR, DAY_S + 18 * HOUR, window(1).operating_points, False, 0.5)
    earlier = [stored(1, posterior(model, 1), 1, None)]
    document = drift_document(model, posterior(model, 2), [half], earlier)
    assert document.comparison.shared == pytest.approx(0.5)
    assert document.sums == dict.fromkeys(document.quantities, 0.0)  # nothing to add up yet
    whole = drift_document(model, posterior(model, 2), [window(1), window(2)], earlier)
    assert whole.comparison.shared == pytest.approx(1.0)


POINT = {"speed_rpm": 3600.0, "load_n": 2650.0, "temperature_c": 50.0}


def _version(drift: dict[str, Any] | None, status: Any = "active") -> ModelVersion:
    posterior = prior_posterior(build_model(bearing=bearing("6311"))).to_dict()
    document = {"posterior": posterior, "window_records": [], "windows": []}
    if drift is not None:
        document["drift"] = drift  # type: ignore[assignment]
    return ModelVersion("bench-1", 4, status, "fits", 0, document)


def test_stored_versions_are_taken_as_they_are() -> None:
    old, rejected = earlier_versions(
        [_version(None), _version({"changed": True, "point": POINT}, "rejected")]
    )
    assert (old.point, old.reported, old.was_active) == (None, False, True)
    assert (rejected.reported, rejected.was_active) == (True, False)
    assert rejected.point == ReferencePoint(3600.0, 2650.0, 50.0)


def test_a_version_that_cannot_be_read_is_left_out() -> None:
    foreign = _version(None)
    foreign.document["posterior"] = {}
    assert earlier_versions([foreign]) == []


def test_reason_and_log_carry_a_change(capsys: pytest.CaptureFixture[str]) -> None:
    changed = {"changed": True, "text": "friction moved", "point": None}
    calm = {"changed": False, "text": "no change", "point": None}
    assert (
        with_drift("fits", NOT_COMPARED.model_copy(update=changed)) == "fits; drift: friction moved"
    )
    assert with_drift("fits", NOT_COMPARED.model_copy(update=calm)) == "fits"
    recorded: list[str] = []
    report_change("bench-1", _version(calm), recorded.append)
    report_change("bench-1", _version(None), recorded.append)
    assert recorded == []
    assert "drift_reported" not in capsys.readouterr().out
    report_change("bench-1", _version(changed), recorded.append)
    assert recorded == ["Model version 4: friction moved"]
    said = capsys.readouterr()
    assert "drift_reported" in said.out + said.err
    assert "friction moved" in said.out + said.err
