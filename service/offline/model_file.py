"""MODEL.json: an identified model with everything that a forecast needs."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import ValidationError

from service.domain.errors import BearingTwinError
from service.files import replacing
from service.offline.json_files import read_json_file
from service.offline.rows import revolutions_at
from service.offline.tables import FloatArray, Recording
from service.site.configuration import describe
from service.site.machines.bearings import named_bearing
from service.site.machines.machine import Machine
from service.site.machines.packed_rows import pack_rows, unpack_rows
from twin_core.identification import IdentificationData
from twin_core.identification.posterior import Posterior
from twin_core.models import ThermalModel
from twin_core.windows import MinuteData

FORMAT = "bearing-twin model"
FORMAT_VERSION = 1
_KNOTS = 200
_SAME_K = 0.5
_SAME_SHARE = 0.9
# How much fresher than at the beginning of the data the grease may count as, in revolutions:
# half the usual run-in constant. Further back the law would be an extrapolation without limit.
_FRESHEST_REVOLUTIONS = -5.0e5


class ModelFileError(BearingTwinError, ValueError):
    """A model file that cannot be used; its text is one line for the user."""


@dataclass(frozen=True, slots=True, eq=False)
class RunIn:
    """Revolutions of the shaft over the identification data, counted from their first row.

    - ``start_us``: UTC microseconds that ``time_s`` counts from; None if the data had no dates.
    - ``at_rest``: whether the machine stood at ambient at the first row.
    - ``time_s``, ``revolutions``: (k,) some rows of the data, the first and the last among them.
    - ``temperatures_c``: (k,) per sensor there; without dates they show whether a history is of the
      same run.
    """

    start_us: int | None
    at_rest: bool
    time_s: FloatArray
    revolutions: FloatArray
    temperatures_c: dict[str, FloatArray]

    @classmethod
    def of(cls, recording: Recording, minutes: MinuteData, at_rest: bool) -> Self:
        """Summarise the good rows of the data."""
        good = minutes.take(minutes.good)
        revolutions = revolutions_at(minutes)
        rows = np.unique(np.linspace(0, good.size - 1, min(_KNOTS, good.size)).astype(int))
        return cls(
            recording.start_us,
            at_rest,
            good.time_s[rows],
            revolutions[rows],
            {name: values[rows] for name, values in good.temperatures_c.items()},
        )

    @property
    def end_revolutions(self) -> float:
        """Revolutions at the end of the data."""
        return float(self.revolutions[-1])

    def covers(self, recording: Recording, minutes: MinuteData) -> bool:
        """Whether a recording is of the same run as the data, at least in part.

        By the dates if both have some; otherwise both must show the same temperatures at the same
        ``time_s``.
        """
        time_s = self._on_axis_of(recording)
        good = minutes.take(minutes.good)
        common = (time_s >= good.time_s[0]) & (time_s <= good.time_s[-1])
        if not common.any() or self._dated(recording):
            return bool(common.any())
        differences = []
        for name, values in self.temperatures_c.items():
            if name not in good.temperatures_c:
                continue
            theirs = good.temperatures_c[name]
            known = np.isfinite(theirs)
            if known.any():
                read = np.interp(time_s[common], good.time_s[known], theirs[known])
                differences.append(np.abs(read - values[common]))
        found = np.concatenate(differences) if differences else np.zeros(0)
        found = found[np.isfinite(found)]
        return found.size > 0 and float(np.mean(found <= _SAME_K)) >= _SAME_SHARE

    def at_start_of(self, recording: Recording, minutes: MinuteData) -> float:
        """Revolutions at a history's first good row.

        A history of the same run takes its place in it; any other is taken for a later one.
        """
        good = minutes.take(minutes.good)
        time_s = self._on_axis_of(recording)
        first_s = float(good.time_s[0])
        if not self.covers(recording, minutes):
            earlier = self._dated(recording) and float(good.time_s[-1]) < float(time_s[0])
            return 0.0 if earlier else self.end_revolutions
        if first_s >= time_s[0]:
            return float(np.interp(first_s, time_s, self.revolutions))
        turned = np.interp(time_s[0], good.time_s, revolutions_at(minutes))
        return max(-float(turned), _FRESHEST_REVOLUTIONS)

    def begins_with(self, recording: Recording, minutes: MinuteData) -> bool:
        """Whether a history begins with the first row of the data."""
        good = minutes.take(minutes.good)
        offset_s = abs(float(self._on_axis_of(recording)[0] - good.time_s[0]))
        return offset_s < 1.0 and self.covers(recording, minutes)

    def _dated(self, recording: Recording) -> bool:
        return self.start_us is not None and recording.start_us is not None

    def _on_axis_of(self, recording: Recording) -> FloatArray:
        if self.start_us is None or recording.start_us is None:
            return self.time_s
        return self.time_s + (self.start_us - recording.start_us) / 1e6

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON types."""
        return {
            "start_us": self.start_us,
            "at_rest": self.at_rest,
            "time_s": self.time_s.tolist(),
            "revolutions": self.revolutions.tolist(),
            "temperatures_c": {
                name: [None if np.isnan(value) else float(value) for value in values]
                for name, values in self.temperatures_c.items()
            },
        }

    @classmethod
    def from_dict(cls, document: dict[str, Any]) -> Self:
        """Take back what `to_dict` gave."""
        return cls(
            document["start_us"],
            bool(document["at_rest"]),
            np.array(document["time_s"], np.float64),
            np.array(document["revolutions"], np.float64),
            {
                name: np.array(values, np.float64)
                for name, values in document["temperatures_c"].items()
            },
        )


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedModel:
    """A model with everything that a forecast and its sisters need.

    - ``run_in``: run-in of the grease over the data.
    - ``family``: of machines of one type, grease and arrangement; empty where it is not known.
    - ``data``: the minute rows that it was identified from; None where the file does not have them.
    - ``own``: the posterior that its own data give with the literature's prior, without samples;
      None where that is `posterior`.
    """

    machine: Machine
    model: ThermalModel
    posterior: Posterior
    run_in: RunIn
    family: str = ""
    data: IdentificationData | None = None
    own: Posterior | None = None

    @property
    def values(self) -> FloatArray:
        """Most probable parameters, (p,), in physical units."""
        return self.model.parameters.values_from_z(self.posterior.z)

    def save(self, path: Path, *, with_data: bool = True) -> None:
        """Write MODEL.json; without its minute rows no sister can be calibrated by it.

        Raises `FileError` if the file cannot be written.
        """
        document = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "model": self.model.name,
            "bearing": self.model.machine,
            "machine": self.machine.to_dict(),
            "posterior": self.posterior.to_dict(),
            "run_in": self.run_in.to_dict(),
        }
        if self.family:
            document["family"] = self.family
        if self.own is not None:
            document["own"] = self.own.to_dict()
        if with_data and self.data is not None:
            document["rows"] = pack_rows(self.data)
        with replacing(path) as file:
            json.dump(document, file, allow_nan=False)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read MODEL.json. Raises `ModelFileError` if it cannot be read or is not such a file."""
        what = "a model file; expected what 'bearing-twin identify' wrote"
        document = read_json_file(path, FORMAT, FORMAT_VERSION, ModelFileError, what)
        try:
            posterior = Posterior.from_dict(document["posterior"])
            machine = _machine(document)
            model = machine.build()
            posterior.check(model)
            own = Posterior.from_dict(document["own"]) if "own" in document else None
            if own is not None:
                own.check(model)
            return cls(
                machine,
                model,
                posterior,
                RunIn.from_dict(document["run_in"]),
                str(document.get("family", "")),
                unpack_rows(document["rows"]) if "rows" in document else None,
                own,
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ModelFileError(f"{path}: damaged model file ({error!r})") from error
        except ValidationError as error:
            raise ModelFileError(f"{path}: {describe(error, 'machine')}") from error
        except ValueError as error:
            raise ModelFileError(f"{path}: {error}") from error


def _machine(document: dict[str, Any]) -> Machine:
    """The machine of a model file; older files name a bearing of the catalogue and nothing else."""
    if "machine" in document:
        return Machine.from_dict(document["machine"])
    return Machine(document["model"], named_bearing(document["bearing"], {}), None)
