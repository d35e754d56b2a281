"""A file of a million columns, or of cells without an end, is refused soon, in a short line."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from adapters.drivers.replay.tables import open_recording
from adapters.tables import load_pyarrow
from service.offline.tables import read_profile, read_recording
from service.transfer import mdf

from .conftest import Run


def replayed(path: Path) -> None:
    with open_recording(path):
        pass


TIME = "2026-03-01T12:00:00Z"
SHORT = 700


@pytest.fixture(params=[100_000, 1_000_000])
def wide(tmp_path: Path, request: pytest.FixtureRequest) -> tuple[Path, str]:
    """A table on its side, and why it is refused."""
    path = tmp_path / "wide.csv"
    names = ",".join(f"c{number}" for number in range(request.param))
    path.write_text(f"time,{names}\n{TIME}{',1' * request.param}\n")
    if request.param == 100_000:
        return path, "line 1: 100001 columns; expected at most 10000"
    return path, "line 1: more than 4 MiB; expected at most so many"


@pytest.mark.timeout(60)
def test_a_million_columns_are_refused(run: Run, wide: tuple[Path, str], tmp_path: Path) -> None:
    path, said = wide
    mapping = tmp_path / "mapping.toml"
    mapped = "".join(f't_node_{n}_c = {{ column = "c{90_000 + n}" }}\n' for n in range(1, 13))
    mapping.write_text(f'[time]\ncolumn = "time"\n[channels]\n{mapped}')
    for more in ([], ["--mapping", mapping]):
        status, _, error = run("import", path, *more)
        assert status == 2
        assert error.startswith(f"wide.csv: {said}")
        assert len(error) < SHORT


@pytest.mark.timeout(60)
@pytest.mark.parametrize("read", [read_recording, read_profile, replayed])
def test_a_million_columns_are_refused_elsewhere(
    read: Callable[[Path], object], wide: tuple[Path, str]
) -> None:
    path, said = wide
    with pytest.raises(ValueError, match=said) as caught:
        read(path)
    assert len(str(caught.value)) < SHORT


def test_a_long_name_of_a_column_is_shown_by_its_beginning(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_text(f"time,speed_rpm,load_n,ambient_c,{'x' * 100_000}\n")
    with pytest.raises(ValueError, match="unknown column") as caught:
        read_recording(path)
    said = [str(caught.value)]
    path.write_text(f"time,channel,value,{'x' * 100_000}\n{TIME},load_n,1,1\n")
    said.append(run("import", path)[2])
    for line in said:
        assert f"{'x' * 100!r}…" in line
        assert len(line) < SHORT


@pytest.mark.parametrize("length", [100_000, 1_000_000])
def test_a_long_cell_is_shown_by_its_beginning(run: Run, tmp_path: Path, length: int) -> None:
    path = tmp_path / "long.csv"
    path.write_text(f"time,channel,value\n{TIME},t_inner_ring_c,{'x' * length}\n{TIME},load_n,1\n")
    status, report, _ = run("import", path)
    assert (status, report["stored"], report["rejected"]) == (2, 1, 1)
    (rejected,) = report["errors"]
    assert len(rejected["detail"]) < SHORT
    wide = "a cell of more than 131072 characters; expected at most so many"
    assert rejected["detail"].startswith(wide if length > 131_072 else f"value = {'x' * 100!r}…:")


@pytest.mark.parametrize("tail", ["", "\n"])
def test_a_line_without_an_end_is_refused(run: Run, tmp_path: Path, tail: str) -> None:
    path = tmp_path / "line.csv"
    path.write_text(f"time,channel,value\n{'1' * (4 * 1024**2 + 1)}{tail}")
    status, _, error = run("import", path)
    assert (status, error) == (2, "line.csv: line 2: more than 4 MiB; expected at most so many")
    path.write_text(f"time_s,speed_rpm,load_n,ambient_c\n{'1' * (4 * 1024**2 + 1)}{tail}")
    with pytest.raises(ValueError, match=r"line 2: more than 4 MiB; expected"):
        read_profile(path)


def test_parquet_has_the_same_bound(run: Run, tmp_path: Path) -> None:
    pa, parquet = load_pyarrow()
    path = tmp_path / "wide.parquet"
    parquet.write_table(pa.table({f"c{number}": [1.0] for number in range(10_001)}), path)
    status, _, error = run("import", path)
    assert (status, error) == (2, "wide.parquet: 10001 columns; expected at most 10000")


def test_an_mdf_file_is_read_in_blocks(run: Run, tmp_path: Path) -> None:
    """What is in memory does not grow with the length of a recording."""
    path, samples = tmp_path / "long.mf4", 2 * mdf.BLOCK_RECORDS + 1
    with mdf.load_asammdf().MDF(version="4.10") as file:
        file.header.start_time = datetime(2026, 3, 1, 12, tzinfo=UTC)
        times_s = np.arange(samples) / 1000
        values = 60.0 + np.sin(times_s)
        values[-1] = 9999.0
        ring = mdf.load_asammdf().Signal(values, times_s, unit="°C", name="t_inner_ring_c")
        file.append([ring])
        file.save(path)
    with mdf.open_mdf(path, None, None, None) as found:
        blocks = [(one.first, one.values.size, round(one.read, 2)) for one in found]
    most = mdf.BLOCK_RECORDS
    assert blocks == [(1, most, 0.5), (most + 1, most, 1.0), (2 * most + 1, 1, 1.0)]
    _, report, _ = run("import", path, "--dry-run")
    assert (report["rows"], report["samples"], report["rejected"]) == (samples, samples - 1, 1)
    assert report["errors"][0]["line"] == samples
