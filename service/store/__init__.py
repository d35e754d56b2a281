"""The store: samples, models, jobs, alarms, keys, in SQLite or PostgreSQL."""

from service.store.alarm_records import (
    Alarm,
    AlarmCount,
    AlarmJournalPage,
    AlarmTransition,
    Annunciations,
    JournalFilter,
)
from service.store.alarm_settings import AlarmSettingChange, AlarmSettingPage
from service.store.database_lock import DatabaseLock, lock_database
from service.store.durable_queue import DurableQueue
from service.store.errors import (
    ActiveJobError,
    DatabaseInUseError,
    DataDirectoryInUseError,
    NotOwnerError,
    StoreDamagedError,
    StoreError,
    StoreUnavailableError,
)
from service.store.locking import DataDirectoryLock, lock_data_directory
from service.store.outbox import AlarmChange, Outbox
from service.store.ownership import Ownership, run_name
from service.store.pages import PageRow
from service.store.queue_file import (
    Mended,
    QueueFile,
    QueueLayout,
    QueueUnavailableError,
    Row,
)
from service.store.records import (
    Activation,
    ApiKey,
    AuditEntry,
    AuditPage,
    BrowserSession,
    FirstModel,
    Job,
    JobChanges,
    MinuteTable,
    ModelStatus,
    ModelVersion,
    ProvisionedAsset,
    Rollup,
    StoredSample,
    WriteCounts,
)
from service.store.rollups import Retention, RetentionTime
from service.store.runs import Annotation, Run, RunPage
from service.store.silences import Silence
from service.store.store import Store
from service.store.tellings import Telling, TellingChange

__all__ = [
    "Activation",
    "ActiveJobError",
    "Alarm",
    "AlarmChange",
    "AlarmCount",
    "AlarmJournalPage",
    "AlarmSettingChange",
    "AlarmSettingPage",
    "AlarmTransition",
    "Annotation",
    "Annunciations",
    "ApiKey",
    "AuditEntry",
    "AuditPage",
    "BrowserSession",
    "DataDirectoryInUseError",
    "DataDirectoryLock",
    "DatabaseInUseError",
    "DatabaseLock",
    "DurableQueue",
    "FirstModel",
    "Job",
    "JobChanges",
    "JournalFilter",
    "Mended",
    "MinuteTable",
    "ModelStatus",
    "ModelVersion",
    "NotOwnerError",
    "Outbox",
    "Ownership",
    "PageRow",
    "ProvisionedAsset",
    "QueueFile",
    "QueueLayout",
    "QueueUnavailableError",
    "Retention",
    "RetentionTime",
    "Rollup",
    "Row",
    "Run",
    "RunPage",
    "Silence",
    "Store",
    "StoreDamagedError",
    "StoreError",
    "StoreUnavailableError",
    "StoredSample",
    "Telling",
    "TellingChange",
    "WriteCounts",
    "lock_data_directory",
    "lock_database",
    "run_name",
]
