"""A run of the virtual bench as the files of a logger."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adapters.virtual_bench.scenarios import BenchPhase

HEADER = ("time_s", "speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c")
LOW_S = 3 * 60 + 3 * 40 * 60
STEPS = (
    BenchPhase("at rest", 180.0, 0.0, 2650.0, "low"),
    BenchPhase("slow", 2400.0, 1500.0, 2650.0, "low"),
    BenchPhase("faster", 2400.0, 2400.0, 2650.0, "low"),
    BenchPhase("fast", 2400.0, 4200.0, 2650.0, "low"),
    BenchPhase("fastest", 2400.0, 5600.0, 2650.0, "high"),
)


@dataclass(frozen=True)
class Run:
    """A bench run second by second: what was measured (rows of HEADER) and the true rings."""

    measured: np.ndarray
    inner_c: np.ndarray
    outer_c: np.ndarray

    def rows(self, every_s: int, start_s: int = 0, end_s: int = LOW_S) -> np.ndarray:
        """Rows of a logger with that spacing: mean operating point, momentary temperatures."""
        table = []
        for at in range(start_s, end_s + 1, every_s):
            span = self.measured[at : min(at + every_s, end_s + 1)]
            table.append([at, *span[:, 1:3].mean(axis=0), *self.measured[at, 3:]])
        return np.array(table)


def write(path: Path, rows: np.ndarray, header: Sequence[str] = HEADER) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(
            [["" if np.isnan(cell) else f"{cell:.3f}" for cell in row] for row in rows]
        )
    return path


def read(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    table = np.array(rows, dtype=float)
    return {name: table[:, k] for k, name in enumerate(header)}


def steps_file(path: Path, rows: Sequence[Sequence[float]]) -> Path:
    return write(path, np.array(rows, dtype=float), HEADER[:4])
