"""Sisters from model files, and populations of them as files of their own.

A machine that is no sister is refused with one line; nothing is left out in silence.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import ValidationError

from service.domain.errors import BearingTwinError
from service.files import replacing
from service.offline.json_files import read_json_file
from service.offline.model_file import IdentifiedModel
from service.site.configuration import describe
from service.site.machines.machine import Machine, why_no_sister
from service.site.machines.packed_rows import pack_rows, unpack_rows
from twin_core.identification import IdentificationData
from twin_core.identification.posterior import Posterior
from twin_core.sisters import Sister, same_run, sister_of
from twin_core.sisters.population import FEWEST_SISTERS

FORMAT = "bearing-twin population"
FORMAT_VERSION = 1


class SistersError(BearingTwinError, ValueError):
    """Sisters that cannot be used; one line for the user."""


@dataclass(frozen=True, slots=True, eq=False)
class PopulationMember:
    """One machine of a population: a name, what its own data say, its minute rows if known."""

    name: str
    posterior: Posterior
    data: IdentificationData | None

    @property
    def sister(self) -> Sister:
        """The same for the computation."""
        return sister_of(self.name, self.posterior, self.data)


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """Identified machines of one family.

    It has two members at least. `skipped` has the reason, by path, for each file that is of no
    sister; it is not written.
    """

    machine: Machine
    family: str
    members: tuple[PopulationMember, ...]
    skipped: dict[str, str]

    @classmethod
    def of_files(
        cls,
        paths: Sequence[Path],
        *,
        machine: Machine | None = None,
        family: str = "",
        skip_strangers: bool = False,
    ) -> Self:
        """Read model files.

        They have to be of this machine and family, by default those of the first file; others are
        refused, or left out. Raises `ModelFileError` or `SistersError` if a file cannot be used, or
        is of another machine or family and such are not skipped; if fewer than two are left.
        """
        members: list[PopulationMember] = []
        skipped: dict[str, str] = {}
        for path in paths:
            found = IdentifiedModel.load(path)
            machine = machine or found.machine
            why = why_no_sister(machine, family, found.machine, found.family)
            if why and not skip_strangers:
                raise SistersError(f"{path}: {why}; or skip it with --skip-strangers")
            if why:
                skipped[str(path)] = why
                continue
            family = family or found.family
            members.append(_member(str(path), found.own or found.posterior, found.data))
        if machine is None:
            raise SistersError("no model file; expected at least two")
        return cls(machine, family, _together(members, "model files"), skipped)

    def for_machine(
        self, machine: Machine, family: str, data: IdentificationData, *, skip_strangers: bool
    ) -> list[Sister]:
        """Give the sisters of a machine.

        ``skip_strangers``: leave out what is of the same run as these rows, instead of refusing it.
        Raises `SistersError` if they are of another machine or family, one of them is the machine
        itself, or fewer than two are left.
        """
        why = why_no_sister(machine, family, self.machine, self.family)
        if why:
            raise SistersError(f"{self.members[0].name}: {why}")
        members = []
        for member in self.members:
            if member.data is None or not same_run(data, member.data):
                members.append(member)
            elif skip_strangers:
                self.skipped[member.name] = "the run that is identified"
            else:
                raise SistersError(
                    f"{member.name}: the same run as the data, a machine is no sister of itself; "
                    "leave it out, or skip it with --skip-strangers"
                )
        return [member.sister for member in _together(members, "sisters")]

    def save(self, path: Path, *, with_data: bool = True) -> None:
        """Write FAMILY.json. Raises `FileError` if the file cannot be written."""
        short = [Path(member.name).name for member in self.members]
        names = short if len(set(short)) == len(short) else [one.name for one in self.members]
        document = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "machine": self.machine.to_dict(),
            "family": self.family,
            "members": [
                {"name": name, "posterior": member.posterior.to_dict()}
                | (
                    {"rows": pack_rows(member.data)}
                    if with_data and member.data is not None
                    else {}
                )
                for name, member in zip(names, self.members, strict=True)
            ],
        }
        with replacing(path) as file:
            json.dump(document, file, allow_nan=False)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read FAMILY.json. Raises `SistersError` if it cannot be read or is not such a file."""
        what = "a population; expected what 'bearing-twin population' wrote"
        document = read_json_file(path, FORMAT, FORMAT_VERSION, SistersError, what)
        try:
            return cls._of_document(document)
        except (KeyError, TypeError, AttributeError) as error:
            raise SistersError(f"{path}: damaged population ({error!r})") from error
        except ValidationError as error:
            raise SistersError(f"{path}: {describe(error, 'machine')}") from error
        except ValueError as error:
            raise SistersError(f"{path}: {error}") from error

    @classmethod
    def _of_document(cls, document: dict[str, Any]) -> Self:
        machine = Machine.from_dict(document["machine"])
        model = machine.build()
        members = []
        for one in document["members"]:
            posterior = Posterior.from_dict(one["posterior"])
            posterior.check(model)
            data = unpack_rows(one["rows"]) if "rows" in one else None
            members.append(_member(str(one["name"]), posterior, data))
        return cls(machine, str(document["family"]), _together(members, "members"), {})


def _member(name: str, posterior: Posterior, data: IdentificationData | None) -> PopulationMember:
    """A member; complains if its posterior is none."""
    bare = replace(posterior, samples=np.empty((0, posterior.z.size)), sisters=None)
    member = PopulationMember(name, bare, data)
    try:
        _ = member.sister
    except ValueError as error:
        raise SistersError(f"{name}: {error}") from error
    return member


def _together(members: Sequence[PopulationMember], what: str) -> tuple[PopulationMember, ...]:
    """The members; complains about too few, and about one that is there twice."""
    for number, member in enumerate(members):
        for earlier in members[:number]:
            if np.array_equal(earlier.posterior.z, member.posterior.z):
                raise SistersError(
                    f"{member.name}: the same model as {earlier.name}; expected each machine once"
                )
    if len(members) < FEWEST_SISTERS:
        raise SistersError(
            f"{len(members)} of the {what} can be used: a population needs at least "
            f"{FEWEST_SISTERS}"
        )
    return tuple(members)
