"""The map of the Modbus server, for who programs the PLC."""

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.wires

SERVER = """
[modbus_server]
tags = ["motor-1/t_inner_ring_c", "motor-1/t_inner_ring_c.time_to_alarm_s"]
"""


def test_the_map_as_table_and_as_csv(
    cli: Callable[..., Any], configure: Callable[..., Path], asset: str
) -> None:
    config = str(configure(asset + SERVER))
    table = cli("modbus-map", "-c", config)
    assert table.returncode == 0, table.stderr
    lines = table.stdout.splitlines()
    assert lines[0].split() == ["table", "address", "size", "type", "name"]
    assert lines[-1].endswith(", 2 tags, 108 registers")
    rows = list(csv.DictReader(io.StringIO(cli("modbus-map", "-c", config, "--csv").stdout)))
    assert len(rows) == len(lines) - 2
    assert [(row["address"], row["size"], row["unit"]) for row in rows if "age" in row["name"]] == [
        ("103", "1", "s"),
        ("107", "1", "s"),
    ]
    (time,) = [row for row in rows if row["name"].endswith("time_to_alarm_s")]
    assert (time["address"], time["type"], time["unit"]) == ("104", "float32", "s")


def test_a_wrong_tag_is_refused(
    refused: Callable[..., str], configure: Callable[..., Path], asset: str
) -> None:
    config = configure(asset + SERVER.replace("motor-1/t_inner_ring_c.", "motor-2/t_inner_ring_c."))
    assert "modbus_server.tags[1] = 'motor-2/" in refused("modbus-map", "-c", str(config))
