"""Make the files of this version for `test_earlier_versions.py`: ``make_earlier.py MODEL.json``.

MODEL.json is a model file of this version (`bearing-twin identify`). Called before a release; what
earlier versions made stays as it is.
"""

import gzip
import json
import sys
import tempfile
from pathlib import Path

from site_files import CHANNELS, asset_text
from sqlalchemy.engine import URL

import service
from adapters.samples import Quality, Sample
from service.clock import HOUR_US, MINUTE_US
from service.features.runs.runs import Runs
from service.jobs.models import first_model
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import AuditEntry, Store
from service.store.backup import back_up
from service.store.opening import FILE_NAME

START_US = 1_793_577_600_000_000
CONFIGURATION = asset_text("bench-1", CHANNELS)


def samples() -> list[Sample]:
    """Two hours, one sample a minute, with a run from minute 10 to 100."""
    made = []
    for minute in range(121):
        time_us = START_US + minute * MINUTE_US
        values = {
            "speed_rpm": 1500.0 if 10 <= minute < 100 else 0.0,
            "load_n": 2650.0,
            "ambient_c": 23.0,
            "t_inner_ring_c": 23 + minute / 5,
            "t_outer_ring_c": 23 + minute / 8,
        }
        made += [
            Sample("bench-1", name, time_us, value, Quality.GOOD, time_us)
            for name, value in values.items()
        ]
    return made


def make(model: Path, folder: Path, target: Path) -> None:
    """Fill a store in a folder, and pack what the tests read into another."""
    configuration = folder / "site.toml"
    configuration.write_text(CONFIGURATION)
    [asset] = load_settings(configuration).assets
    with Store.open("", folder) as store:
        store.samples.write(samples())
        store.rollups.refresh(START_US + 3 * HOUR_US)
        store.models.add("bench-1", "candidate", "as identified", first_model(asset), START_US)
        store.models.activate("bench-1", 1, "engineer", "first", START_US + HOUR_US)
        key = create_key(store, "engineer", None, "workshop").text
        runs = store.part(Runs)
        runs.refresh("bench-1", START_US + 2 * HOUR_US)
        [run] = runs.page("bench-1", 5).items
        line = AuditEntry(START_US + HOUR_US, "engineer", "", "run.name", "bench-1", "run-in")
        runs.rename("bench-1", run.id, "run-in", "engineer", line)
    back_up(URL.create("sqlite", database=str(folder / FILE_NAME)), folder / "backup.db")
    target.mkdir()
    for name, file in (
        ("store.db", folder / FILE_NAME),
        ("backup.db", folder / "backup.db"),
        ("model.json", model),
    ):
        (target / f"{name}.gz").write_bytes(gzip.compress(file.read_bytes(), mtime=0))
    (target / "facts.json").write_text(json.dumps({"key": key, "run": run.id}))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        earlier = Path(__file__).parent / "earlier" / service.__version__
        make(Path(sys.argv[1]), Path(name), earlier)
