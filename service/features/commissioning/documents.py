"""What is found while a bench is put into service: configuration, checks, registers, signals."""

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field

from service.clock import rfc3339
from service.documents.base import Document, Number, Page, Time
from service.domain.json_values import Json
from service.features.commissioning.file_versions import FileVersion

if TYPE_CHECKING:  # the drivers' libraries are loaded in the worker that probes
    from adapters.drivers.can.scan import BusSeen, SignalSeen
    from adapters.drivers.modbus.scan import RegisterValue, UnitAnswer

Takes = Literal["at once", "after a restart"]


class CatalogueBearing(Document):
    """A bearing of the catalogue."""

    designation: str = Field(examples=["6311"])
    bore_mm: float
    outer_mm: float
    width_mm: float


class CommissioningDocument(Document):
    """The configuration file as far as the page changes it."""

    file: str | None = Field(description="Its name; null: the service was started without one.")
    why_not: str | None = Field(description="Why it cannot be changed here; null: it can.")
    takes_effect: Takes = Field(description="When a saved change is in effect.")
    revision: str = Field(description="Names the text of the file; a change is based on it.")
    sources: list[dict[str, Json]] = Field(description="As in the file.")
    assets: list[dict[str, Json]] = Field(description="As in the file.")
    bearings: list[CatalogueBearing] = Field(description="The catalogue.")


class UnitDocument(Document):
    """Whether a Modbus unit answers."""

    unit: int = Field(examples=[1])
    answers: bool
    detail: str

    @classmethod
    def of(cls, answer: "UnitAnswer") -> Self:
        """Show an answer."""
        return cls(unit=answer.unit, answers=answer.answers, detail=answer.detail)


class UnitList(Document):
    """The units that were asked; `detail` is "ok" or says why there are none."""

    detail: str = Field(examples=["ok"])
    units: list[UnitDocument]


class RegisterDocument(Document):
    """A register in every type and order."""

    register_: int = Field(alias="register", description="Address on the wire.", examples=[40])
    word: int | None = Field(description="Its 16 bits; null: the device has no such register.")
    values: dict[str, Number] = Field(
        description="By type: `int16`, `uint16`, and with the next register `float32`, `int32` "
        "and `uint32` in each order, such as `float32 CDAB`; null where the bits are no number."
    )

    @classmethod
    def of(cls, value: "RegisterValue") -> Self:
        """Show a register."""
        return cls(register_=value.register, word=value.word, values=dict(value.values))


class RegisterList(Document):
    """Registers as they are now; `detail` is "ok" or says why there are none."""

    detail: str
    registers: list[RegisterDocument]


class SignalDocument(Document):
    """A signal of a DBC file, and what arrived of it."""

    message: str = Field(examples=["DriveStatus"])
    signal: str = Field(examples=["Speed"])
    unit: str
    frames: int = Field(description="Frames with it that came while one listened.")
    value: Number = Field(description="The latest; null where none came, or no good one.")
    detail: str = Field(description="Why there is no good value; else empty.")

    @classmethod
    def of(cls, seen: "SignalSeen") -> Self:
        """Show a signal."""
        return cls(
            message=seen.message,
            signal=seen.signal,
            unit=seen.unit,
            frames=seen.frames,
            value=seen.value,
            detail=seen.detail,
        )


class SignalList(Document):
    """What came on a CAN bus; `detail` is "ok" or says why nothing did."""

    detail: str
    frames: int = Field(description="All frames that came.")
    unknown: list[str] = Field(description="Identifiers that are not in the DBC file, hexadecimal.")
    signals: list[SignalDocument]

    @classmethod
    def of(cls, seen: "BusSeen") -> Self:
        """Show what came."""
        return cls(
            detail="ok" if seen.frames else "no frame came",
            frames=seen.frames,
            unknown=list(seen.unknown),
            signals=[SignalDocument.of(one) for one in seen.signals],
        )


class DbcDocument(Document):
    """A DBC file that is kept beside the configuration file."""

    name: str = Field(description="What a source calls it; another than asked for if that exists.")
    signals: list[SignalDocument]


class VersionDocument(Document):
    """A version of the configuration file."""

    number: int
    revision: str
    saved_at: Time = Field(description="Wall time.")
    who: str = Field(examples=["admin bt_1a2b3c4d (workshop)", "by hand"])
    what: str = Field(examples=["sources: sensors; assets: bench-1"])
    current: bool = Field(description="Whether the file holds it now.")

    @classmethod
    def of(cls, version: FileVersion, current: str) -> Self:
        """Show a version; ``current`` is the revision of the file as it is."""
        return cls(
            number=version.number,
            revision=version.revision,
            saved_at=rfc3339(version.saved_us),
            who=version.who,
            what=version.what,
            current=version.revision == current,
        )


class VersionList(Page):
    """The versions of the configuration file, newest first."""

    items: list[VersionDocument]


class SavedDocument(Document):
    """A change of the configuration file."""

    revision: str = Field(description="Of the file as it is now.")
    changed: bool = Field(description="False: the file was so already, and nothing was written.")
    takes_effect: Takes
    warnings: list[str]
