"""The store: one object with everything that the service keeps."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Self, cast

from service.store.access import Access
from service.store.alarm_journal import AlarmJournal
from service.store.alarm_overlays import AlarmOverlays
from service.store.asset_states import AssetStates
from service.store.audit import Audit
from service.store.channel_history import ChannelHistory
from service.store.closable import Closable
from service.store.database import Database, Fence, StoreWitness, damaged
from service.store.fences import ClosedFence
from service.store.history import History
from service.store.identity import StoreIdentity
from service.store.impossible_times import ImpossibleTimes
from service.store.jobs import Jobs
from service.store.model_versions import ModelVersions
from service.store.opening import open_database
from service.store.packing import Packing
from service.store.part import DELIVERY_PATIENCE_S, PartT, StorePart
from service.store.partition_owners import PartitionOwners
from service.store.provisioned_assets import ProvisionedAssets
from service.store.refused_changes import RefusedChanges
from service.store.rollups import Rollups
from service.store.salvage import damage_of
from service.store.samples import Samples
from service.store.sister_records import SisterRecords
from service.store.tables import all_tables


class Store(Closable):
    """Samples, models, jobs, alarms and keys in one database, each in a part of its own.

    The methods of all parts are synchronous and safe to call from any thread. The database is
    closed with the store.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._parts: dict[type[StorePart], StorePart] = {}
        self.samples = Samples(database)
        self.impossible_times = ImpossibleTimes(database)
        self.packing = Packing(database)
        self.rollups = Rollups(database, self.samples)
        self.history = History(database)
        self.channel_history = ChannelHistory(database)
        self.models = ModelVersions(database)
        self.jobs = Jobs(database)
        self.sisters = SisterRecords(database)
        self.states = AssetStates(database)
        self.alarms = AlarmJournal(database)
        self.alarm_overlays = AlarmOverlays(database)
        self.refused = RefusedChanges(database)
        self.access = Access(database)
        self.audit = Audit(database)
        self.assets = ProvisionedAssets(database)
        self.identity = StoreIdentity(database)
        self.partition_owners = PartitionOwners(database)

    @classmethod
    def open(
        cls, database_url: str, data_dir: Path, *, migrate: bool = False, run: str = ""
    ) -> Self:
        """Open the store.

        A new SQLite file is made, an older one is brought up to date. The tables of a PostgreSQL
        database are only touched when that is asked for, since others may work on it. Raises
        `StoreError` if the store cannot be used; one line that names it.

        - ``database_url``: empty for the SQLite file in the data directory, ``sqlite:///PATH``, or
          ``postgresql://USER:PASSWORD@HOST/DATABASE``.
        - ``run``: name of this run of a cell, which the server shows; see
          `service.store.ownership`. Its store refuses what is derived from measurements until
          `write_only_what` is called.
        """
        store = cls(open_database(database_url, data_dir, migrate=migrate, run=run))
        if run:
            store.write_only_what(ClosedFence())
        return store

    def write_only_what(self, fence: Fence) -> None:
        """Have a fence asked before anything is written that was derived from measurements."""
        self._database.fence = fence

    def part(self, kind: type[PartT]) -> PartT:
        """Give a feature's part of the store, made when it is needed first.

        For an interface of the core that is the part of the feature which derives from it.
        """
        part = self._parts.get(kind)
        if part is None:  # two threads may make it: the first one stays
            all_tables()
            made = next(iter(kind.__subclasses__()), kind)
            part = self._parts.setdefault(kind, made(self._database))
        return cast(PartT, part)

    def delivering(self) -> AbstractContextManager[None]:
        """Have all deliveries that this thread makes meanwhile written together, or none.

        An error must leave the context.
        """
        return self._database.together(DELIVERY_PATIENCE_S)

    @property
    def name(self) -> str:
        """What messages call it; names hosts and files."""
        return self._database.name

    def write_if(self, witness: StoreWitness | None) -> None:
        """Have a witness asked before anything is written: the store may be another one."""
        self._database.witness = witness

    def find_damage(self) -> str | None:
        """Look for damage, of an SQLite file and of blocks; one line that says what to do, or None.

        It reads the whole store. For its tables a PostgreSQL server has its own ways (`amcheck`).
        """
        path = self._database.engine.url.database
        if self._database.engine.dialect.name == "sqlite" and path is not None:
            problem = damage_of(Path(path))
            if problem is not None:
                return damaged(path, ValueError(problem))
        problem = self.packing.find_damage() or self.rollups.find_damage()
        return None if problem is None else f"store {self._database.name}: {problem}"

    def close(self) -> None:
        """Close all connections."""
        self._database.close()
