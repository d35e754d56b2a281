"""Measure the report of a run of 12 h at 1 Hz with 18 channels."""

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[4]))

from service.clock import HOUR_US
from service.features.runs.report.files import FORMATS, report_file
from service.features.runs.runs import Runs
from service.store import Store
from tests.service.features.runs.conftest import fill, section, tell

HOURS = 12.0


def main() -> None:
    asset = section()
    with tempfile.TemporaryDirectory() as folder, Store.open("", Path(folder)) as store:
        end_us = fill(store, asset, HOURS)
        tell(store, asset, HOURS)
        now_us = end_us + HOUR_US
        begin_s = time.perf_counter()
        store.part(Runs).refresh(asset.id, now_us)
        sys.stdout.write(f"runs found in {time.perf_counter() - begin_s:.2f} s\n")
        (run,) = store.part(Runs).page(asset.id, 5).items
        for format in FORMATS:
            begin_s, cpu_s = time.perf_counter(), time.process_time()
            file = report_file(store, asset, run, format, now_us)
            took_s, used_s = time.perf_counter() - begin_s, time.process_time() - cpu_s
            sys.stdout.write(
                f"{format}: {took_s:.2f} s ({used_s:.2f} s of processor), {len(file) // 1000} kB\n"
            )


if __name__ == "__main__":
    main()
