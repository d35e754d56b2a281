"""The folder through which a worker process and the service talk about one job.

Files, because they work the same for a process pool on this machine and for a cluster that shares
a folder, and because they outlive either side: the worker writes its progress and, now and then, a
checkpoint from which another worker can go on; the service leaves a mark when the job is to stop.
"""

import json
import math
import shutil
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

MOST_POINTS = 300
_PROGRESS = "progress.json"
_CHECKPOINT = "checkpoint.json"
_CANCEL = "cancel"
_LIFE = "life"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is.

    Attributes
    ----------
    fraction
        0 to 1.
    phase
        What the worker is at, such as ``"search"`` or ``"gates"``.
    evaluations
        Simulations of the data set so far.
    best_fitness
        Smallest sum of squared residuals so far.
    active_fitness
        The active model's sum of squared residuals on the same data; None where it has none.
    convergence
        Evaluations and best fitness on the way here, see `Convergence`.
    """

    fraction: float
    phase: str
    evaluations: int
    best_fitness: float | None
    active_fitness: float | None = None
    convergence: list[list[float]] = field(default_factory=list)


class Convergence:
    """How the best fitness fell: pairs of evaluations and fitness, never very many."""

    def __init__(self, points: Iterable[Sequence[float | None]] = ()) -> None:
        self.points: list[list[float]] = []
        for evaluations, fitness in points:
            if evaluations is not None and fitness is not None:
                self.add(int(evaluations), fitness)

    def add(self, evaluations: int, fitness: float) -> None:
        """Add a point; of too many every second one is dropped, never the latest."""
        if not math.isfinite(fitness):
            return
        if self.points and evaluations <= self.points[-1][0]:
            return
        self.points.append([evaluations, fitness])
        if len(self.points) > MOST_POINTS:
            self.points = [*self.points[:-1:2], self.points[-1]]


@dataclass(frozen=True, slots=True)
class JobFolder:
    """Folder of one job."""

    path: Path

    def make(self) -> None:
        """Begin an attempt: of an earlier one only the checkpoint stays."""
        self.path.mkdir(parents=True, exist_ok=True)
        for name in (_PROGRESS, _CANCEL, _LIFE):
            (self.path / name).unlink(missing_ok=True)

    def remove(self) -> None:
        """Clear away; the job's result is in the store."""
        shutil.rmtree(self.path, ignore_errors=True)

    def write_progress(self, progress: Progress) -> None:
        """Replace the progress in one step, so that no reader sees half of it."""
        self._replace(_PROGRESS, asdict(progress))

    def read_progress(self) -> Progress | None:
        """Return the latest progress; None before the first, or where it is not readable."""
        try:
            return Progress(**json.loads((self.path / _PROGRESS).read_text()))
        except (OSError, ValueError, TypeError):
            return None

    def write_checkpoint(self, checkpoint: Mapping[str, object]) -> None:
        """Replace the checkpoint in one step: whenever the worker dies, there is a whole one."""
        self._replace(_CHECKPOINT, checkpoint)

    def read_checkpoint(self) -> Mapping[str, Any] | None:
        """Return the latest checkpoint; None where there is none or it is not readable."""
        try:
            checkpoint = json.loads((self.path / _CHECKPOINT).read_text())
        except (OSError, ValueError):
            return None
        return checkpoint if isinstance(checkpoint, dict) else None

    def _replace(self, name: str, document: Mapping[str, object]) -> None:
        temporary = self.path / f"{name}.new"
        temporary.write_text(json.dumps(document, allow_nan=False))
        temporary.replace(self.path / name)

    def show_life(self) -> None:
        """Leave a sign that the worker goes on computing."""
        (self.path / _LIFE).touch()

    def life(self) -> int | None:
        """Return what changes with every sign of life; None before the first."""
        try:
            return (self.path / _LIFE).stat().st_mtime_ns
        except FileNotFoundError:
            return None

    def cancel(self) -> None:
        """Ask the worker to stop."""
        if self.path.exists():
            (self.path / _CANCEL).touch()

    @property
    def cancelled(self) -> bool:
        """Whether the job is to stop."""
        return (self.path / _CANCEL).exists()


def clear_folders(parent: Path, kept: Collection[str]) -> None:
    """Remove all folders of jobs but those of the jobs given, and their parent if it is empty."""
    if not parent.is_dir():
        return
    for path in parent.iterdir():
        if path.name not in kept:
            shutil.rmtree(path, ignore_errors=True)
    if not any(parent.iterdir()):
        parent.rmdir()
