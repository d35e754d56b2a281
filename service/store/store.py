"""The store: one object with everything that the service keeps."""

from pathlib import Path
from typing import Self

from service.store.access import Access
from service.store.alarm_journal import AlarmJournal
from service.store.alarm_settings import AlarmSettings
from service.store.asset_states import AssetStates
from service.store.audit import Audit
from service.store.channel_history import ChannelHistory
from service.store.closable import Closable
from service.store.database import Database, Fence, damaged
from service.store.fleet_runs import FleetRuns
from service.store.history import History
from service.store.jobs import Jobs
from service.store.kept_forecasts import KeptForecasts
from service.store.model_versions import ModelVersions
from service.store.nights import Nights
from service.store.opening import open_database
from service.store.packing import Packing
from service.store.provisioned_assets import ProvisionedAssets
from service.store.rollups import Rollups
from service.store.runs import Runs
from service.store.salvage import damage_of
from service.store.samples import Samples
from service.store.silences import Silences
from service.store.sister_records import SisterRecords
from service.store.tellings import Tellings


class Store(Closable):
    """Samples, models, jobs, alarms and keys in one database, each in a part of its own.

    The methods of all parts are synchronous and safe to call from any thread.

    Parameters
    ----------
    database : Database
        Open; closed with the store.

    Attributes
    ----------
    samples : Samples
        Raw samples.
    packing : Packing
        Hours of raw samples that are over, in blocks.
    rollups : Rollups
        Statistics per minute and hour, and what is kept for how long.
    history : History
        Statistics of the samples per bucket of time.
    channel_history : ChannelHistory
        One channel as a historian reads it.
    models : ModelVersions
        Versions of each asset's model, and which is active.
    jobs : Jobs
        Identification jobs.
    nights : Nights
        What came of identifying a fleet.
    fleet_runs : FleetRuns
        Runs that identify a fleet, their progress and cost.
    sisters : SisterRecords
        What machines of a family teach each other.
    states : AssetStates
        The latest state of each twin.
    alarms : AlarmJournal
        Alarms and their journal.
    alarm_settings : AlarmSettings
        What was changed of alarms.
    tellings : Tellings
        What was told of the open alarms, and to whom.
    silences : Silences
        Times in which nobody is told.
    forecasts : KeptForecasts
        The forecast ledger.
    runs : Runs
        Runs of the machines with their names, and annotations.
    access : Access
        API keys and browser sessions.
    audit : Audit
        The audit trail.
    assets : ProvisionedAssets
        Assets that are not in the configuration file.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self.samples = Samples(database)
        self.packing = Packing(database)
        self.rollups = Rollups(database, self.samples)
        self.history = History(database)
        self.channel_history = ChannelHistory(database)
        self.models = ModelVersions(database)
        self.jobs = Jobs(database)
        self.nights = Nights(database)
        self.fleet_runs = FleetRuns(database)
        self.sisters = SisterRecords(database)
        self.states = AssetStates(database)
        self.alarms = AlarmJournal(database)
        self.alarm_settings = AlarmSettings(database)
        self.tellings = Tellings(database)
        self.silences = Silences(database)
        self.forecasts = KeptForecasts(database)
        self.runs = Runs(database, self.history)
        self.access = Access(database)
        self.audit = Audit(database)
        self.assets = ProvisionedAssets(database)

    @classmethod
    def open(
        cls, database_url: str, data_dir: Path, *, migrate: bool = False, run: str = ""
    ) -> Self:
        """Open the store.

        A new SQLite file is made, an older one is brought up to date. The tables of a PostgreSQL
        database are only touched when that is asked for, since others may work on it.

        Parameters
        ----------
        database_url : str
            Empty for the SQLite file in the data directory, ``sqlite:///PATH``, or
            ``postgresql://USER:PASSWORD@HOST/DATABASE``.
        data_dir : pathlib.Path
            The service's directory; made when it does not exist.
        migrate : bool
            Bring the tables of a PostgreSQL database up to date.
        run : str
            Name of this run of a cell, which the server shows; see `service.store.ownership`.

        Raises
        ------
        StoreError
            If the store cannot be used; one line that names it.
        """
        return cls(open_database(database_url, data_dir, migrate=migrate, run=run))

    def write_only_what(self, fence: Fence) -> None:
        """Have a fence asked before anything is written that was derived from measurements."""
        self._database.fence = fence

    def find_damage(self) -> str | None:
        """Look for damage, of an SQLite file and of blocks; one line that says what to do, or None.

        It reads the whole store. For its tables a PostgreSQL server has its own ways (`amcheck`).
        """
        path = self._database.engine.url.database
        if self._database.engine.dialect.name == "sqlite" and path is not None:
            problem = damage_of(Path(path))
            if problem is not None:
                return damaged(path, ValueError(problem))
        problem = self.packing.find_damage()
        return None if problem is None else f"store {self._database.name}: {problem}"

    def close(self) -> None:
        """Close all connections."""
        self._database.close()
