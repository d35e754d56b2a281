"""Recorded ten-minute averages of wind turbines, as a twin sees them.

Files as in the open data of the wind farm La Haute Borne (ENGIE, Etalab Open Licence 2.0): one CSV
file per gap-free span, named ``lhb_<turbine>_<first day>.csv``, with the columns of `COLUMNS`.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bearing_twin_laboratory.studies.study import StudyError
from service.clock import from_rfc3339
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

TIME = "timestamp_utc"
SPEED, TORQUE, POWER = "gen_speed_rpm", "gen_torque_Nm", "power_kW"
NACELLE, HUB = "temp_nacelle_degC", "temp_hub_degC"
ROTOR_BEARING, GENERATOR_BEARING = "temp_rotor_bearing_degC", "temp_gen_bearing1_degC"
COLUMNS = (SPEED, TORQUE, POWER, NACELLE, HUB, ROTOR_BEARING, GENERATOR_BEARING)

_FILE = re.compile(r"(?:lhb_)?(?P<turbine>.+?)(?:_\d{8})?")


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One span of a turbine's record.

    - ``name``: of the file.
    - ``time_s``: (n,) UTC, ascending.
    - ``values``: (n,) per column of `COLUMNS`; NaN where the cell is empty.
    """

    name: str
    time_s: FloatArray
    values: Mapping[str, FloatArray]

    @property
    def known(self) -> NDArray[np.bool_]:
        """(n,) whether speed, torque, power and both ambients are known."""
        inputs = (SPEED, TORQUE, POWER, NACELLE, HUB)
        table = np.stack([self.values[name] for name in inputs])
        return np.asarray(np.isfinite(table).all(axis=0))

    def runs(self, wanted: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """First row and the row after the last of every gap-free run of wanted rows."""
        rows = np.flatnonzero(wanted)
        if rows.size == 0:
            return []
        step_s = float(np.median(np.diff(self.time_s))) if self.time_s.size > 1 else 600.0
        cuts = np.flatnonzero(np.diff(self.time_s[rows]) > 1.5 * step_s) + 1
        return [(int(part[0]), int(part[-1]) + 1) for part in np.split(rows, cuts)]

    def minutes(
        self, first: int, end: int, ambient: Sequence[str], sensor: str, column: str
    ) -> MinuteData:
        """Rows as the twin takes them: the torque is the load, the mean of columns the ambient."""
        rows = slice(first, end)
        return MinuteData(
            self.time_s[rows],
            np.maximum(self.values[SPEED][rows], 0.0),
            np.maximum(self.values[TORQUE][rows], 0.0),
            np.mean([self.values[name][rows] for name in ambient], axis=0),
            {sensor: self.values[column][rows]},
            self.known[rows],
        )


def turbine_files(folder: Path) -> dict[str, list[Path]]:
    """Find the files of every turbine, by the turbine's name.

    Raises `StudyError` if there are none.
    """
    files = sorted(folder.glob("*.csv")) if folder.is_dir() else []
    if not files:
        raise StudyError(
            f"--data {folder}: no CSV files; expected a folder with files such as "
            "lhb_R80711_20141029.csv"
        )
    found: dict[str, list[Path]] = {}
    for file in files:
        match = _FILE.fullmatch(file.stem)
        found.setdefault(match["turbine"] if match else file.stem, []).append(file)
    return found


def read_record(file: Path) -> Record:
    """Read one file.

    Raises `StudyError` if it cannot be read or used; names the file, the line and the column.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as lines:
            reader = csv.DictReader(lines)
            header = reader.fieldnames or ()
            for name in (TIME, *COLUMNS):
                if name not in header:
                    raise StudyError(f"{file.name}: missing column {name!r}")
            time_s: list[float] = []
            table: dict[str, list[float]] = {name: [] for name in COLUMNS}
            for row in reader:
                time_s.append(_time_s(file, reader.line_num, row[TIME]))
                if len(time_s) > 1 and time_s[-1] <= time_s[-2]:
                    raise StudyError(
                        f"{file.name}: line {reader.line_num}: {TIME} = {row[TIME]}: expected a "
                        "time after that of the line before"
                    )
                for name, values in table.items():
                    values.append(_number(file, reader.line_num, name, row[name]))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise StudyError(f"{file}: cannot be read ({error})") from error
    if not time_s:
        raise StudyError(f"{file.name}: no rows; expected at least one")
    return Record(
        file.stem,
        np.array(time_s),
        {name: np.array(values) for name, values in table.items()},
    )


def _time_s(file: Path, line: int, text: str | None) -> float:
    try:
        return from_rfc3339((text or "").strip()) / 1e6
    except ValueError as error:
        raise StudyError(f"{file.name}: line {line}: {TIME}: {error}") from None


def _number(file: Path, line: int, name: str, text: str | None) -> float:
    if not text or not text.strip():
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise StudyError(
            f"{file.name}: line {line}: {name} = {text!r}: expected a number or an empty cell"
        ) from None
