import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.offline.model_file import IdentifiedModel, ModelFileError, RunIn
from service.offline.rows import rows_of_recording
from service.offline.tables import Recording

DATED_US = 1_795_248_000_000_000
PER_HOUR = 1500.0 * 60.0


def recording(start_h: float, end_h: float, dated: bool, shift_k: float = 0.0) -> Recording:
    """A span of a warming machine; with dates its time_s begins at 0."""
    time_s = np.arange(3600.0 * start_h, 3600.0 * end_h + 1.0, 60.0)
    full = np.full(time_s.size, 1.0)
    inner = 60.0 - 38.0 * np.exp(-time_s / 3600.0) + shift_k
    start_us = DATED_US + round(3.6e9 * start_h) if dated else None
    time_s = time_s - time_s[0] if dated else time_s
    return Recording(
        "data.csv", start_us, time_s, 1500.0 * full, 2650.0 * full, 22.0 * full,
        {"t_inner_ring_c": inner},
    )  # fmt: skip


def run_in(dated: bool) -> RunIn:
    data = recording(2.0, 6.0, dated)
    return RunIn.from_dict(
        json.loads(json.dumps(RunIn.of(data, rows_of_recording(data), True).to_dict()))
    )


@pytest.mark.parametrize("dated", [True, False])
@pytest.mark.parametrize(
    ("start_h", "end_h", "hours"),
    [
        (2.0, 6.0, 0.0),  # the data themselves
        (4.5, 6.0, 2.5),  # their end
        (5.0, 9.0, 3.0),  # their end and more
        (7.0, 9.0, 4.0),  # later
        (0.5, 9.0, -1.5),  # all of the run
    ],
)
def test_a_history_of_the_same_run_takes_its_place_in_it(
    dated: bool, start_h: float, end_h: float, hours: float
) -> None:
    history = recording(start_h, end_h, dated)
    turned = run_in(dated).at_start_of(history, rows_of_recording(history))
    assert turned == pytest.approx(hours * PER_HOUR)


def test_another_run_without_dates_is_a_later_one() -> None:
    history = recording(2.0, 6.0, dated=False, shift_k=3.0)
    minutes = rows_of_recording(history)
    assert run_in(False).at_start_of(history, minutes) == pytest.approx(4.0 * PER_HOUR)
    assert not run_in(False).begins_with(history, minutes)
    same = recording(2.0, 6.0, dated=False, shift_k=0.1)
    assert run_in(False).begins_with(same, rows_of_recording(same))


def test_dates_decide_alone_and_an_earlier_run_found_the_grease_as_the_data_did() -> None:
    later = recording(30.0, 33.0, dated=True)
    assert run_in(True).at_start_of(later, rows_of_recording(later)) == pytest.approx(
        4.0 * PER_HOUR
    )
    earlier = recording(-9.0, -5.0, dated=True)
    assert run_in(True).at_start_of(earlier, rows_of_recording(earlier)) == 0.0


def test_the_past_before_the_data_is_bounded() -> None:
    history = recording(-40.0, 6.0, dated=True)
    assert run_in(True).at_start_of(history, rows_of_recording(history)) == -5.0e5


def test_a_model_file_comes_back_as_it_was(prior_model: Path, tmp_path: Path) -> None:
    loaded = IdentifiedModel.load(prior_model)
    loaded.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == prior_model.read_text()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"format_version": 2}, "format_version = 2: expected 1"),
        ({"format": "else"}, "not a model file; expected what 'bearing-twin identify' wrote"),
        ({"machine": {"model": "paper"}}, "does not belong to model 'paper'"),
        ({"machine": {"model": "thick"}}, "unknown model 'thick', expected one of"),
        ({"machine": {"bearing": {"bore_mm": 0}}}, "machine.bore_mm = 0: "),
        ({"machine": {"bearing": None}}, "bearing: missing; expected a bearing or a network"),
        ({"machine": None}, "damaged model file"),
        ({"posterior": {}}, "damaged model file"),
        ({"run_in": None}, "damaged model file"),
    ],
)
def test_unusable_model_files_are_refused(
    prior_model: Path, change: dict[str, Any], expected: str
) -> None:
    document = json.loads(prior_model.read_text())
    if change.get("machine"):
        change = {"machine": document["machine"] | change["machine"]}
    prior_model.write_text(json.dumps(document | change))
    with pytest.raises(ModelFileError) as refusal:
        IdentifiedModel.load(prior_model)
    assert str(refusal.value).startswith(f"{prior_model}: ")
    assert expected in str(refusal.value)


@pytest.mark.parametrize(
    ("bearing", "refusal"), [("6311", ""), ("6999", "unknown bearing '6999', expected one of")]
)
def test_a_file_of_an_older_release_names_a_bearing_of_the_catalogue(
    prior_model: Path, bearing: str, refusal: str
) -> None:
    document = json.loads(prior_model.read_text())
    del document["machine"]
    prior_model.write_text(json.dumps(document | {"bearing": bearing}))
    if not refusal:
        assert IdentifiedModel.load(prior_model).model.machine == "6311"
        return
    with pytest.raises(ModelFileError, match=refusal):
        IdentifiedModel.load(prior_model)


def test_what_is_no_json_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text("{")
    with pytest.raises(ModelFileError, match=r"model\.json: not JSON"):
        IdentifiedModel.load(path)
    with pytest.raises(ModelFileError, match="cannot be read"):
        IdentifiedModel.load(tmp_path / "none.json")
