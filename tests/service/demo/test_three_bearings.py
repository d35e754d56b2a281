"""The demo with three bearings: one configuration for all, and what the last one gained."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from service.demo.configuration import FAMILY, write_configuration
from service.demo.run import NOTHING_YET
from service.demo.score import stage_account
from service.demo.table import print_account
from service.site.settings import load_settings
from service.site.wiring import wire

from .test_score import MINUTE_US, NO_WARNING, STAGE, START_US, forecast, measured


def bench(port: int) -> Any:
    return {
        "modbus": {"host": "127.0.0.1", "port": port},
        "can": {"host": "127.0.0.1", "port": port + 1, "channel": f"socket://127.0.0.1:{port + 1}"},
        "scenario": "demo",
        "bearing": "6311",
        "rate": 100.0,
        "seed": 0,
    }


@pytest.mark.parametrize("count", [1, 3])
def test_each_bench_has_its_sources_and_several_are_one_family(tmp_path: Path, count: int) -> None:
    benches = [bench(5000 + 10 * number) for number in range(count)]
    settings_file = write_configuration(tmp_path, benches, 100.0, 0)
    settings = load_settings(settings_file)
    assert [asset.id for asset in settings.assets] == [f"bench-{k + 1}" for k in range(count)]
    assert {asset.family for asset in settings.assets} == ({FAMILY} if count > 1 else {""})
    assert len(wire(settings).sources) == 2 * count
    text = settings_file.read_text()
    assert all(f"port = {one['modbus']['port']}\n" in text for one in benches)


def test_a_forecast_without_sisters_is_scored_as_if_the_stage_had_begun_at_once() -> None:
    """It was made while the bench waited: 90 minutes before, for the stage that was next."""
    waited = forecast(-90)
    moved = waited.moved_to(START_US)
    assert moved.made_at_us == waited.made_at_us
    np.testing.assert_array_equal(moved.time_us - waited.time_us, 90 * MINUTE_US)
    after = replace(forecast(-1), quantiles={
        name: 0.5 * rows + 25.0 for name, rows in forecast(-1).quantiles.items()
    })  # fmt: skip
    account = stage_account(STAGE, after, measured(*[50.0] * 60), NO_WARNING, moved)  # type: ignore[arg-type]
    alone, row = account["without_sisters"]["t_inner_ring_c"], account["sensors"]["t_inner_ring_c"]
    # The median rises by 0.1 K a minute from 50 degC on, over the middle of 60 minutes.
    assert alone["error_c"] == pytest.approx(5.95, abs=0.01)
    assert row["error_c"] == pytest.approx(3.02, abs=0.01)
    out = io.StringIO()
    document: Any = NOTHING_YET | {"stages": [account], "sisters": {"bench-1": [], "bench-2": []}}
    print_account(document, Console(file=out, width=120))
    assert "What bench-3 gained by its sisters" in out.getvalue()
    assert "+6.0 (band ±2.0)" in out.getvalue() or "+5.9 (band ±2.0)" in out.getvalue()
    assert "+3.0 (band ±1.0)" in out.getvalue()
