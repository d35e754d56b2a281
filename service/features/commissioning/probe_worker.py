"""What the worker process of the web side asks of strange devices and files.

Called in a process of its own (`probes.py` here), which is killed when it takes too
long: nothing that a device sends or a file holds delays the polls of those that are in service.
"""

import asyncio
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from adapters.configuration import ConfigurationError
from service.documents.checks import CheckDocument
from service.domain.upload_limits import UploadTooLargeError
from service.features.commissioning.documents import (
    RegisterDocument,
    RegisterList,
    SignalDocument,
    SignalList,
    UnitDocument,
    UnitList,
)

if TYPE_CHECKING:  # field libraries are loaded where they are used: in the worker
    from adapters.drivers.can.config import CanSource
    from adapters.drivers.modbus.config import Kind, ModbusSource
    from service.site.configuration import TomlTable
    from service.site.settings import Settings

#: Wall seconds that a unit is given, where the source itself gives more.
UNIT_S: Final = 0.5
#: Processor seconds for the assets in the store; thousands take less.
MISFITS_S: Final = 10.0


def units(source: "ModbusSource", first: int, count: int) -> UnitList:
    """Ask units whether they are there."""
    from adapters.drivers.modbus.link import LinkLostError
    from adapters.drivers.modbus.scan import scan_units

    quick = source.model_copy(update={"timeout_s": min(source.timeout_s, UNIT_S)})
    numbers = range(first, min(first + count, 256))
    try:
        found = asyncio.run(scan_units(quick, numbers))
    except LinkLostError as error:
        return UnitList(detail=str(error), units=[])
    return UnitList(detail="ok", units=[UnitDocument.of(one) for one in found])


def registers(
    source: "ModbusSource", unit: int, kind: "Kind", first: int, count: int
) -> RegisterList:
    """Read registers once."""
    from adapters.drivers.modbus.link import DeviceRefusedError, LinkLostError, NoAnswerError
    from adapters.drivers.modbus.scan import read_registers

    most = min(count, 65536 - first)
    try:
        found = asyncio.run(read_registers(source, unit, kind, first, most))
    except (LinkLostError, NoAnswerError) as error:
        return RegisterList(detail=f"unit {unit}: {error}", registers=[])
    except DeviceRefusedError as error:
        return RegisterList(detail=f"unit {unit} refuses: {error}", registers=[])
    return RegisterList(detail="ok", registers=[RegisterDocument.of(one) for one in found])


def signals(source: "CanSource", listen_s: float) -> SignalList:
    """Listen to a bus."""
    from adapters.drivers.can.scan import listen

    try:
        return SignalList.of(listen(source, listen_s))
    except ConfigurationError as error:
        return SignalList(detail=str(error), frames=0, unknown=[], signals=[])
    except Exception as error:  # interfaces raise whatever their libraries raise
        reason = " ".join(str(error).split()) or type(error).__name__
        detail = f"cannot open {source.channel}: {reason}"
        return SignalList(detail=detail, frames=0, unknown=[], signals=[])


def dbc_signals(file: Path) -> list[SignalDocument]:
    """List what a DBC file describes. Raises `ConfigurationError` if it is none."""
    from adapters.drivers.can.config import CanSource
    from adapters.drivers.can.scan import described_signals

    source = CanSource(name=file.name, channel="", dbc=file)
    return [SignalDocument.of(one) for one in described_signals(source)]


def check(file: Path, text: str, stored: Mapping[str, "TomlTable"]) -> CheckDocument:
    """Check a configuration that is not saved yet, and read its sources once.

    Assets in the store are checked too: `stored` has their tables by id.
    """
    from service.ingest.probing import probe, unit_doubts
    from service.site.examination import examine

    found = examine(file, text)
    probed = asyncio.run(probe(found.wiring))
    errors = [*found.errors, *probed.problems, *_misfits(found.settings, stored)]
    warnings = _short(file, [*found.warnings, *unit_doubts(found.settings, probed)])
    return CheckDocument.of(file.name, _short(file, errors), warnings, probed)


def problems(
    file: Path, text: str, stored: Mapping[str, "TomlTable"]
) -> tuple[list[str], list[str]]:
    """Say what is wrong with a configuration, and what to think of; asks no device.

    An asset in the store that does not fit is no error: it does not stop the service.
    """
    from service.site.examination import examine

    found = examine(file, text)
    warnings = [*found.warnings, *_misfits(found.settings, stored)]
    return _short(file, found.errors), _short(file, warnings)


def _misfits(settings: "Settings | None", stored: Mapping[str, "TomlTable"]) -> list[str]:
    from service.site.asset_tables import misfits

    try:
        return [] if settings is None else misfits(settings, stored, MISFITS_S)
    except UploadTooLargeError:
        return ["assets in the store: too many to be checked here; expected a check by command"]


def _short(file: Path, lines: Iterable[str]) -> list[str]:
    """Leave the name of the file out, which the page knows."""
    return [line.removeprefix(f"{file}: ") for line in lines]
