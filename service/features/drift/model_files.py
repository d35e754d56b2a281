"""Has a machine changed: model files of several spans of its data, compared."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from service.clock import rfc3339
from service.features.drift.documents import DriftOfFiles, FileDrift
from service.jobs.comparison import EarlierVersion, drift_document
from service.offline.model_file import IdentifiedModel, ModelFileError
from service.site.machines.machine import Machine, MachineParts
from twin_core.quantities import ReferencePoint
from twin_core.windows import Window

# Rows of a model file's own summary are this much further apart than usual where data are missing.
_GAP = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class ModelOfSpan:
    """One model file."""

    file: Path
    identified: IdentifiedModel

    @property
    def windows(self) -> list[Window]:
        """Spans of its data in UTC seconds; empty if they had no dates."""
        run_in = self.identified.run_in
        if run_in.start_us is None or run_in.time_s.size < 2:
            return []
        time_s = run_in.start_us / 1e6 + run_in.time_s
        steps_s = np.diff(time_s)
        edges = np.flatnonzero(steps_s > _GAP * np.median(steps_s))
        firsts = np.concatenate(([0], edges + 1))
        lasts = np.concatenate((edges, [time_s.size - 1]))
        return [
            Window(float(time_s[first]), float(time_s[last]), (), False, 0.0)
            for first, last in zip(firsts, lasts, strict=True)
        ]

    @property
    def dates(self) -> dict[str, str | None]:
        """First and last row of its data; None if they had no dates."""
        run_in = self.identified.run_in
        if run_in.start_us is None:
            return {"start": None, "end": None}
        ends = run_in.start_us + run_in.time_s[[0, -1]] * 1e6
        return {"start": rfc3339(round(ends[0])), "end": rfc3339(round(ends[1]))}


def load_models(files: Sequence[Path]) -> list[ModelOfSpan]:
    """Read model files of one machine.

    They are in the order of their data where all have dates, else as given. Raises `ModelFileError`
    if a file cannot be used, or two are of different machines or models.
    """
    models = [ModelOfSpan(file, IdentifiedModel.load(file)) for file in files]
    first = models[0]
    for other in models[1:]:
        if _priors(other.identified.machine) != _priors(first.identified.machine):
            raise ModelFileError(
                f"{other.file}: model {other.identified.model.name!r} of "
                f"{other.identified.model.machine!r}: expected the model, bearing or network, and "
                f"priors of {first.file}; only then can parameters be compared"
            )
    starts = [one.identified.run_in.start_us for one in models]
    if all(start is not None for start in starts):
        models.sort(key=lambda one: one.identified.run_in.start_us or 0)
    return models


def _priors(machine: Machine) -> MachineParts:
    """All of a machine that two comparable models share; what bands allow for may differ."""
    document = machine.to_dict()
    if document["network"] is not None:
        document["network"] = {
            key: value
            for key, value in document["network"].items()
            if key not in ("errors", "runaway", "reference")
        }
    return document


def compare_models(models: Sequence[ModelOfSpan]) -> DriftOfFiles:
    """Compare every model with those before it.

    A model is compared with earlier ones of the same state of the machine whose operation was most
    like its own. From a model that reports a change on, later ones are compared with it. Returns
    ``changed`` and ``text`` over all, and per model what the service's model versions carry as
    ``drift``.
    """
    earlier: list[EarlierVersion] = []
    found: list[FileDrift] = []
    for number, one in enumerate(models, start=1):
        posterior, windows = one.identified.posterior, one.windows
        drift = drift_document(one.identified.model, posterior, windows, earlier)
        earlier.append(
            EarlierVersion(
                number,
                posterior,
                windows,
                None if drift.point is None else ReferencePoint(**dict(drift.point)),
                bool(drift.changed),
                was_active=True,
            )
        )
        against = drift.comparison and str(models[drift.comparison.version - 1].file)
        found.append(FileDrift(file=str(one.file), **one.dates, against=against, **dict(drift)))
    changes = [one for one in found if one.changed]
    compared = any(one.changed is not None for one in found)
    text = "no change" if compared else "nothing could be compared"
    if changes:
        text = "; ".join(f"{one.file}: {one.text}" for one in changes)
    return DriftOfFiles(changed=bool(changes) if compared else None, text=text, models=found)
