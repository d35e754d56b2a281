"""The store: samples, models, jobs, alarms, keys, in SQLite."""

from service.store.errors import (
    ActiveJobError,
    DataDirectoryInUseError,
    StoreError,
    StoreUnavailableError,
)
from service.store.locking import DataDirectoryLock, lock_data_directory
from service.store.records import (
    Activation,
    AlarmJournalPage,
    AlarmTransition,
    ApiKey,
    BrowserSession,
    Job,
    JobChanges,
    JobStatus,
    MinuteTable,
    ModelStatus,
    ModelVersion,
    Role,
    Rollup,
    StoredAlarm,
    StoredSample,
    WriteCounts,
)
from service.store.store import Store

__all__ = [
    "Activation",
    "ActiveJobError",
    "AlarmJournalPage",
    "AlarmTransition",
    "ApiKey",
    "BrowserSession",
    "DataDirectoryInUseError",
    "DataDirectoryLock",
    "Job",
    "JobChanges",
    "JobStatus",
    "MinuteTable",
    "ModelStatus",
    "ModelVersion",
    "Role",
    "Rollup",
    "Store",
    "StoreError",
    "StoreUnavailableError",
    "StoredAlarm",
    "StoredSample",
    "WriteCounts",
    "lock_data_directory",
]
