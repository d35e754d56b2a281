"""What a bench truly did, as a file for scoring."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO


class TruthFile:
    """CSV of true temperatures by process time in s, flushed as written; raises `ValueError`."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        try:
            self._file: TextIO = path.open("w", newline="")
        except OSError as error:
            reason = error.strerror or str(error)
            raise ValueError(f"truth {str(path)!r}: cannot be written: {reason}") from error
        self._writer = csv.writer(self._file)
        self._writer.writerow([*columns, "wall_time_us"])

    def write(self, rows: Sequence[tuple[float, ...]], wall_start_us: int, rate: float) -> None:
        """Add rows, each with the wall time at which it was due."""
        if not rows:
            return
        for row in rows:
            wall_us = wall_start_us + round(row[0] / rate * 1e6)
            self._writer.writerow([*(f"{value:.4f}" for value in row), wall_us])
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
