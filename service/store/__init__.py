"""The store: samples, models, jobs, alarms, keys, in SQLite or PostgreSQL."""

from service.store.alarm_records import (
    Alarm,
    AlarmCount,
    AlarmJournalPage,
    AlarmTransition,
    Annunciations,
    JournalFilter,
)
from service.store.database_lock import DatabaseLock, lock_database
from service.store.errors import (
    ActiveJobError,
    DatabaseInUseError,
    DataDirectoryInUseError,
    StoreError,
    StoreUnavailableError,
)
from service.store.locking import DataDirectoryLock, lock_data_directory
from service.store.outbox import AlarmChange, Outbox
from service.store.queue_file import QueueFile, QueueUnavailableError
from service.store.records import (
    Activation,
    ApiKey,
    AuditEntry,
    AuditPage,
    BrowserSession,
    Job,
    JobChanges,
    JobStatus,
    MinuteTable,
    ModelStatus,
    ModelVersion,
    Role,
    Rollup,
    StoredSample,
    WriteCounts,
)
from service.store.rollups import Retention, RetentionTime
from service.store.store import Store

__all__ = [
    "Activation",
    "ActiveJobError",
    "Alarm",
    "AlarmChange",
    "AlarmCount",
    "AlarmJournalPage",
    "AlarmTransition",
    "Annunciations",
    "ApiKey",
    "AuditEntry",
    "AuditPage",
    "BrowserSession",
    "DataDirectoryInUseError",
    "DataDirectoryLock",
    "DatabaseInUseError",
    "DatabaseLock",
    "Job",
    "JobChanges",
    "JobStatus",
    "JournalFilter",
    "MinuteTable",
    "ModelStatus",
    "ModelVersion",
    "Outbox",
    "QueueFile",
    "QueueUnavailableError",
    "Retention",
    "RetentionTime",
    "Role",
    "Rollup",
    "Store",
    "StoreError",
    "StoreUnavailableError",
    "StoredSample",
    "WriteCounts",
    "lock_data_directory",
    "lock_database",
]
