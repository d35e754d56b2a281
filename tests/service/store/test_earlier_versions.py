"""A store, a backup and a model file of each released version are taken over as they lie here.

`earlier/<version>` holds what that version wrote (`make_earlier.py`): two hours of one bench with a
run that has a name, a model and a key; `facts.json` has the key's text and the id of the run.
"""

import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.engine import URL
from typer.testing import CliRunner

from service.cli.main import app
from service.clock import MINUTE_US
from service.features.runs.runs import Runs
from service.security.keys import find_key
from service.store import Store
from service.store.backup import restore
from service.store.opening import FILE_NAME
from service.store.tables import RollupRow

EARLIER = Path(__file__).parent / "earlier"
VERSIONS = sorted(folder.name for folder in EARLIER.iterdir())
CHANNELS = ("ambient_c", "load_n", "speed_rpm", "t_inner_ring_c", "t_outer_ring_c")
SAMPLES = 121


def unpack(version: str, name: str, target: Path) -> Path:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(gzip.decompress((EARLIER / version / f"{name}.gz").read_bytes()))
    return target


def facts(version: str) -> Any:
    return json.loads((EARLIER / version / "facts.json").read_text())


def require_all(store: Store, version: str) -> None:
    known = facts(version)
    for channel in CHANNELS:
        assert len(store.samples.read("bench-1", [channel], 0, 2**62, 1000)) == SAMPLES
    active = store.models.active("bench-1")
    assert active is not None
    assert (active.version, active.status, active.document["model"]) == (1, "active", "default")
    key = find_key(store, known["key"])
    assert key is not None
    assert (key.role, key.label) == ("engineer", "workshop")
    run = store.part(Runs).get("bench-1", known["run"])
    assert run is not None
    assert (run.name, run.named_by, run.ended) == ("run-in", "engineer", "standstill")


def test_there_is_one_of_the_version_before_the_first_release() -> None:
    assert "0.1.0" in VERSIONS


@pytest.mark.parametrize("version", VERSIONS)
def test_a_store_is_taken_over(version: str, tmp_path: Path) -> None:
    unpack(version, "store.db", tmp_path / FILE_NAME)
    with Store.open("", tmp_path) as store:
        require_all(store, version)
    with Store.open("", tmp_path) as store:  # and once more, as it is now
        require_all(store, version)


@pytest.mark.parametrize("version", VERSIONS)
def test_its_minutes_are_moved_into_blocks_without_a_missing_one(
    version: str, tmp_path: Path
) -> None:
    unpack(version, "store.db", tmp_path / FILE_NAME)
    with Store.open("", tmp_path) as store:

        def minutes() -> str:
            return str(store.history.read("bench-1", None, 0, 2**62, MINUTE_US, 10**6))

        def kinds() -> set[int]:
            with store._database.reading() as connection:
                return set(connection.scalars(select(RollupRow.resolution_s)))

        before = minutes()
        assert before.count("Rollup(") == SAMPLES * len(CHANNELS)
        assert kinds() == {60, 600, 3600}
        while store.rollups.pack_rows():
            assert minutes() == before
        assert kinds() == {3600}
        assert minutes() == before


@pytest.mark.parametrize("version", VERSIONS)
def test_a_backup_is_restored(version: str, tmp_path: Path) -> None:
    backup = unpack(version, "backup.db", tmp_path / "backup.db")
    url = URL.create("sqlite", database=str(tmp_path / "data" / FILE_NAME))
    (tmp_path / "data").mkdir()
    counts = restore(url, backup, force=False)
    assert counts["samples"] == SAMPLES * len(CHANNELS)
    with Store.open("", tmp_path / "data") as store:
        require_all(store, version)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_model_file_makes_a_forecast(version: str, tmp_path: Path) -> None:
    model = unpack(version, "model.json", tmp_path / "model.json")
    profile = tmp_path / "profile.csv"
    profile.write_text("time_s,speed_rpm,load_n,ambient_c\n0,1500,2650,23\n3600,1500,2650,23\n")
    out = tmp_path / "forecast.csv"
    arguments = ["forecast", model, "--profile", profile, "--out", out]
    arguments += ["--initial-temperature-c", "23"]
    result = CliRunner().invoke(app, [str(one) for one in arguments])
    assert result.exit_code == 0, result.output + repr(result.exception)
    assert len(out.read_text().splitlines()) == 3
