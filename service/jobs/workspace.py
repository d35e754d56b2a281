"""The folder through which a worker process and the service talk about one job.

Files, because they work the same for a process pool on this machine and for a cluster that shares
a folder, and because they outlive either side: the worker writes its progress, the service leaves
a mark when the job is to stop.
"""

import json
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

_PROGRESS = "progress.json"
_CANCEL = "cancel"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a job is."""

    fraction: float
    phase: str
    evaluations: int
    best_fitness: float | None


@dataclass(frozen=True, slots=True)
class JobFolder:
    """Folder of one job."""

    path: Path

    def make(self) -> None:
        """Begin with an empty folder."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.path.mkdir(parents=True)

    def remove(self) -> None:
        """Clear away; the job's result is in the store."""
        shutil.rmtree(self.path, ignore_errors=True)

    def write_progress(self, progress: Progress) -> None:
        """Replace the progress in one step, so that no reader sees half of it."""
        temporary = self.path / f"{_PROGRESS}.new"
        temporary.write_text(json.dumps(asdict(progress)))
        temporary.replace(self.path / _PROGRESS)

    def read_progress(self) -> Progress | None:
        """Return the latest progress, or None before the first."""
        try:
            return Progress(**json.loads((self.path / _PROGRESS).read_text()))
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
