"""What each machine of a family teaches its sisters: one record per asset, made again as it runs.

The record of an asset that was removed stays: what a specimen has taught is true of its type.
"""

from collections.abc import Collection
from dataclasses import asdict, dataclass
from typing import Any, Final

from sqlalchemy import Select, delete, insert, select

from service.store.part import StorePart, rows_of
from service.store.records import JsonDocument
from service.store.tables import SisterRecordRow

#: Of a larger family, those that have seen the heaviest loads. Nineteen calibrate a band of 95 %.
MOST_SISTERS: Final = 30
#: Wall seconds to wait for other writers; a record can be made again at any time.
_PATIENCE_S: Final = 3.0
_SUMMARY: Final = tuple(
    getattr(SisterRecordRow, name)
    for name in (
        "asset",
        "family",
        "machine",
        "until_us",
        "minutes",
        "load_n_max",
        "speed_rpm_max",
    )
)


@dataclass(frozen=True, slots=True)
class SisterRecord:
    """What an asset's machine has shown in all that it has run.

    - ``machine``: what its model is built of; see `service.site.machines.machine.Machine.to_dict`.
    - ``until_us``: end of the data behind it, process time.
    - ``minutes``: how many minute rows are behind it.
    - ``load_n_max``, ``speed_rpm_max``: heaviest load and highest speed of these rows.
    - ``document``: ``posterior`` and ``rows``, as in a population file.
    """

    asset: str
    family: str
    machine: JsonDocument
    until_us: int
    minutes: int
    load_n_max: float
    speed_rpm_max: float
    document: JsonDocument

    @property
    def bearing_or_network(self) -> str:
        """Name of the bearing, of a network of one's own the network's; empty without a name."""
        network, bearing = self.machine.get("network"), self.machine.get("bearing")
        return str(network["name"] if network else (bearing or {}).get("designation", ""))


class SisterRecords(StorePart):
    """One record per asset; a new one replaces the old one."""

    def put(self, record: SisterRecord) -> None:
        """Keep a record. Raises `NotOwnerError` if another cell owns the asset."""
        with self._database.writing(_PATIENCE_S) as connection:
            self._require(connection, record.asset)
            connection.execute(delete(SisterRecordRow).where(SisterRecordRow.asset == record.asset))
            connection.execute(insert(SisterRecordRow).values(asdict(record)))

    def remove(self, asset: str) -> None:
        """Forget what an asset teaches: it belongs to no family any more.

        Raises `NotOwnerError` if another cell owns the asset.
        """
        with self._database.writing(_PATIENCE_S) as connection:
            self._require(connection, asset)
            connection.execute(delete(SisterRecordRow).where(SisterRecordRow.asset == asset))

    def of(self, assets: Collection[str]) -> dict[str, SisterRecord]:
        """Give the records of some assets, without their documents."""
        with self._database.reading() as connection:
            found = rows_of(connection, SisterRecordRow.asset, select(*_SUMMARY), assets)
        return {one.asset: SisterRecord(**one._mapping, document={}) for one in found}

    def of_family(self, family: str, without: str) -> list[SisterRecord]:
        """Give the records of a family, those of the heaviest loads first, `MOST_SISTERS` at most.

        ``without``: the asset that asks: no machine is a sister of itself.
        """
        query = _family(select(*_SUMMARY, SisterRecordRow.document), family, without)
        with self._database.reading() as connection:
            return [SisterRecord(**one._mapping) for one in connection.execute(query)]

    def summaries_of_family(self, family: str, without: str) -> list[SisterRecord]:
        """Give the same without their documents."""
        query = _family(select(*_SUMMARY), family, without)
        with self._database.reading() as connection:
            return [SisterRecord(**one._mapping, document={}) for one in connection.execute(query)]


def _family(query: Select[*tuple[Any, ...]], family: str, without: str) -> Select[*tuple[Any, ...]]:
    row = SisterRecordRow
    return (
        query.where(row.family == family, row.asset != without)
        .order_by(row.load_n_max.desc(), row.speed_rpm_max.desc(), row.asset)
        .limit(MOST_SISTERS)
    )
