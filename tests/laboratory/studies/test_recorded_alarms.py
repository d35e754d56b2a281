"""The study recorded-alarms: on made-up turbines."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from bearing_twin_laboratory.studies.alarm_runs import Call
from bearing_twin_laboratory.studies.recorded_alarms import STUDY, Outcome, examine
from bearing_twin_laboratory.studies.study import Options, StudyError

from .test_field_data import write_turbine

pytestmark = pytest.mark.laboratory

FEBRUARY = datetime(2020, 2, 1, tzinfo=UTC)


def watched(folder: Path, offset_k: float) -> Outcome:
    """Two weeks are learned, and two weeks of the next month watched."""
    write_turbine(folder)
    write_turbine(folder, start=FEBRUARY, offset_k=offset_k)
    (order,) = STUDY.cases(Options(data=folder, quick=True))
    return examine(order)


def test_a_machine_that_is_as_it_was_is_watched_whole(tmp_path: Path) -> None:
    outcome = watched(tmp_path, 0.0)
    assert outcome.hours == pytest.approx(14 * 24.0, abs=0.5)
    assert not outcome.not_watched
    assert not [call for call in outcome.calls if call.kind != "twin residual"]


def test_a_machine_that_has_changed_is_called_for(tmp_path: Path) -> None:
    """The study hears what the service says: 40 K more break the limits and leave the model."""
    outcome = watched(tmp_path, 40.0)
    assert {"measured limit", "twin residual"} <= {call.kind for call in outcome.calls}


def test_the_first_span_teaches_and_a_span_without_a_model_is_named(tmp_path: Path) -> None:
    file = write_turbine(tmp_path)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:60]))
    write_turbine(tmp_path, start=FEBRUARY)
    (order,) = STUDY.cases(Options(data=tmp_path, quick=True))
    outcome = examine(order)
    assert outcome.hours == 0.0
    assert outcome.not_watched == {"lhb_X1_20200201": "0 low spans before it"}
    assert STUDY.report([outcome]).document["kinds"] == {}


def test_calls_are_counted_by_kind_per_1000_h() -> None:
    call = Call("twin residual", "t_rotor_bearing_c", "", 5.0)
    limit = Call("measured limit", "t_rotor_bearing_c", "warning", 5.0)
    document = STUDY.report(
        [
            Outcome("X1", "rotor bearing", 1500.0, (call, call, limit), {}),
            Outcome("X2", "rotor bearing", 500.0, (call,), {}),
        ]
    ).document
    assert document["kinds"] == {
        "measured limit": {"calls": 1, "per_1000_h": 0.5},
        "twin residual": {"calls": 3, "per_1000_h": 1.5},
    }


def test_the_study_needs_a_folder() -> None:
    with pytest.raises(StudyError, match="--data: the study recorded-alarms needs it"):
        STUDY.cases(Options())
